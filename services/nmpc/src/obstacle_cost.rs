//! The obstacle cost of the lattice search, tabulated per layer before the search begins.
//!
//! A path stays outside of all ellipses. Where a body is a box along the track, the clearance is kept between the body of
//! the robot, turned as its course, and the box; other bodies have the clearance in their ellipse.

use vehicle::State;
use vehicle::geometry::Rectangle;

use crate::predicted_obstacle::PredictedObstacle;
use crate::query::Query;
use crate::reference_path::LatticeSettings;
use crate::scene::Scene;
use crate::side::{Passing, held};

/// Cost of a violated ellipse or bound: larger than the sum of all other costs of a path.
pub(crate) const HARD: f64 = 1e3;
/// Share of its depth that a robot inside an ellipse must keep; the rest allows for rounding.
const SHRINK: f64 = 0.995;

/// Distance to the clearance of a straight box that is worth a detour [m].
const SIDE_COMFORT_M: f64 = 0.06;
/// A box is straight when the sine of twice its yaw is below this.
const STRAIGHT: f64 = 0.2;
/// Sine of the course up to which the length of the body along the track is right.
const BODY_TURN: f64 = 0.2;

/// The extent of one ellipse across the track at one x: with the clearance that a plan must keep, with the margin of the
/// optimal control problem, and with the comfort distance.
#[derive(Debug, Clone, Copy)]
struct Span {
    centre: f64,
    hard: f64,
    /// Half the width of the box with the clearance; the robot's own half extent comes on top.
    side: f64,
    margin: f64,
    comfort: f64,
}

/// The centre of an obstacle whose held side is known, between two layers.
#[derive(Debug, Clone, Copy)]
struct Crossing {
    layer: usize,
    share: f64,
    centre: f64,
    side: Passing,
    /// Cost of the other side, where it is not that of the settings.
    forced: bool,
}

/// Extents of the ellipses at every half layer, and where their centres are crossed.
#[derive(Debug, Clone, Default)]
pub(crate) struct ObstacleCost {
    spans: Vec<Span>,
    /// Where the spans of each half layer begin.
    offsets: Vec<usize>,
    crossings: Vec<Crossing>,
}

impl ObstacleCost {
    /// Tabulates the extent of every ellipse at every half layer, and where centres are crossed.
    pub(crate) fn measure(&mut self, query: &Query, layers: usize, step: f64) {
        let Scene { config, predicted, initial: start, .. } = query.scene;
        let margin = config.ellipse_margin_m;
        self.spans.clear();
        self.offsets.clear();
        self.crossings.clear();
        for half in 0..=2 * layers {
            self.offsets.push(self.spans.len());
            let along = half as f64 * step / 2.0;
            let t = along / query.speed;
            let growth = query.scene.margin.growth(t, query.speed);
            for obstacle in predicted.iter().filter(|obstacle| !query.scene.is_beyond_goal(obstacle)) {
                // Around a robot already inside, the ellipse is shrunk until it is just outside: it must not go deeper.
                // The box of a straight body has the clearance; the ellipses of others have it.
                let grown = if is_straight(obstacle) { 0.0 } else { growth };
                let scale = obstacle.grown(grown).value(0.0, start.x, start.y).sqrt() * SHRINK;
                let scale = if scale < 1.0 { scale } else { 1.0 };
                let [centre_x, centre_y] = obstacle.centre_at(t);
                let across = |grown: f64, scale: f64| {
                    let ratio = (start.x + along - centre_x) / ((obstacle.a + grown) * scale);
                    (obstacle.b + grown) * scale * (1.0 - ratio * ratio).max(0.0).sqrt()
                };
                let comfort = across(growth + margin + config.guide.comfort_m, 1.0);
                let side = side_of_box(query, obstacle, along, t);
                if comfort > 0.0 {
                    let hard = across(grown, scale);
                    let margin = across(growth + margin, 1.0);
                    self.spans.push(Span { centre: centre_y, hard, side, margin, comfort });
                }
            }
        }
        self.offsets.push(self.spans.len());
        for obstacle in predicted {
            let forced = query.forced.filter(|(id, _)| *id == obstacle.id).map(|(_, side)| side);
            if let Some(side) = forced.or_else(|| held(query.sides, obstacle))
                && let Some(crossing) = crossing_of(obstacle, side, query, layers, step)
            {
                self.crossings.push(Crossing { forced: forced.is_some(), ..crossing });
            }
        }
    }

    /// Cost of being at `y` for `length` along half layer `half`, with a body that reaches `extent` to either side.
    pub(crate) fn cost(
        &self,
        settings: &LatticeSettings,
        half: usize,
        y: f64,
        length: f64,
        extent: f64,
    ) -> f64 {
        let mut cost = 0.0;
        for span in &self.spans[self.offsets[half]..self.offsets[half + 1]] {
            let offset = (y - span.centre).abs();
            if offset < span.comfort {
                cost += settings.comfort_weight * length * (span.comfort - offset);
                if offset < span.margin {
                    cost += 10.0 * settings.comfort_weight * length * (span.margin - offset);
                }
                let side = span.side + extent;
                if offset < side + SIDE_COMFORT_M {
                    cost += 10.0 * settings.comfort_weight * length * (side + SIDE_COMFORT_M - offset);
                }
                let hard = span.hard.max(side);
                if offset < hard {
                    cost += HARD * (1.0 + 10.0 * (hard - offset));
                }
            }
        }
        cost
    }

    /// Whether an ellipse reaches the arcs from this layer to the next.
    pub(crate) fn reaches(&self, layer: usize) -> bool {
        self.offsets[2 * layer + 1] < self.offsets[2 * layer + 3]
    }

    /// Whether the centre of an obstacle with a held side is crossed from this layer to the next.
    pub(crate) fn has_crossing(&self, layer: usize) -> bool {
        self.crossings.iter().any(|crossing| crossing.layer == layer)
    }

    /// Cost of the obstacles that an arc from this layer to the next passes on the side that is not held.
    pub(crate) fn switches(&self, layer: usize, from: f64, to: f64, switch_cost: f64) -> f64 {
        let switched = |crossing: &&Crossing| {
            let y = from + crossing.share * (to - from);
            crossing.layer == layer && (y > crossing.centre) != (crossing.side == Passing::Left)
        };
        self.crossings
            .iter()
            .filter(switched)
            .map(|crossing| if crossing.forced { HARD } else { switch_cost })
            .sum()
    }
}

/// Whether the box of the body lies along the track, so that its sides are straight.
fn is_straight(obstacle: &PredictedObstacle) -> bool {
    (2.0 * obstacle.body.yaw).sin().abs() < STRAIGHT
}

/// Half the width of a straight box with the clearance that a plan keeps, `along` metres from the start, where the robot
/// passes it; minus infinity elsewhere.
fn side_of_box(query: &Query, obstacle: &PredictedObstacle, along: f64, t: f64) -> f64 {
    let scene = &query.scene;
    if !is_straight(obstacle) {
        return f64::NEG_INFINITY;
    }
    let Rectangle { centre, yaw, length, width } = obstacle.body_at(t);
    let (sin, cos) = (yaw.sin().abs(), yaw.cos().abs());
    let margin = scene.margin.sum(t, query.speed);
    let half = [length * cos + width * sin, length * sin + width * cos].map(|size| size / 2.0);
    let vehicle = &scene.config.vehicle;
    let reach = half[0] + (vehicle.length_m + BODY_TURN * vehicle.width_m) / 2.0;
    let State { x, y, yaw, sideslip, .. } = scene.initial;
    // Before and behind the box the clearance is that to its corners.
    let beyond = ((x + along - centre.x).abs() - reach).max(0.0);
    if beyond > margin {
        return f64::NEG_INFINITY;
    }
    let side = half[1] + (margin * margin - beyond * beyond).sqrt();
    if !query.narrow {
        return side;
    }
    // A robot that is nearer already must not come nearer.
    let extent = half_extent(scene, (yaw + sideslip).sin().clamp(-1.0, 1.0));
    if (x - centre.x).abs() < reach + margin {
        side.min((y - centre.y).abs() * SHRINK - extent)
    } else {
        side
    }
}

/// How far the body reaches to either side across the track when its course has this sine [m].
pub(crate) fn half_extent(scene: &Scene, sine: f64) -> f64 {
    let vehicle = &scene.config.vehicle;
    (vehicle.length_m * sine.abs() + vehicle.width_m * (1.0 - sine * sine).sqrt()) / 2.0
}

fn crossing_of(
    obstacle: &PredictedObstacle,
    side: Passing,
    query: &Query,
    layers: usize,
    step: f64,
) -> Option<Crossing> {
    for layer in 0..layers {
        let t = [layer, layer + 1].map(|layer| layer as f64 * step / query.speed);
        let x = [layer, layer + 1].map(|layer| query.scene.initial.x + layer as f64 * step);
        let (before, after) = (x[0] - obstacle.centre_at(t[0])[0], x[1] - obstacle.centre_at(t[1])[0]);
        if before < 0.0 && after >= 0.0 {
            let share = -before / (after - before);
            let centre = obstacle.centre_at(t[0] + share * (t[1] - t[0]))[1];
            return Some(Crossing { layer, share, centre, side, forced: false });
        }
    }
    None
}
