//! The grid of the lattice: layers along the track, with courses and lateral cells.

use crate::predicted_obstacle::PredictedObstacle;
use crate::reference_path::SINE_MAX;
use crate::scene::Scene;

/// Curvatures of an arc: this many to each side, and straight.
const BENDS: i32 = 2;
/// The same along a course, whose own curvature is one of these steps: a path uses the largest curvature, half of it, and
/// those of the straight path and of the course.
const COURSE_BENDS: i32 = 6;
/// Shortest path that is searched, unless the goal is nearer [m]: a little longer than the horizon.
const SHORTEST_M: f64 = 3.2;
/// How much further than its range a search looks for the goal [m]: about a turn to the side and back, so that an obstacle
/// is passed on a side from which the goal can be reached.
const GOAL_M: f64 = 3.2;
/// How far beyond the bounds cells reach, for a robot that is outside [m].
const OUTSIDE_M: f64 = 0.6;

/// Layers along the track, each with courses and lateral cells.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    pub(super) layers: usize,
    /// Length of an arc along x [m].
    pub(super) step: f64,
    /// Smallest curvature that is not zero [1/m].
    pub(super) bend: f64,
    /// How many of these the largest curvature of a path is.
    pub(super) bends: i32,
    pub(super) start_sine: f64,
    pub(super) sine_step: f64,
    pub(super) start_course: i32,
    pub(super) courses: i32,
    pub(super) low: f64,
    pub(super) cells_per_m: f64,
    pub(super) cells: usize,
}

/// Most courses of a search; the narrowest allowed bounds of the steering angle need 2900. A robot that turns even less drives
/// straight: over the range of a search it gets 2 cm to the side.
const MAX_COURSES: f64 = 4000.0;

impl Grid {
    pub(super) fn new(scene: &Scene, cell_m: f64) -> Self {
        let Scene { config, initial: start, y_range, .. } = *scene;
        let length =
            (config.goal.x_m - start.x).clamp(0.05, config.guide.range_m + GOAL_M).min(needed(scene));
        let layers = (length / config.guide.step_m).ceil().max(1.0) as usize;
        let step = length / layers as f64;
        let curvature = scene.full_lock_curvature(config.cruise_mps);
        let bends = if config.course.is_line() { BENDS } else { COURSE_BENDS };
        let bend = curvature * config.guide.curvature_share / f64::from(bends);
        let sine_step = bend * step;
        let (sin, cos) = (start.yaw + start.sideslip).sin_cos();
        let start_sine = if cos > 0.0 { sin.clamp(-SINE_MAX, SINE_MAX) } else { SINE_MAX.copysign(sin) };
        let right = ((start_sine + SINE_MAX) / sine_step + 1e-9).floor();
        let left = ((SINE_MAX - start_sine) / sine_step + 1e-9).floor();
        let turns = right + left < MAX_COURSES;
        let [right, left] = [right, left].map(|courses| if turns { courses as i32 } else { 0 });
        let low = y_range[0].min(start.y) - OUTSIDE_M;
        let high = y_range[1].max(start.y) + OUTSIDE_M;
        let cells = ((high - low) / cell_m).ceil().clamp(1.0, 2e3) as usize;
        let courses = right + left + 1;
        Self {
            layers,
            step,
            bend,
            bends,
            start_sine,
            sine_step,
            start_course: right,
            courses,
            low,
            cells_per_m: 1.0 / cell_m,
            cells,
        }
    }

    /// The curvature of the course at a layer, in smallest curvatures.
    pub(super) fn course_bend(&self, scene: &Scene, layer: usize) -> i32 {
        let along = scene.initial.x + (layer as f64 + 0.5) * self.step;
        (scene.config.course.curvature(along) / self.bend).round().clamp(-1e3, 1e3) as i32
    }

    /// Curvatures of the arcs against a course with this one, in smallest curvatures, from right to left.
    pub(super) fn turns(&self, course_bend: i32) -> impl Iterator<Item = i32> {
        let (half, bends) = (self.bends / 2, self.bends);
        (-bends - course_bend.max(0)..=bends - course_bend.min(0)).filter(move |turn| {
            let in_plane = turn + course_bend;
            in_plane.abs() <= bends && (in_plane % half == 0 || *turn == 0)
        })
    }

    /// The same with cells of another width.
    pub(super) fn with_cells(self, cell_m: f64) -> Self {
        let cells = (self.cells as f64 / self.cells_per_m / cell_m).ceil().max(1.0) as usize;
        Self { cells_per_m: 1.0 / cell_m, cells, ..self }
    }

    /// Whether the last layer is at the goal.
    pub(super) fn ends_at_goal(&self, scene: &Scene) -> bool {
        scene.initial.x + self.step * self.layers as f64 >= scene.config.goal.x_m - 1e-6
    }

    pub(super) fn layer_cells(&self) -> usize {
        self.courses as usize * self.cells
    }

    pub(super) fn sine(&self, course: i32) -> f64 {
        self.start_sine + self.sine_step * f64::from(course - self.start_course)
    }

    pub(super) fn cell(&self, y: f64) -> Option<usize> {
        let cell = (y - self.low) * self.cells_per_m;
        // By way of a signed number, which takes the processor fewer instructions.
        (cell >= 0.0 && cell < self.cells as f64).then_some(cell as i32 as usize)
    }

    pub(super) fn start_cell(&self, y: f64) -> usize {
        self.start_course as usize * self.cells + self.cell(y).unwrap_or(0)
    }
}

/// Distance over which there is something to decide [m]: up to behind the last obstacle in sight, or to the goal.
fn needed(scene: &Scene) -> f64 {
    let Scene { config, predicted, initial: start, .. } = *scene;
    let range_m = config.guide.range_m;
    if config.goal.x_m - start.x < range_m + GOAL_M {
        return f64::INFINITY;
    }
    let behind = |obstacle: &PredictedObstacle| {
        if obstacle.moves() { f64::INFINITY } else { obstacle.centre[0] + obstacle.a - start.x }
    };
    predicted.iter().map(behind).fold(SHORTEST_M, f64::max).min(range_m)
}
