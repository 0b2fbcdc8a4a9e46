//! Walls of the corridor: which returns belong to them.
//!
//! The walls are known lines, but the pose is an estimate: 0.01 rad are 5 cm at the end of the view. So each wall is
//! fitted anew in every scan, as its known line plus a small offset and slope, with the uncertainty of the pose as
//! prior. Returns within a band of the fitted line belong to the wall.
//!
//! Where it fails: a body less than the band (0.12 m) off the wall is taken for the wall. The robot's centre keeps
//! 0.4 m from the wall, so its side still has 0.08 m to such a body.

use nalgebra::{Matrix2, Vector2};

use crate::ObstaclesConfig;
use crate::outline::Vertex;
use crate::points::{Place, Point};
use crate::segment::End;

/// Returns farther from the line than this are left out of the fit, one value per iteration [m].
const FIT_M: [f64; 3] = [0.25, 0.15, 0.08];
/// With fewer returns than this the known line is not changed.
const FIT_POINTS: usize = 8;

/// One wall as seen in this scan: y = `y` + `offset` + `slope` (x - `from_x`).
#[derive(Debug, Clone, Copy, PartialEq)]
struct Wall {
    y: f64,
    from_x: f64,
    offset: f64,
    slope: f64,
}

/// Both walls of one scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Walls {
    sides: Option<[Wall; 2]>,
    along: [f64; 2],
    inside: [f64; 2],
    band: f64,
}

impl Walls {
    /// Fits the walls to the points of one scan.
    pub(crate) fn fit(config: &ObstaclesConfig, place: &Place, points: &[Point]) -> Self {
        let outside = |[low, high]: [f64; 2], by: f64| [low - by, high + by];
        let along = outside(config.track_x_m, config.beside_m);
        if !config.walls {
            let inside = outside(config.wall_y_m, config.beside_m.max(config.watch_m));
            return Self { sides: None, along, inside, band: 0.0 };
        }
        let sides = config.wall_y_m.map(|y| Wall::fit(config, y, place, points));
        Self { sides: Some(sides), along, inside: config.wall_y_m, band: config.wall_band_m }
    }

    /// Whether a point along and across the way can belong to an obstacle: inside of the track and not on a wall.
    pub(crate) fn leaves(&self, point: Vector2<f64>) -> bool {
        if point.x < self.along[0] || point.x > self.along[1] {
            return false;
        }
        match &self.sides {
            None => point.y > self.inside[0] && point.y < self.inside[1],
            Some([right, left]) => right.inward(point) > self.band && left.inward(point) < -self.band,
        }
    }

    /// Extends the outline of a body that comes close to a wall up to the wall: the robot cannot pass in between.
    pub(crate) fn extend(&self, vertices: &mut Vec<Vertex>, from: usize) {
        let Some(sides) = &self.sides else { return };
        for index in from..vertices.len() {
            let vertex = vertices[index];
            for side in sides {
                let inward = side.inward(vertex.at);
                if inward.abs() < 2.0 * self.band {
                    vertices
                        .push(Vertex { at: Vector2::new(vertex.at.x, vertex.at.y - inward), end: End::Seen });
                }
            }
        }
    }
}

impl Wall {
    fn fit(config: &ObstaclesConfig, y: f64, place: &Place, points: &[Point]) -> Self {
        let mut wall = Self { y, from_x: place.at.x, offset: 0.0, slope: 0.0 };
        let noise = config.range_noise_m.powi(2);
        // The prior allows twice the stated uncertainty: that costs little, a wall taken for an obstacle costs much.
        let prior = Matrix2::from_diagonal(&Vector2::new(
            noise / (2.0 * config.pose_noise_m).powi(2),
            noise / (2.0 * config.pose_noise_rad).powi(2),
        ));
        for reach in FIT_M {
            let (mut normal, mut right, mut count) = (prior, Vector2::zeros(), 0);
            for point in points.iter().filter(|point| wall.inward(point.at).abs() < reach) {
                let along = point.at.x - wall.from_x;
                let residual = point.at.y - y;
                normal += Matrix2::new(1.0, along, along, along * along);
                right += Vector2::new(residual, along * residual);
                count += 1;
            }
            if count < FIT_POINTS {
                break;
            }
            let Some(solution) = normal.cholesky().map(|factor| factor.solve(&right)) else { break };
            wall.offset = solution.x.clamp(-0.15, 0.15);
            wall.slope = solution.y.clamp(-0.1, 0.1);
        }
        wall
    }

    /// How far a point is to the left of the wall [m].
    fn inward(&self, point: Vector2<f64>) -> f64 {
        point.y - self.y - self.offset - self.slope * (point.x - self.from_x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_seen_from_a_wrong_pose_is_still_a_wall() {
        let config = ObstaclesConfig { walls: true, ..ObstaclesConfig::default() };
        // 0.02 rad and 3 cm wrong: 5 m ahead the wall seems 0.13 m off, which the plain band would miss.
        let points: Vec<Point> = (0..60)
            .map(|index| {
                let along = 2.0 + 0.05 * f64::from(index);
                Point { at: Vector2::new(along, 1.5 + 0.03 + 0.02 * along), range: along, beam: 400 }
            })
            .collect();
        let place = Place::standing(Vector2::zeros(), 0.0);
        let walls = Walls::fit(&config, &place, &points);
        assert!(points.iter().all(|point| !walls.leaves(point.at)));
        assert!(walls.leaves(Vector2::new(3.0, 1.2)));
        assert!(!walls.leaves(Vector2::new(3.0, 2.2)), "beyond the wall is out");
    }

    #[test]
    fn without_walls_only_what_is_far_outside_of_the_track_is_ignored() {
        let place = Place::standing(Vector2::zeros(), 0.0);
        let config = ObstaclesConfig { track_x_m: [0.0, 5.0], ..ObstaclesConfig::default() };
        let walls = Walls::fit(&config, &place, &[]);
        assert!(walls.leaves(Vector2::new(5.5, 0.0)) && !walls.leaves(Vector2::new(5.7, 0.0)));
        assert!(walls.leaves(Vector2::new(3.0, 2.95)) && !walls.leaves(Vector2::new(3.0, -3.05)));
    }
}
