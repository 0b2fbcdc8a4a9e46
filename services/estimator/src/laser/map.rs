//! The straight surfaces of an occupancy grid.
//!
//! The sides between occupied and free cells are followed from one to the next; the way through the middles of their occupied
//! cells is split where it is furthest from the chord of its ends, as the returns of a scan are, and a line is fitted through
//! each piece. Pieces of one line with a small gap become one surface.
//!
//! Assumptions: a surface lies in the outermost occupied cells, as where a map was made of scans; in one that was drawn with
//! thick walls each is half a cell too far inside. What is shorter than three cells has no direction and is left out.

use nalgebra::{Matrix2, Vector2};

use super::grid::{Grid, GridCell};
use super::pieces::normal_of;

/// Most surfaces of a map.
pub const MAX_SURFACES: usize = 2048;
/// Standard deviation of where a surface is: that of a place anywhere in a cell, by the side of a cell.
pub const DEVIATION: f64 = 0.289;
/// Points are on a line when none is further from it, and they scatter about it by no more [cells].
const STRAIGHT: (f64, f64) = (1.1, 0.6);
/// A shorter piece has no direction [cells, m].
const MIN_LENGTH: (f64, f64) = (3.0, 0.12);
/// Pieces of one surface are no further apart [cells].
const GAP: f64 = 6.0;
/// They face the same way: cosine of the angle between them, at least.
const ALIKE: f64 = 0.97;
/// Numbers of a surface are multiples of this [m].
const ROUND_M: f64 = 1e-4;

/// A side of an occupied cell towards a free one: its cell, and the direction to the free one.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Side {
    cell: Vector2<i64>,
    direction: usize,
}

const DIRECTIONS: [Vector2<i64>; 4] =
    [Vector2::new(1, 0), Vector2::new(0, 1), Vector2::new(-1, 0), Vector2::new(0, -1)];

impl Side {
    /// The side that follows with the free cells to the right, or to the left; `None` where nothing is known.
    fn next(self, grid: &Grid, to_left: bool) -> Option<Self> {
        let Self { cell, direction } = self;
        let turn = if to_left { 3 } else { 1 };
        let ahead_at = (direction + turn) % 4;
        let (outward, along) = (DIRECTIONS[direction], DIRECTIONS[ahead_at]);
        let (ahead, across) = (cell + along, cell + outward + along);
        match [across, ahead].map(|cell| grid.at(cell.x, cell.y)) {
            [GridCell::Occupied, _] => Some(Self { cell: across, direction: (ahead_at + 2) % 4 }),
            [GridCell::Free, GridCell::Occupied] => Some(Self { cell: ahead, direction }),
            [_, GridCell::Free] => Some(Self { cell, direction: ahead_at }),
            _ => None,
        }
    }
}

/// Points on a line, in cells.
#[derive(Debug, Clone, Copy)]
struct Run {
    count: f64,
    mean: Vector2<f64>,
    scatter: Matrix2<f64>,
    /// Towards the free cells.
    normal: Vector2<f64>,
    /// First and last point, the free cells to the right.
    ends: [Vector2<f64>; 2],
}

impl Run {
    /// The line through points; the first and the last one may be of the next wall in a corner.
    fn of(points: &[Vector2<f64>]) -> Self {
        let ends = [points[0], points[points.len() - 1]];
        let points = if points.len() > 4 { &points[1..points.len() - 1] } else { points };
        let count = points.len() as f64;
        let mean = points.iter().sum::<Vector2<f64>>() / count;
        let scatter = points.iter().fold(Matrix2::zeros(), |sum, point| {
            let offset = point - mean;
            sum + offset * offset.transpose()
        });
        Self { count, mean, scatter, normal: Vector2::zeros(), ends }.turned()
    }

    /// With the normal that fits its points, to the right of the way between its ends.
    fn turned(mut self) -> Self {
        let normal = normal_of(&self.scatter);
        let way = self.ends[1] - self.ends[0];
        self.normal = if normal.dot(&Vector2::new(way.y, -way.x)) < 0.0 { -normal } else { normal };
        self
    }

    fn along(&self) -> Vector2<f64> {
        Vector2::new(-self.normal.y, self.normal.x)
    }

    fn length(&self) -> f64 {
        self.along().dot(&(self.ends[1] - self.ends[0]))
    }

    fn is_straight(&self) -> bool {
        (self.normal.dot(&(self.scatter * self.normal)) / self.count).sqrt() <= STRAIGHT.1
    }

    /// Both as one, if they are pieces of one surface.
    fn joined(&self, other: &Self) -> Option<Self> {
        if self.normal.dot(&other.normal) < ALIKE
            || self.normal.dot(&(other.mean - self.mean)).abs() > STRAIGHT.0
        {
            return None;
        }
        let along = |point: &Vector2<f64>| self.along().dot(&(point - self.mean));
        let [[low, high], [first, last]] = [self.ends, other.ends].map(|ends| ends.map(|end| along(&end)));
        if (first - high).max(low - last) > GAP {
            return None;
        }
        let count = self.count + other.count;
        let apart = other.mean - self.mean;
        let scatter =
            self.scatter + other.scatter + apart * apart.transpose() * (self.count * other.count / count);
        let ends = [
            if first < low { other.ends[0] } else { self.ends[0] },
            if last > high { other.ends[1] } else { self.ends[1] },
        ];
        let mean = self.mean + apart * (other.count / count);
        let joined = Self { count, mean, scatter, normal: self.normal, ends }.turned();
        joined.is_straight().then_some(joined)
    }
}

/// The straight surfaces of a grid on the track, the longest first: each from end to end, what is free to the right, as x, y, x and
/// y [m].
pub fn surfaces(grid: &Grid) -> Vec<[f64; 4]> {
    let mut runs = Vec::new();
    let shortest = MIN_LENGTH.0.max(MIN_LENGTH.1 / grid.frame.resolution_m);
    for points in chains(grid) {
        split(&points, &mut runs);
    }
    let mut runs = joined(runs);
    runs.retain(|run| run.length() + 1.0 >= shortest);
    runs.sort_by(|one, other| other.length().total_cmp(&one.length()));
    let rounded = |value: f64| (value / ROUND_M).round() * ROUND_M;
    let surface = |run: &Run| {
        // From side to side of the outermost cells.
        let end = |point: Vector2<f64>, more: f64| {
            run.mean + run.along() * (run.along().dot(&(point - run.mean)) + more)
        };
        let [from, to] = [end(run.ends[0], -0.5), end(run.ends[1], 0.5)].map(|end| grid.frame.place(end));
        [from.x, from.y, to.x, to.y].map(rounded)
    };
    runs.iter().map(surface).collect()
}

/// The middles of the outermost occupied cells, each chain along the free ones, which are to its right.
fn chains(grid: &Grid) -> Vec<Vec<Vector2<f64>>> {
    let [width, height] = grid.frame.size.map(|cells| cells as i64);
    let mut is_done = vec![[false; 4]; grid.cells.len()];
    let mut found = Vec::new();
    // First those that begin somewhere, then those without an end.
    for closed in [false, true] {
        for place in 0..width * height {
            let cell = Vector2::new(place % width, place / width);
            if grid.at(cell.x, cell.y) != GridCell::Occupied {
                continue;
            }
            for (direction, outward) in DIRECTIONS.iter().enumerate() {
                let (side, free) = (Side { cell, direction }, cell + outward);
                let begins = closed || side.next(grid, true).is_none();
                let number = place as usize;
                if begins && !is_done[number][direction] && grid.at(free.x, free.y) == GridCell::Free {
                    found.push(chain(grid, side, &mut is_done));
                }
            }
        }
    }
    found
}

/// The middles of the cells of the sides from one on that are not done.
fn chain(grid: &Grid, first: Side, is_done: &mut [[bool; 4]]) -> Vec<Vector2<f64>> {
    let mut points: Vec<Vector2<f64>> = Vec::new();
    let mut side = Some(first);
    while let Some(Side { cell, direction }) = side {
        let number = cell.y as usize * grid.frame.size[0] + cell.x as usize;
        if std::mem::replace(&mut is_done[number][direction], true) {
            break;
        }
        let middle = cell.map(|value| value as f64 + 0.5);
        if points.last() != Some(&middle) {
            points.push(middle);
        }
        side = Side { cell, direction }.next(grid, false);
    }
    points
}

/// Splits a chain of points into straight runs.
fn split(points: &[Vector2<f64>], runs: &mut Vec<Run>) {
    let mut waiting = vec![points];
    while let Some(points) = waiting.pop() {
        let &[from, _, .., to] = points else { continue };
        let chord = to - from;
        let off = |point: &Vector2<f64>| {
            let share = chord.dot(&(point - from)) / chord.norm_squared().max(f64::MIN_POSITIVE);
            (point - from - chord * share.clamp(0.0, 1.0)).norm()
        };
        let (at, most) = points.iter().enumerate().fold((0, 0.0), |(at, most), (index, point)| {
            let off = off(point);
            if off > most { (index, off) } else { (at, most) }
        });
        if most > STRAIGHT.0 {
            waiting.extend([&points[at..], &points[..=at]]);
        } else {
            let run = Run::of(points);
            runs.extend(run.is_straight().then_some(run));
        }
    }
}

/// Joins the pieces of each surface, the longest first.
fn joined(mut runs: Vec<Run>) -> Vec<Run> {
    runs.sort_by(|one, other| one.length().total_cmp(&other.length()));
    let mut found = Vec::new();
    while let Some(mut run) = runs.pop() {
        // One that has grown may reach others.
        while let Some((at, more)) =
            runs.iter().enumerate().rev().find_map(|(at, other)| Some((at, run.joined(other)?)))
        {
            runs.remove(at);
            run = more;
        }
        found.push(run);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::laser::grid::GridFrame;

    /// A grid as it is seen from above, y upwards: `#` occupied, `.` free, ` ` unknown.
    fn grid(resolution_m: f64, origin: [f64; 3], rows: &[&str]) -> Grid {
        let cell = |letter: u8| match letter {
            b'#' => GridCell::Occupied,
            b'.' => GridCell::Free,
            _ => GridCell::Unknown,
        };
        let cells = rows.iter().rev().flat_map(|row| row.bytes().map(cell)).collect();
        Grid { frame: GridFrame { resolution_m, origin, size: [rows[0].len(), rows.len()] }, cells }
    }

    fn assert_near(found: &[f64; 4], expected: [f64; 4]) {
        assert!(found.iter().zip(expected).all(|(one, other)| (one - other).abs() < 1e-9), "{found:?}");
    }

    #[test]
    fn a_wall_of_one_row_is_a_surface_through_its_middle_to_each_free_side() {
        let room = grid(0.1, [1.0, 2.0, 0.0], &["........", "########", "        "]);
        let [above] = surfaces(&room)[..] else { panic!() };
        // Above it is free: to the right of the way towards smaller x.
        assert_near(&above, [1.8, 2.15, 1.0, 2.15]);
        let both = surfaces(&grid(0.1, [1.0, 2.0, 0.0], &["........", "########", "........"]));
        assert_eq!(both.len(), 2);
        assert!(both.iter().any(|surface| surface[0] < surface[2]));
    }

    #[test]
    fn a_room_has_four_walls_that_face_inwards_and_a_box_in_it_four_that_face_outwards() {
        let mut rows = vec!["#".repeat(40)];
        rows.extend((0..30).map(|row| {
            let inside = if (10..20).contains(&row) {
                ".".repeat(14) + &"#".repeat(10) + &".".repeat(14)
            } else {
                ".".repeat(38)
            };
            format!("#{inside}#")
        }));
        rows.push("#".repeat(40));
        let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
        let found = surfaces(&grid(0.05, [0.0; 3], &rows));
        assert_eq!(found.len(), 8, "{found:?}");
        let middle = Vector2::new(1.0, 0.8);
        for (index, [x, y, to_x, to_y]) in found.iter().enumerate() {
            let (way, from) = (Vector2::new(to_x - x, to_y - y), middle - Vector2::new(*x, *y));
            let faces_middle = Vector2::new(way.y, -way.x).dot(&from) > 0.0;
            assert_eq!(faces_middle, index < 4, "the walls are longer than the box");
            let expected_m = if index < 2 {
                1.9
            } else if index < 4 {
                1.5
            } else {
                0.5
            };
            assert!((way.norm() - expected_m).abs() < 0.11, "{found:?}");
            assert!(way.x.abs().min(way.y.abs()) < 1e-9, "no corner turns them: {found:?}");
        }
    }

    #[test]
    fn a_slanted_wall_is_one_surface_within_a_third_of_a_cell() {
        // y = 0.3 x + 5 in cells: occupied there, free below.
        let rows: Vec<String> = (0..30)
            .rev()
            .map(|y| {
                let letter = |x: i32| match f64::from(y) - (0.3 * (f64::from(x) + 0.5) + 5.0).floor() {
                    0.0 => '#',
                    above if above < 0.0 => '.',
                    _ => ' ',
                };
                (0..60).map(letter).collect()
            })
            .collect();
        let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
        let found = surfaces(&grid(1.0, [0.0; 3], &rows));
        assert_eq!(found.len(), 1, "{found:?}");
        let [x, y, to_x, to_y] = found[0];
        assert!((x - to_x).abs() > 58.0 && x < to_x, "what is below is to the right of the way to larger x");
        assert!([[x, y], [to_x, to_y]].iter().all(|[x, y]| (y - 0.3 * x - 5.0).abs() < 0.35), "{found:?}");
    }

    #[test]
    fn gaps_are_bridged_doors_are_not_and_what_is_smaller_than_three_cells_is_left_out() {
        let count = |row: &str| surfaces(&grid(0.05, [0.0; 3], &[&".".repeat(row.len()), row])).len();
        assert_eq!(count(&format!("{}   {}", "#".repeat(20), "#".repeat(20))), 1);
        assert_eq!(count(&format!("{}{}{}", "#".repeat(20), " ".repeat(16), "#".repeat(20))), 2);
        assert_eq!((count("    ##    "), count("    ####  ")), (0, 1));
        assert_eq!(count("          "), 0);
    }

    #[test]
    fn the_yaw_of_the_origin_turns_the_surfaces() {
        let turned = grid(1.0, [10.0, 20.0, std::f64::consts::FRAC_PI_2], &["......", "######"]);
        let [found] = surfaces(&turned)[..] else { panic!() };
        assert_near(&found, [9.5, 26.0, 9.5, 20.0]);
    }
}
