//! An occupancy grid, and one drawn from scans.
//!
//! Each beam with a return passes the cells up to its end (traversal by the next side of a cell, DOI 10.2312/egtp.19871000) and
//! hits that one. A cell is occupied when enough of the beams that reach it end there: what moved away was passed more often
//! than hit. What no beam reaches is unknown, and so is what lies along beams without a return: a scanner may have seen nothing
//! there or failed.

use nalgebra::Vector2;
use shared_types::{Pose, Scan};
use vehicle::Description;
use vehicle::frame::{heading, to_track};

use super::pieces::SweepMotion;

/// Most cells of a grid: 102 m by 102 m at 2.5 cm.
pub const MAX_CELLS: usize = 1 << 24;
/// Smallest and largest side of a cell [m].
pub const RESOLUTION_M: [f64; 2] = [0.005, 1.0];
/// A cell is occupied when at least one of so many beams that reach it ends there, and this many at least.
const SHARE: u32 = 4;
const MIN_HITS: u16 = 2;
/// Speed with which a robot counts that stands [m/s].
const STANDS_MPS: f64 = 1e-3;

/// What is known of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GridCell {
    /// Nothing.
    Unknown,
    /// Nothing stands there.
    Free,
    /// Something does.
    Occupied,
}

/// Where the cells of a grid are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridFrame {
    /// Side of a cell [m].
    pub resolution_m: f64,
    /// The corner of the first cell on the track, x and y [m], and the yaw of the grid [rad].
    pub origin: [f64; 3],
    /// Cells along its x and its y.
    pub size: [usize; 2],
}

impl GridFrame {
    /// The frame without yaw around two corners, with a free cell beyond; `None` where it has more than [`MAX_CELLS`].
    pub fn around(low: Vector2<f64>, high: Vector2<f64>, resolution_m: f64) -> Option<Self> {
        let first = low.map(|value| (value / resolution_m).floor() - 1.0);
        let cells = high.map(|value| (value / resolution_m).floor() + 2.0) - first;
        let is_allowed = cells.x * cells.y <= MAX_CELLS as f64;
        is_allowed.then(|| Self {
            resolution_m,
            origin: [first.x * resolution_m, first.y * resolution_m, 0.0],
            size: [cells.x as usize, cells.y as usize],
        })
    }

    /// How many cells it has.
    pub fn cells(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// A place in cells as a place on the track [m].
    pub fn place(&self, cells: Vector2<f64>) -> Vector2<f64> {
        let [x, y, yaw] = self.origin;
        let along = cells * self.resolution_m;
        Vector2::new(x, y) + to_track(yaw, along.x, along.y)
    }

    /// The other way.
    fn in_cells(&self, place: Vector2<f64>) -> Vector2<f64> {
        let [x, y, yaw] = self.origin;
        let from = place - Vector2::new(x, y);
        to_track(-yaw, from.x, from.y) / self.resolution_m
    }

    /// The number of a cell: row by row, each along x.
    fn number(&self, x: i64, y: i64) -> Option<usize> {
        let [width, height] = self.size;
        let (x, y) = (usize::try_from(x).ok()?, usize::try_from(y).ok()?);
        (x < width && y < height).then(|| y * width + x)
    }
}

/// An occupancy grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Where it is.
    pub frame: GridFrame,
    /// Its cells, row by row from the origin on.
    pub cells: Vec<GridCell>,
}

impl Grid {
    /// What is known of a cell; beyond the grid nothing is.
    pub fn at(&self, x: i64, y: i64) -> GridCell {
        self.frame.number(x, y).map_or(GridCell::Unknown, |number| self.cells[number])
    }
}

/// The beams of a scan with a return, from the scanner to the return on the track [m]; the pose is that of the front beam.
pub fn beams(scan: &Scan, pose: &Pose, vehicle: &Description) -> impl Iterator<Item = [Vector2<f64>; 2]> {
    let motion = SweepMotion { speed_mps: pose.speed_mps, yaw_rate_radps: pose.yaw_rate_radps };
    let scanner = Vector2::new(vehicle.scanner_x_m, vehicle.scanner_y_m);
    // No scanner sees further than it does: a forged range would cross all cells.
    let reach_m = vehicle.scanner.range_m + 1e-3;
    (0..scan.ranges().len()).filter_map(move |beam| {
        let range_m = scan.range_m(beam).filter(|range_m| *range_m <= reach_m)?;
        let way = heading(scan.beam_yaw_rad(beam) + vehicle.scanner_yaw_rad) * range_m;
        let time_s = scan.beam_time_s(beam);
        Some([scanner, scanner + way].map(|place| {
            let place = motion.at_front(place, time_s);
            Vector2::new(pose.x_m, pose.y_m) + to_track(pose.yaw_rad, place.x, place.y)
        }))
    })
}

/// How well the poses are known from which a map is drawn, by the way between them.
#[derive(Debug, Clone, Copy, Default)]
pub struct MapDeviation {
    squares: f64,
    weight: f64,
}

impl MapDeviation {
    /// One more; a robot that stands counts little.
    pub fn see(&mut self, pose: &Pose) {
        let weight = pose.speed_mps.abs().max(STANDS_MPS);
        self.weight += weight;
        self.squares += weight * f64::midpoint(pose.covariance[4], pose.covariance[8]);
    }

    /// Root of the mean variance of x and y [m]; none of no pose.
    pub fn root_m(&self) -> f64 {
        (self.squares / self.weight.max(STANDS_MPS)).sqrt()
    }
}

/// A grid that is drawn.
#[derive(Debug, Clone)]
pub struct Drawing {
    frame: GridFrame,
    /// Of each cell, how many beams ended in it and passed it.
    counts: Vec<[u16; 2]>,
}

impl Drawing {
    /// An empty one.
    pub fn new(frame: GridFrame) -> Self {
        Self { frame, counts: vec![[0; 2]; frame.cells()] }
    }

    /// Draws a beam from the scanner to its return, both on the track [m].
    pub fn beam(&mut self, from: Vector2<f64>, to: Vector2<f64>) {
        let [from, to] = [from, to].map(|place| self.frame.in_cells(place));
        let way = to - from;
        let mut cell = from.map(|value| value.floor() as i64);
        let last = to.map(|value| value.floor() as i64);
        // Fraction of the beam up to the next side of a cell in x and y, and from one to the next.
        let step = way.map(|value| if value < 0.0 { -1 } else { 1 });
        let apart = way.map(|value| if value == 0.0 { f64::INFINITY } else { 1.0 / value.abs() });
        let mut next = Vector2::from_fn(|axis, _| {
            let in_cell = from[axis] - cell[axis] as f64;
            let left = if step[axis] > 0 { 1.0 - in_cell } else { in_cell };
            if way[axis] == 0.0 { f64::INFINITY } else { left * apart[axis] }
        });
        let sides = (last - cell).abs();
        for _ in 0..sides.x + sides.y {
            self.count(cell, 1);
            let axis = usize::from(next.y < next.x);
            cell[axis] += step[axis];
            next[axis] += apart[axis];
        }
        // Rounding on a corner may lead past the last cell, by one.
        self.count(last, 0);
    }

    fn count(&mut self, cell: Vector2<i64>, kind: usize) {
        if let Some(number) = self.frame.number(cell.x, cell.y) {
            let count = &mut self.counts[number][kind];
            *count = count.saturating_add(1);
        }
    }

    /// The grid.
    pub fn grid(&self) -> Grid {
        let cell = |[hits, passes]: &[u16; 2]| match u32::from(*hits) + u32::from(*passes) {
            0 => GridCell::Unknown,
            reached if *hits >= MIN_HITS && SHARE * u32::from(*hits) >= reached => GridCell::Occupied,
            _ if *passes == 0 => GridCell::Unknown,
            _ => GridCell::Free,
        };
        Grid { frame: self.frame, cells: self.counts.iter().map(cell).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawing() -> Drawing {
        let frame = GridFrame { resolution_m: 0.5, origin: [-1.0, -1.0, 0.0], size: [6, 4] };
        Drawing::new(frame)
    }

    /// The grid as it is seen from above: y upwards.
    fn text(grid: &Grid) -> Vec<String> {
        let letter = |cell: &GridCell| match cell {
            GridCell::Unknown => '?',
            GridCell::Free => '.',
            GridCell::Occupied => '#',
        };
        let rows = grid.cells.chunks(grid.frame.size[0]).rev();
        rows.map(|row| row.iter().map(letter).collect()).collect()
    }

    #[test]
    fn beams_free_what_they_pass_and_occupy_where_they_end() {
        let mut drawing = drawing();
        for _ in 0..2 {
            drawing.beam(Vector2::new(-0.75, -0.75), Vector2::new(1.75, -0.75));
            drawing.beam(Vector2::new(-0.75, -0.75), Vector2::new(0.8, 0.8));
        }
        // A single hit may be an error of the scanner, and what is beyond the grid is left out.
        drawing.beam(Vector2::new(-0.75, -0.75), Vector2::new(-0.75, 0.75));
        drawing.beam(Vector2::new(-0.75, -0.75), Vector2::new(-9.0, -0.75));
        assert_eq!(text(&drawing.grid()), ["???#??", ".?..??", "...???", ".....#"]);
    }

    #[test]
    fn a_range_beyond_the_scanners_reach_is_no_beam() {
        let mut scan = Scan { beams: 3, increment_rad: 0.1, ..Scan::default() };
        let reach_mm = (Description::default().scanner.range_m * 1e3) as u32;
        scan.ranges_mm[..3].copy_from_slice(&[reach_mm, reach_mm + 2, u32::MAX]);
        assert_eq!(beams(&scan, &Pose::default(), &Description::default()).count(), 1);
    }

    #[test]
    fn a_body_that_moves_leaves_nothing_where_it_was_passed_more_often() {
        let (from, near, far) =
            (Vector2::new(-0.75, 0.25), Vector2::new(0.25, 0.25), Vector2::new(1.75, 0.25));
        let mut drawing = drawing();
        (0..3).for_each(|_| drawing.beam(from, near));
        (0..9).for_each(|_| drawing.beam(from, far));
        assert_eq!(text(&drawing.grid())[1], "..#..#", "one beam of four ended there");
        drawing.beam(from, far);
        assert_eq!(text(&drawing.grid())[1], ".....#");
    }

    #[test]
    fn every_beam_ends_in_its_cell_whatever_its_direction() {
        for number in 0..64 {
            let (sin, cos) = (f64::from(number) * 0.1).sin_cos();
            let mut drawing = drawing();
            let to = Vector2::new(0.4 + 0.9 * cos, 0.1 + 0.9 * sin);
            (0..2).for_each(|_| drawing.beam(Vector2::new(0.4, 0.1), to));
            let cell = drawing.frame.in_cells(to).map(|value| value.floor() as i64);
            let grid = drawing.grid();
            assert_eq!(grid.at(cell.x, cell.y), GridCell::Occupied, "{number}");
            assert_eq!(grid.cells.iter().filter(|cell| **cell == GridCell::Occupied).count(), 1);
        }
    }

    #[test]
    fn a_map_is_as_uncertain_as_the_poses_along_the_way_of_its_drive() {
        let mut deviation = MapDeviation::default();
        assert_eq!(deviation.root_m(), 0.0);
        let mut pose = Pose { speed_mps: 1.0, ..Pose::default() };
        (pose.covariance[4], pose.covariance[8]) = (1e-4, 7e-4);
        (0..10).for_each(|_| deviation.see(&pose));
        let at_rest = Pose::default();
        (0..100).for_each(|_| deviation.see(&at_rest));
        assert!((deviation.root_m() - 0.02).abs() < 2e-4, "{}", deviation.root_m());
    }

    #[test]
    fn a_frame_holds_its_corners_and_has_a_limit() {
        let (low, high) = (Vector2::new(-0.23, 1.02), Vector2::new(0.21, 1.38));
        let frame = GridFrame::around(low, high, 0.1).unwrap();
        for corner in [low, high] {
            let cell = frame.in_cells(corner).map(|value| value.floor() as i64);
            assert!(frame.number(cell.x - 1, cell.y - 1).and(frame.number(cell.x + 1, cell.y + 1)).is_some());
            assert!((frame.place(frame.in_cells(corner)) - corner).norm() < 1e-12);
        }
        assert_eq!(GridFrame::around(low, Vector2::new(500.0, 500.0), 0.05), None);
        let turned = GridFrame { origin: [1.0, 2.0, std::f64::consts::FRAC_PI_2], ..frame };
        assert!((turned.place(Vector2::new(10.0, 0.0)) - Vector2::new(1.0, 3.0)).norm() < 1e-12);
    }
}
