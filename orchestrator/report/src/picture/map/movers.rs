//! Moving obstacles on the map: where they were when.

use plotters::prelude::*;

use super::super::{Axes, OBSTACLE, Result, TRUE_PATH, TimedOffset, fine, font};
use super::{Strip, View, trim};

/// Least distance of the robot between two labels of its time [m].
const LABELS_M: f64 = 0.5;

impl Strip<'_> {
    /// A moving obstacle: its outline at each of its places, darker with time, and when it and the robot were there.
    pub(super) fn draw_way(
        &self,
        chart: &mut Axes<'_, '_>,
        points: &[[f64; 2]],
        places: &[TimedOffset],
    ) -> Result<()> {
        let count = points.len().max(1) as f64;
        let [x_m, y_m] = [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / count);
        let way: Vec<[f64; 2]> = places.iter().map(|place| [x_m + place.x_m, y_m + place.y_m]).collect();
        self.line(chart, &way, OBSTACLE.stroke_width(fine(1) as u32), true)?;
        let mut labelled = [f64::INFINITY; 2];
        for (index, place) in places.iter().enumerate() {
            let moved: Vec<[f64; 2]> = points.iter().map(|[x, y]| [x + place.x_m, y + place.y_m]).collect();
            let share = (index + 1) as f64 / places.len() as f64;
            self.fill(chart, &moved, OBSTACLE.mix(0.1 + 0.5 * share).filled())?;
            self.outline(chart, &moved, OBSTACLE.stroke_width(fine(1) as u32))?;
            let label = format!("{} s", trim(place.time_s));
            let right = moved.iter().map(|point| point[0]).fold(way[index][0], f64::max);
            self.label(chart, [right, way[index][1]], &label, OBSTACLE)?;
            let mut moments = self.drive.moments.iter();
            // Between two scans at 10 Hz.
            if let Some(robot) = moments.find(|moment| (moment.time_s - place.time_s).abs() <= 0.05)
                && (robot.x_m - labelled[0]).hypot(robot.y_m - labelled[1]) > LABELS_M
            {
                labelled = [robot.x_m, robot.y_m];
                let above = robot.y_m + 0.75 * self.scene.body_width_m;
                self.label(chart, [robot.x_m, above], &label, TRUE_PATH)?;
            }
        }
        Ok(())
    }

    /// A text to the right of a place.
    fn label(&self, chart: &mut Axes<'_, '_>, [x, y]: [f64; 2], text: &str, colour: RGBColor) -> Result<()> {
        let View { x: [left, right], y: [low, high] } = *self.view;
        if (left..=right).contains(&x) && (low..=high).contains(&y) {
            let style = font(11).into_font().color(&colour);
            let label = EmptyElement::at((x, y)) + Text::new(text.to_owned(), (fine(4), -fine(6)), style);
            chart.draw_series([label])?;
        }
        Ok(())
    }
}
