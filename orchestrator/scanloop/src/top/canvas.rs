//! A picture of dots: eight Braille dots in each cell of the terminal.

use ratatui_core::buffer::Buffer;
use ratatui_core::layout::Rect;
use ratatui_core::style::Color;

/// Braille letters start here; each bit of the offset is a dot.
const BRAILLE: u32 = 0x2800;
/// The bit of each dot of a cell, by row and column.
const BITS: [[u8; 2]; 4] = [[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]];
/// Longest line that is drawn [dots]: coordinates come from samples.
const MAX_STEPS: f64 = 4096.0;

/// A map in track coordinates: x to the right, y up.
pub(super) struct Canvas {
    area: Rect,
    /// Dots and colour of each cell.
    cells: Vec<(u8, Color)>,
    /// Track coordinates of the left lower corner [m].
    corner: [f64; 2],
    dots_per_m: f64,
}

impl Canvas {
    /// An empty map that shows at least `size` metres from `corner` on, to scale.
    pub(super) fn new(area: Rect, corner: [f64; 2], size: [f64; 2]) -> Self {
        let dots = [f64::from(area.width) * 2.0, f64::from(area.height) * 4.0];
        let dots_per_m = (dots[0] / size[0]).min(dots[1] / size[1]);
        // What is left over stands above and below in equal parts.
        let below = (dots[1] / dots_per_m - size[1]) / 2.0;
        let corner = [corner[0], corner[1] - below];
        Self {
            area,
            cells: vec![(0, Color::Reset); usize::from(area.width) * usize::from(area.height)],
            corner,
            dots_per_m,
        }
    }

    /// A dot; the newest colour of a cell holds. What is outside is left out.
    pub(super) fn dot(&mut self, [x_m, y_m]: [f64; 2], color: Color) {
        let column = (x_m - self.corner[0]) * self.dots_per_m;
        let row = f64::from(self.area.height) * 4.0 - (y_m - self.corner[1]) * self.dots_per_m;
        let is_within = |dot: f64, cells: u16, dots: f64| dot >= 0.0 && dot < f64::from(cells) * dots;
        if !is_within(column, self.area.width, 2.0) || !is_within(row, self.area.height, 4.0) {
            return;
        }
        let (column, row) = (column as usize, row as usize);
        let cell = &mut self.cells[row / 4 * usize::from(self.area.width) + column / 2];
        *cell = (cell.0 | BITS[row % 4][column % 2], color);
    }

    /// A line between two places.
    pub(super) fn line(&mut self, from: [f64; 2], to: [f64; 2], color: Color) {
        let way = [to[0] - from[0], to[1] - from[1]];
        let steps = (way[0].abs().max(way[1].abs()) * self.dots_per_m).ceil().clamp(1.0, MAX_STEPS);
        if !steps.is_finite() {
            return;
        }
        for step in 0..=steps as usize {
            let share = step as f64 / steps;
            self.dot([from[0] + share * way[0], from[1] + share * way[1]], color);
        }
    }

    /// Lines from each place to the next, and from the last to the first.
    pub(super) fn outline(&mut self, places: &[[f64; 2]], color: Color) {
        for (index, place) in places.iter().enumerate() {
            self.line(*place, places[(index + 1) % places.len()], color);
        }
    }

    /// Puts the picture into the buffer.
    pub(super) fn render(&self, buffer: &mut Buffer) {
        for (index, (dots, color)) in self.cells.iter().enumerate().filter(|(_, (dots, _))| *dots != 0) {
            let (column, row) = (index % usize::from(self.area.width), index / usize::from(self.area.width));
            let place = (self.area.x + column as u16, self.area.y + row as u16);
            if let Some(cell) = buffer.cell_mut(place) {
                let letter = char::from_u32(BRAILLE + u32::from(*dots)).unwrap_or(' ');
                cell.set_char(letter).set_fg(*color);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(draw: impl Fn(&mut Canvas)) -> Vec<String> {
        let area = Rect::new(0, 0, 4, 2);
        // Ten dots to the metre.
        let mut canvas = Canvas::new(area, [0.0, 0.0], [0.8, 0.8]);
        draw(&mut canvas);
        let mut buffer = Buffer::empty(area);
        canvas.render(&mut buffer);
        let row = |row| (0..4).map(|column| buffer[(column, row)].symbol().to_owned()).collect();
        (0..2).map(row).collect()
    }

    #[test]
    fn dots_and_lines_are_to_scale() {
        assert_eq!(drawn(|canvas| canvas.dot([0.05, 0.75], Color::Blue)), ["\u{2801}   ", "    "]);
        assert_eq!(drawn(|canvas| canvas.dot([0.75, 0.05], Color::Blue)), ["    ", "   \u{2880}"]);
        let line = drawn(|canvas| canvas.line([0.0, 0.05], [0.79, 0.05], Color::Blue));
        assert_eq!(line, ["    ", "\u{28c0}\u{28c0}\u{28c0}\u{28c0}"]);
    }

    #[test]
    fn what_is_outside_or_no_number_is_left_out() {
        let empty = drawn(|canvas| {
            for place in [[-0.1, 0.4], [0.9, 0.4], [0.4, -0.1], [0.4, 0.9], [f64::NAN, 0.4], [1e300, 0.4]] {
                canvas.dot(place, Color::Blue);
                canvas.line(place, place, Color::Blue);
            }
            canvas.line([0.1, f64::INFINITY], [f64::NAN, 0.1], Color::Blue);
        });
        assert_eq!(empty, ["    ", "    "]);
    }
}
