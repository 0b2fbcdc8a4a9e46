//! Cross sections of a course: whether a point is beside it.

use std::collections::BTreeMap;

use nalgebra::Vector2;
use vehicle::Course;

use super::Tangent;

/// Largest distance from one section to the next along the course [m].
const SPACING_M: f64 = 0.1;

/// The course as lines across it, by the cell of the plane that they cross it in.
pub(super) struct Sections {
    /// Side of a cell: sections of the cells around it reach a point [m].
    cell: f64,
    /// With the distance from one to the next [m].
    cells: BTreeMap<[i64; 2], Vec<(Tangent, f64)>>,
}

impl Sections {
    /// No sections yet, of ways that reach so far to both sides.
    pub(super) fn new(reach: f64) -> Self {
        Self { cell: reach + SPACING_M, cells: BTreeMap::new() }
    }

    /// Adds sections between two places along a course.
    pub(super) fn add(&mut self, course: &Course, [from, to]: [f64; 2]) {
        let steps = ((to - from) / SPACING_M).ceil().max(1.0);
        let spacing = (to - from) / steps;
        for step in 0..=steps as u32 {
            let tangent = course.at(from + f64::from(step) * spacing);
            self.cells.entry(self.cell_of(tangent.point)).or_default().push((tangent, spacing));
        }
    }

    /// Whether a point is on a section, less than `reach` metres from the course. Beyond the ends of the course nothing is.
    pub(super) fn hold(&self, point: Vector2<f64>, reach: f64) -> bool {
        let [x, y] = self.cell_of(point);
        let around = (-1..=1).flat_map(|column| (-1..=1).map(move |row| [x + column, y + row]));
        around.filter_map(|cell| self.cells.get(&cell)).flatten().any(|(tangent, spacing)| {
            let [ahead, left] = tangent.offset(point);
            // Outside of a bend the sections spread.
            let between = spacing * (0.5 + tangent.curvature.abs() * reach);
            left.abs() < reach && ahead.abs() <= between + 1e-9
        })
    }

    fn cell_of(&self, point: Vector2<f64>) -> [i64; 2] {
        [point.x, point.y].map(|value| (value / self.cell).floor() as i64)
    }
}
