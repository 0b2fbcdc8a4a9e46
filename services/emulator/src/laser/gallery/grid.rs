//! Segments in the plane, sorted into the cells of a grid, and the first one that a beam meets.

use nalgebra::Vector2;

/// Smallest side of a cell [m].
const CELL_M: f64 = 1.0;
/// Most cells; beside a course that covers more the cells are larger.
const MAX_CELLS: f64 = 1e6;
/// Longer segments are not made of shorter ones, so that each is in few cells [m].
const MAX_M: f64 = 2.0;
/// Largest sine of the angle between two segments that are one.
const STRAIGHT: f64 = 1e-9;
/// A beam that passes an end of a segment by this share of its length still meets it: there is no gap between two.
const JOINT: f64 = 1e-9;

/// A straight piece of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Segment {
    from: Vector2<f64>,
    way: Vector2<f64>,
}

impl Segment {
    pub(super) fn between(from: Vector2<f64>, to: Vector2<f64>) -> Self {
        Self { from, way: to - from }
    }

    /// Continues to the begin of `next` and through it when that is straight on; false when it is not.
    pub(super) fn extend(&mut self, next: &Self) -> bool {
        let whole = next.from + next.way - self.from;
        let is_straight = (self.from + self.way - next.from).amax() < 1e-9
            && whole.norm() <= MAX_M
            && self.way.perp(&next.way).abs() < STRAIGHT * self.way.norm() * next.way.norm();
        if is_straight {
            self.way = whole;
        }
        is_straight
    }

    /// Distance along a beam to the segment, infinite when the beam misses it.
    fn range(&self, origin: Vector2<f64>, direction: Vector2<f64>) -> f64 {
        let offset = self.from - origin;
        let across = direction.perp(&self.way);
        let share = offset.perp(&direction) * across.signum();
        // Most segments are missed, which is told without a division.
        if share < -JOINT * across.abs() || share > (1.0 + JOINT) * across.abs() {
            return f64::INFINITY;
        }
        // Not finite for a beam along the segment.
        let range = offset.perp(&self.way) / across;
        if range >= 0.0 { range } else { f64::INFINITY }
    }
}

/// The segments by cell.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    low: Vector2<f64>,
    cell: f64,
    size: [i64; 2],
    /// Where the segments of each cell begin in `segments`, row by row, and the end of the last.
    begins: Vec<u32>,
    segments: Vec<Segment>,
    /// Reach of the scanner [m].
    reach_m: f64,
}

impl Grid {
    pub(super) fn new(all: Vec<Segment>, reach_m: f64) -> Self {
        let ends = || all.iter().flat_map(|segment| [segment.from, segment.from + segment.way]);
        let low = ends().reduce(|low, point| low.inf(&point)).unwrap_or_default();
        let high = ends().reduce(|high, point| high.sup(&point)).unwrap_or_default();
        let span = high - low;
        let cell = (span.x * span.y / MAX_CELLS).sqrt().max(CELL_M);
        let size = [span.x, span.y].map(|length| (length / cell).floor() as i64 + 1);
        let mut grid = Self { low, cell, size, begins: Vec::new(), segments: Vec::new(), reach_m };
        let mut placed: Vec<(usize, Segment)> = Vec::new();
        for segment in all {
            let [from, to] = [segment.from, segment.from + segment.way];
            // A hair wider, so that a beam at the border of a cell finds it on both sides.
            let margin = Vector2::repeat(1e-6);
            let (first, last) = (grid.cell_of(from.inf(&to) - margin), grid.cell_of(from.sup(&to) + margin));
            for row in first[1]..=last[1] {
                placed.extend(
                    (first[0]..=last[0]).filter_map(|column| Some((grid.index([column, row])?, segment))),
                );
            }
        }
        placed.sort_by_key(|(index, _)| *index);
        grid.begins = vec![0; (size[0] * size[1]) as usize + 1];
        placed.iter().for_each(|(index, _)| grid.begins[index + 1] += 1);
        for index in 1..grid.begins.len() {
            grid.begins[index] += grid.begins[index - 1];
        }
        grid.segments = placed.into_iter().map(|(_, segment)| segment).collect();
        grid
    }

    /// Distance along a beam (unit `direction`) to the first segment, infinite beyond the reach of the scanner.
    pub(super) fn range(&self, origin: Vector2<f64>, direction: Vector2<f64>) -> f64 {
        let mut cell = self.cell_of(origin);
        let step = [direction.x, direction.y].map(|slope| if slope < 0.0 { -1 } else { 1 });
        let inverse = [1.0 / direction.x.abs(), 1.0 / direction.y.abs()];
        let start = (origin - self.low) / self.cell;
        // Distances along the beam to the next border of a cell in each direction.
        let mut border: [f64; 2] = std::array::from_fn(|axis| {
            let inside = start[axis] - cell[axis] as f64;
            let left = if step[axis] > 0 { 1.0 - inside } else { inside };
            if direction[axis] == 0.0 { f64::INFINITY } else { left * self.cell * inverse[axis] }
        });
        let mut nearest = f64::INFINITY;
        loop {
            for segment in self.of_cell(cell) {
                nearest = nearest.min(segment.range(origin, direction));
            }
            let axis = usize::from(border[1] < border[0]);
            let end = border[axis].min(self.reach_m);
            if nearest <= end || end >= self.reach_m {
                return if nearest <= self.reach_m { nearest } else { f64::INFINITY };
            }
            cell[axis] += step[axis];
            border[axis] += self.cell * inverse[axis];
        }
    }

    fn of_cell(&self, cell: [i64; 2]) -> &[Segment] {
        let Some(index) = self.index(cell) else { return &[] };
        &self.segments[self.begins[index] as usize..self.begins[index + 1] as usize]
    }

    fn cell_of(&self, point: Vector2<f64>) -> [i64; 2] {
        [0, 1].map(|axis| ((point[axis] - self.low[axis]) / self.cell).floor() as i64)
    }

    fn index(&self, [column, row]: [i64; 2]) -> Option<usize> {
        let is_inside = (0..self.size[0]).contains(&column) && (0..self.size[1]).contains(&row);
        is_inside.then(|| (row * self.size[0] + column) as usize)
    }
}
