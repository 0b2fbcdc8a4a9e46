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
//!
//! A sketch with few curvatures and wide cells comes first. Its cost bounds that of the cheapest path, so paths that
//! must cost more are left out: half of them. The result is that of a search of all paths.

mod grid;

use grid::Grid;

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
/// The same in a sketch [m].
const SKETCH_CELL_M: f64 = 0.5;
/// Paths that cost more than this share of a sketched one are not searched. It is above 1, because the cheapest path to a
/// cell need not be the start of the cheapest path to the end.
const SKETCH_SHARE: f64 = 1.02;
/// Cost of a path that passes the goal farther away than its tolerance: more than any detour to it, and less than a way
/// through an obstacle.
const MISSED: f64 = 100.0;
/// Arcs ahead for which the lateral cost that a path can't avoid is counted.
const AHEAD: usize = 5;

/// The end of the cheapest path to one cell of a layer.
#[derive(Debug, Clone, Copy, Default)]
struct End {
    y: f64,
    parent: u32,
    course: u32,
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
    /// The course at its end.
    course: u32,
    /// Whether it belongs to a sketch: it is straight or has the largest curvature.
    is_sketched: bool,
}

/// Which paths a pass of the search extends.
#[derive(Debug, Clone, Copy)]
struct Pass {
    /// Paths through obstacles too.
    hard: bool,
    /// Straight arcs and those with the largest curvature only.
    sketch: bool,
    /// Paths that must cost more are left out.
    limit: f64,
}

/// The search with its buffers.
#[derive(Debug, Clone, Default)]
pub(crate) struct Search {
    /// By cell: the cost of the cheapest path, infinite where none ends. Apart from the rest, as it is read most.
    costs: Vec<f64>,
    ends: Vec<End>,
    active: Vec<Vec<u32>>,
    arcs: Vec<Arc>,
    /// Where the arcs of each direction begin, for one curvature of the course after the other.
    arc_offsets: Vec<usize>,
    /// The curvatures of the course, in smallest curvatures of a path.
    course_bends: Vec<i32>,
    /// By layer: which of them it has there.
    bend_of_layer: Vec<usize>,
    /// For each course the rises of the next arcs when the path turns right, or left, as fast as it can [m].
    swerves: Vec<[[f64; AHEAD]; 2]>,
    obstacle_cost: ObstacleCost,
}

impl Search {
    /// Puts the cheapest path of `query` into `reference_path`.
    ///
    /// Where every path enters an ellipse or leaves the bounds, the one that does so least is not `clear`.
    pub(crate) fn find(&mut self, query: &Query, reference_path: &mut ReferencePath) {
        let grid = self.prepare(query);
        let sketched = self.sketch(query, &grid);
        self.search(query, &grid, SKETCH_SHARE * sketched, reference_path);
    }

    /// Tabulates arcs and obstacles.
    fn prepare(&mut self, query: &Query) -> Grid {
        let grid = Grid::new(&query.scene, if query.narrow { NARROW_CELL_M } else { CELL_M });
        self.obstacle_cost.measure(query, grid.layers, grid.step);
        self.tabulate(&query.scene, &grid);
        grid
    }

    /// The cheapest path; first only paths that cost at most `limit` are extended.
    fn search(&mut self, query: &Query, grid: &Grid, limit: f64, reference_path: &mut ReferencePath) {
        // Most searches find a clear path; only the others consider paths through obstacles.
        let clear = Pass { hard: false, sketch: false, limit: f64::INFINITY };
        let passes = [Pass { limit, ..clear }, clear, Pass { hard: true, ..clear }];
        for pass in &passes[usize::from(limit == f64::INFINITY)..] {
            self.reach(query, grid, pass);
            let found = self.read(query, grid, pass.limit, reference_path);
            self.forget();
            if found {
                return;
            }
        }
        reference_path.set_line(query.scene.initial.x, query.scene.config.goal.y_m, query.speed);
        reference_path.clear = false;
    }

    /// Cost of a clear path that is found fast, with few curvatures and wide cells; infinite when there is none.
    fn sketch(&mut self, query: &Query, grid: &Grid) -> f64 {
        let grid = grid.with_cells(SKETCH_CELL_M);
        self.reach(query, &grid, &Pass { hard: false, sketch: true, limit: f64::INFINITY });
        let (cost, _) = self.cheapest(query, &grid);
        self.forget();
        cost
    }

    /// Extends paths from the start to the last layer.
    fn reach(&mut self, query: &Query, grid: &Grid, pass: &Pass) {
        self.reserve(grid);
        let y = query.scene.initial.y;
        let origin = grid.start_cell(y);
        self.costs[origin] = 0.0;
        self.ends[origin] = End { y, parent: 0, course: grid.start_course as u32 };
        self.active[0].push(origin as u32);
        for layer in 0..grid.layers {
            self.expand(layer, query, grid, pass);
        }
    }

    fn reserve(&mut self, grid: &Grid) {
        let cells = (grid.layers + 1) * grid.layer_cells();
        if self.costs.len() < cells {
            self.costs.resize(cells, f64::INFINITY);
            self.ends.resize(cells, End::default());
        }
        if self.active.len() <= grid.layers {
            self.active.resize_with(grid.layers + 1, Vec::new);
        }
    }

    /// Resets the cells that were reached.
    fn forget(&mut self) {
        for layer in &mut self.active {
            for &cell in layer.iter() {
                self.costs[cell as usize] = f64::INFINITY;
            }
            layer.clear();
        }
    }

    fn tabulate(&mut self, scene: &Scene, grid: &Grid) {
        self.arcs.clear();
        self.arc_offsets.clear();
        self.course_bends.clear();
        self.bend_of_layer.clear();
        for layer in 0..grid.layers {
            let bend = grid.course_bend(scene, layer);
            let known = self.course_bends.iter().position(|known| *known == bend);
            self.bend_of_layer.push(known.unwrap_or(self.course_bends.len()));
            if known.is_none() {
                self.course_bends.push(bend);
                self.tabulate_arcs(scene, grid, bend);
            }
        }
        self.arc_offsets.push(self.arcs.len());
        self.swerve(grid);
    }

    /// Tabulates the arcs where the course has this curvature, in smallest curvatures.
    fn tabulate_arcs(&mut self, scene: &Scene, grid: &Grid, course_bend: i32) {
        let settings = &scene.config.guide;
        for course in 0..grid.courses {
            self.arc_offsets.push(self.arcs.len());
            let from = grid.sine(course);
            for turn in grid.turns(course_bend) {
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
                    course: next as u32,
                    is_sketched: turn == 0 || (turn + course_bend).abs() == grid.bends,
                });
            }
        }
    }

    /// Tabulates the fastest turns to both sides.
    fn swerve(&mut self, grid: &Grid) {
        let Self { arcs, arc_offsets, swerves, .. } = self;
        swerves.clear();
        for course in 0..grid.courses as usize {
            let mut rises = [[0.0; AHEAD]; 2];
            for (side, rises) in rises.iter_mut().enumerate() {
                let (mut course, mut sum) = (course, 0.0);
                for rise in rises {
                    let from = &arcs[arc_offsets[course]..arc_offsets[course + 1]];
                    if let Some(arc) = if side == 0 { from.first() } else { from.last() } {
                        (course, sum) = (arc.course as usize, sum + arc.rise);
                    }
                    *rise = sum;
                }
            }
            swerves.push(rises);
        }
    }

    /// Extends the paths of one layer by an arc.
    fn expand(&mut self, layer: usize, query: &Query, grid: &Grid, pass: &Pass) {
        let Scene { config, initial, .. } = query.scene;
        let (settings, step) = (config.guide, grid.step);
        // How far the robot is outside of its bounds already.
        let allowed = excess(initial.y, query.scene.y_range_at(initial.x));
        let y_range = query.scene.y_range_at(initial.x + (layer + 1) as f64 * grid.step);
        let Self { costs, ends, active, arcs, arc_offsets, bend_of_layer, swerves, obstacle_cost, .. } = self;
        let Pass { hard, sketch, limit } = *pass;
        // The fastest turns are those of the first layer; where the course bends they tell nothing.
        let ahead = if config.course.is_line() { AHEAD.min(grid.layers - layer) } else { 0 };
        let arc_offsets = &arc_offsets[bend_of_layer[layer] * grid.courses as usize..];
        let [.., sources, reached] = &mut active[..layer + 2] else { return };
        // Paths to this layer are read, those to the next are written.
        let split = (layer + 1) * grid.layer_cells();
        let (costs, next_costs) = costs.split_at_mut(split);
        let (ends, next_ends) = ends.split_at_mut(split);
        let (crossed, near) = (obstacle_cost.has_crossing(layer), obstacle_cost.reaches(layer));
        let lateral = step * settings.lateral_weight;
        for &source in sources.iter() {
            let (cost, End { y, course, .. }) = (costs[source as usize], ends[source as usize]);
            let course = course as usize;
            if cost + lateral * squares(y - config.goal.y_m, &swerves[course], ahead) > limit {
                continue;
            }
            for arc in &arcs[arc_offsets[course]..arc_offsets[course + 1]] {
                if sketch && !arc.is_sketched {
                    continue;
                }
                let y_next = y + arc.rise;
                let Some(cell) = grid.cell(y_next) else { continue };
                let target = arc.course as usize * grid.cells + cell;
                let known = next_costs[target].min(limit);
                let offset = y_next - config.goal.y_m;
                let mut total = cost + arc.cost + lateral * offset * offset;
                // All further costs are positive: most arcs end here.
                if total >= known {
                    continue;
                }
                if near {
                    let [extent, larger] = arc.extents;
                    let middle = y + arc.rise / 2.0;
                    total += obstacle_cost.cost(&settings, 2 * layer + 1, middle, step / 2.0, larger);
                    total += obstacle_cost.cost(&settings, 2 * layer + 2, y_next, step / 2.0, extent);
                }
                if crossed {
                    total += obstacle_cost.switches(layer, y, y_next, settings.switch_cost);
                }
                let outside = excess(y_next, y_range) - allowed;
                if outside > 1e-9 {
                    total += HARD * (1.0 + 10.0 * outside);
                }
                if (total >= HARD && !hard) || total >= known {
                    continue;
                }
                if next_costs[target] == f64::INFINITY {
                    reached.push((split + target) as u32);
                }
                next_costs[target] = total;
                next_ends[target] = End { y: y_next, parent: source, course: arc.course };
            }
        }
    }

    /// Cost and last cell of the cheapest path; infinite when no path reaches the end.
    fn cheapest(&self, query: &Query, grid: &Grid) -> (f64, usize) {
        let Scene { config, .. } = query.scene;
        let at_goal = grid.ends_at_goal(&query.scene);
        let weight = if at_goal { config.guide.goal_weight } else { config.guide.lateral_weight };
        let mut best = (f64::INFINITY, 0);
        for &cell in &self.active[grid.layers] {
            let cell = cell as usize;
            let End { y, course, .. } = self.ends[cell];
            let (sine, offset) = (grid.sine(course as i32), y - config.goal.y_m);
            let missed = if at_goal && offset.abs() > config.goal.tolerance_m { MISSED } else { 0.0 };
            let total = self.costs[cell] + weight * offset * offset + sine * sine + missed;
            if total < best.0 {
                best = (total, cell);
            }
        }
        best
    }

    /// Follows the cheapest path back from its end; false when no path reaches the end within `limit`.
    fn read(&self, query: &Query, grid: &Grid, limit: f64, reference_path: &mut ReferencePath) -> bool {
        let start = query.scene.initial;
        let best = self.cheapest(query, grid);
        if best.0 == f64::INFINITY || best.0 > limit {
            return false;
        }
        (reference_path.start_x, reference_path.step, reference_path.speed) =
            (start.x, grid.step, query.speed);
        reference_path.clear = best.0 < HARD && (start.yaw + start.sideslip).cos() > MIN_COSINE;
        let offset = self.ends[best.1].y - query.scene.config.goal.y_m;
        reference_path.misses_goal =
            grid.ends_at_goal(&query.scene) && offset.abs() > query.scene.config.goal.tolerance_m;
        reference_path.limits.clear();
        reference_path.y.clear();
        reference_path.sine.clear();
        let mut cell = best.1;
        for _ in 0..=grid.layers {
            let End { y, parent, course } = self.ends[cell];
            reference_path.y.push(y);
            reference_path.sine.push(grid.sine(course as i32));
            cell = parent as usize;
        }
        reference_path.y.reverse();
        reference_path.sine.reverse();
        true
    }
}

/// Sum of the squares of the offsets after the next arcs, at least: for a path that turns to the line as fast as it can.
fn squares(offset: f64, [right, left]: &[[f64; AHEAD]; 2], arcs: usize) -> f64 {
    let (side, rises) = if offset > 0.0 { (1.0, right) } else { (-1.0, left) };
    rises[..arcs].iter().map(|rise| (side * (offset + rise)).max(0.0).powi(2)).sum()
}

#[cfg(test)]
mod tests;
