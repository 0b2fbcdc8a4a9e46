//! The lattice planner: the cheapest reference path in a lattice of arcs.
//!
//! Curvatures are multiples of one smallest bend, so the sines of the courses form a regular grid, and every
//! arc from one course to another has a fixed lateral rise: the search needs no trigonometry. Per layer, course
//! and lateral cell only the cheapest path is kept. Both sides of every obstacle are in the lattice, so closed
//! gaps, groups and walls need no rules of their own.
//!
//! Assumed: the curvature follows the steering angle at once (true within 30 ms at 1 m/s), and the path is
//! driven at a constant velocity, which matters for moving bodies only. Courses beyond 53 degrees are not
//! represented; a robot that stands across the track gets no clear path. Obstacles are checked twice per arc,
//! every 0.2 m, so a corner of an ellipse may be cut by millimetres, which the margin covers.

mod grid;

use grid::{BENDS, Grid};

use crate::obstacle_cost::{HARD, ObstacleCost, half_extent};
use crate::query::Query;
use crate::reference_path::{ReferencePath, SINE_MAX, rise};
use crate::scene::{Scene, excess};

/// Cosine of the largest course from which a path may start, a little beyond that of [`SINE_MAX`].
const MIN_COSINE: f64 = 0.55;
/// Width of a lateral cell [m].
const CELL_M: f64 = 0.1;
/// The same where every centimetre counts [m].
const NARROW_CELL_M: f64 = 0.04;

/// The cheapest path that ends in one cell of a layer.
#[derive(Debug, Clone, Copy)]
struct Cell {
    cost: f64,
    y: f64,
    parent: u32,
}

impl Cell {
    const UNREACHED: Self = Self { cost: f64::INFINITY, y: 0.0, parent: 0 };
}

/// An arc from one course to another.
#[derive(Debug, Clone, Copy)]
struct Arc {
    /// Its lateral rise [m].
    rise: f64,
    /// Its cost without that of the lateral position and of obstacles.
    cost: f64,
    /// Half extent of the body across the track at its end, and the larger one of both ends [m].
    extents: [f64; 2],
    /// First cell of the course at its end.
    row: usize,
}

/// The search with its buffers.
#[derive(Debug, Clone, Default)]
pub(crate) struct Search {
    cells: Vec<Cell>,
    active: Vec<Vec<u32>>,
    arcs: Vec<Arc>,
    /// Where the arcs of each course begin.
    arc_offsets: Vec<usize>,
    obstacle_cost: ObstacleCost,
}

impl Search {
    /// Puts the cheapest path of `query` into `reference_path`.
    ///
    /// Where every path enters an ellipse or leaves the bounds, the one that does so least is not `clear`.
    pub(crate) fn find(&mut self, query: &Query, reference_path: &mut ReferencePath) {
        let start = query.scene.initial;
        let grid = Grid::new(&query.scene, if query.narrow { NARROW_CELL_M } else { CELL_M });
        self.obstacle_cost.measure(query, grid.layers, grid.step);
        self.tabulate(&query.scene, &grid);
        self.reserve(&grid);
        // Most searches find a clear path; only the others consider paths through obstacles.
        for hard in [false, true] {
            let origin = grid.start_cell(start.y);
            self.cells[origin] = Cell { cost: 0.0, y: start.y, parent: 0 };
            self.active[0].push(origin as u32);
            for layer in 0..grid.layers {
                self.expand(layer, query, &grid, hard);
            }
            let found = self.read(query, &grid, reference_path);
            self.forget();
            if found {
                return;
            }
        }
        reference_path.set_line(start.x, query.scene.config.goal.y_m, query.speed);
        reference_path.clear = false;
    }

    fn reserve(&mut self, grid: &Grid) {
        let cells = (grid.layers + 1) * grid.layer_cells();
        if self.cells.len() < cells {
            self.cells.resize(cells, Cell::UNREACHED);
        }
        if self.active.len() <= grid.layers {
            self.active.resize_with(grid.layers + 1, Vec::new);
        }
    }

    /// Resets the cells that were reached.
    fn forget(&mut self) {
        for layer in &mut self.active {
            for &cell in layer.iter() {
                self.cells[cell as usize] = Cell::UNREACHED;
            }
            layer.clear();
        }
    }

    fn tabulate(&mut self, scene: &Scene, grid: &Grid) {
        let settings = &scene.config.guide;
        self.arcs.clear();
        self.arc_offsets.clear();
        for course in 0..grid.courses {
            self.arc_offsets.push(self.arcs.len());
            let from = grid.sine(course);
            for turn in -BENDS..=BENDS {
                let (next, curvature) = (course + turn, f64::from(turn) * grid.bend);
                let to = grid.sine(next);
                if next < 0 || next >= grid.courses || to.abs() > SINE_MAX {
                    continue;
                }
                let cost =
                    settings.curvature_weight * curvature * curvature + settings.course_weight * to * to;
                let extent = half_extent(scene, to);
                self.arcs.push(Arc {
                    rise: rise(from, to, grid.step),
                    cost: grid.step * cost,
                    extents: [extent, extent.max(half_extent(scene, from))],
                    row: next as usize * grid.cells,
                });
            }
        }
        self.arc_offsets.push(self.arcs.len());
    }

    /// Extends every path of one layer by all arcs; with `hard` also by those through obstacles.
    fn expand(&mut self, layer: usize, query: &Query, grid: &Grid, hard: bool) {
        let Scene { config, initial, y_range, .. } = query.scene;
        let (settings, step) = (config.guide, grid.step);
        // How far the robot is outside of its bounds already.
        let allowed = excess(initial.y, y_range);
        let sources = std::mem::take(&mut self.active[layer]);
        let base = (layer + 1) * grid.layer_cells();
        let crossed = self.obstacle_cost.has_crossing(layer);
        for &source in &sources {
            let Cell { cost, y, .. } = self.cells[source as usize];
            let course = grid.course(source as usize) as usize;
            for arc in &self.arcs[self.arc_offsets[course]..self.arc_offsets[course + 1]] {
                let y_next = y + arc.rise;
                let Some(cell) = grid.cell(y_next) else { continue };
                let target = base + arc.row + cell;
                let known = self.cells[target].cost;
                let offset = y_next - config.goal.y_m;
                let mut total = cost + arc.cost + step * settings.lateral_weight * offset * offset;
                // All further costs are positive: most arcs end here.
                if total >= known {
                    continue;
                }
                let [extent, larger] = arc.extents;
                let middle = y + arc.rise / 2.0;
                total += self.obstacle_cost.cost(&settings, 2 * layer + 1, middle, step / 2.0, larger);
                total += self.obstacle_cost.cost(&settings, 2 * layer + 2, y_next, step / 2.0, extent);
                if crossed {
                    total += self.obstacle_cost.switches(layer, y, y_next, settings.switch_cost);
                }
                let outside = excess(y_next, y_range) - allowed;
                if outside > 1e-9 {
                    total += HARD * (1.0 + 10.0 * outside);
                }
                if (total >= HARD && !hard) || total >= known {
                    continue;
                }
                if known == f64::INFINITY {
                    self.active[layer + 1].push(target as u32);
                }
                self.cells[target] = Cell { cost: total, y: y_next, parent: source };
            }
        }
        self.active[layer] = sources;
    }

    /// Follows the cheapest path back from its end; false when no path reaches the end.
    fn read(&self, query: &Query, grid: &Grid, reference_path: &mut ReferencePath) -> bool {
        let Scene { config, initial: start, .. } = query.scene;
        let at_goal = start.x + grid.step * grid.layers as f64 >= config.goal.x_m - 1e-6;
        let weight = if at_goal { config.guide.goal_weight } else { config.guide.lateral_weight };
        let mut best = (f64::INFINITY, 0usize);
        for &cell in &self.active[grid.layers] {
            let cell = cell as usize;
            let sine = grid.sine(grid.course(cell));
            let offset = self.cells[cell].y - config.goal.y_m;
            let total = self.cells[cell].cost + weight * offset * offset + sine * sine;
            if total < best.0 {
                best = (total, cell);
            }
        }
        if best.0 == f64::INFINITY {
            return false;
        }
        (reference_path.start_x, reference_path.step, reference_path.speed) =
            (start.x, grid.step, query.speed);
        reference_path.clear = best.0 < HARD && (start.yaw + start.sideslip).cos() > MIN_COSINE;
        reference_path.limits.clear();
        reference_path.y.clear();
        reference_path.sine.clear();
        let mut cell = best.1;
        for _ in 0..=grid.layers {
            reference_path.y.push(self.cells[cell].y);
            reference_path.sine.push(grid.sine(grid.course(cell)));
            cell = self.cells[cell].parent as usize;
        }
        reference_path.y.reverse();
        reference_path.sine.reverse();
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::predicted_obstacle::PredictedObstacle;
    use crate::side::{Passing, Sides, hold};
    use nalgebra::Vector2;
    use vehicle::geometry::Rectangle;
    use vehicle::{Goal, State};

    fn obstacle_at(id: u32, x: f64, y: f64, b: f64) -> PredictedObstacle {
        let body = Rectangle { centre: Vector2::new(x, y), yaw: 0.0, length: 0.1, width: 0.1 };
        PredictedObstacle { id, centre: [x, y], velocity: [0.0, 0.0], a: 1.2, b, body }
    }

    fn find(start: State, predicted: &[PredictedObstacle], sides: &Sides) -> ReferencePath {
        let config = Config { goal: Goal { x_m: 30.0, ..Goal::default() }, ..Config::default() };
        let query = Query {
            scene: Scene::new(&config, predicted, start),
            speed: 1.0,
            narrow: true,
            sides,
            forced: None,
        };
        let mut reference_path = ReferencePath::default();
        Search::default().find(&query, &mut reference_path);
        reference_path
    }

    #[test]
    fn a_centred_obstacle_is_passed_outside_of_its_ellipse() {
        let obstacle = obstacle_at(1, 4.5, 0.0, 0.9);
        let reference_path = find(State::default(), &[obstacle], &Sides::default());
        assert!(reference_path.clear);
        for step in 0..60 {
            let x = f64::from(step) * 0.1;
            let (y, _, curvature) = reference_path.at(x);
            assert!(obstacle.value(0.0, x, y) > 0.99, "{x} {y}");
            assert!(y.abs() <= 1.5 && curvature.abs() <= 0.3241);
        }
        assert_ne!(reference_path.side_of(&obstacle), None);
    }

    #[test]
    fn a_closed_side_is_not_taken() {
        let obstacle = obstacle_at(1, 4.5, 0.7, 0.9);
        assert_eq!(
            find(State::default(), &[obstacle], &Sides::default()).side_of(&obstacle),
            Some(Passing::Right)
        );
        let wide = obstacle_at(1, 4.5, 0.0, 1.6);
        assert!(!find(State::default(), &[wide], &Sides::default()).clear);
    }

    #[test]
    fn the_gap_between_two_ellipses_is_used_only_when_it_is_open() {
        let pair = [obstacle_at(1, 4.5, 0.75, 0.7), obstacle_at(2, 4.5, -0.75, 0.7)];
        assert!(find(State::default(), &pair, &Sides::default()).clear);
        let closed = [obstacle_at(1, 4.5, 0.7, 0.85), obstacle_at(2, 4.5, -0.7, 0.85)];
        assert!(!find(State::default(), &closed, &Sides::default()).clear);
    }

    #[test]
    fn the_held_side_is_kept_although_the_other_is_a_little_cheaper() {
        let obstacle = obstacle_at(1, 4.5, 0.03, 0.8);
        assert_eq!(
            find(State::default(), &[obstacle], &Sides::default()).side_of(&obstacle),
            Some(Passing::Right)
        );
        let mut sides = Sides::default();
        hold(&mut sides, &obstacle, Passing::Left);
        assert_eq!(find(State::default(), &[obstacle], &sides).side_of(&obstacle), Some(Passing::Left));
    }

    #[test]
    fn an_obstacle_too_near_has_no_clear_path() {
        assert!(!find(State::default(), &[obstacle_at(1, 2.0, 0.0, 0.9)], &Sides::default()).clear);
    }
}
