//! Speed and steering over time, below the map.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{Area, EDGE, INK, Moment, Result, WIDTH, fine, font, mesh};

/// Height of this part [pixels].
pub(super) const HEIGHT: u32 = 210;

const SPEED: RGBColor = RGBColor(0, 92, 158);
const STEERING: RGBColor = RGBColor(190, 60, 30);
/// Maximum number of points per curve, about four per pixel; peaks are kept.
const MAX_POINTS: usize = 4000;
/// Curves are clamped here, so that one absurd value does not hide the rest [m/s].
const HIGHEST_SPEED_MPS: f64 = 10.0;
/// As above [rad].
const HIGHEST_STEERING_RAD: f64 = 1.0;

pub(super) fn draw(area: &Area<'_>, moments: &[Moment]) -> Result<()> {
    let curve = |pick: fn(&Moment) -> f64, highest: f64| {
        let points = moments.iter().map(|moment| (moment.time_s, pick(moment).clamp(-highest, highest)));
        keep_peaks(points.filter(|(time, value)| time.is_finite() && value.is_finite()).collect())
    };
    let speed = curve(|moment| moment.speed_mps, HIGHEST_SPEED_MPS);
    let steering = curve(|moment| moment.steering_rad, HIGHEST_STEERING_RAD);
    let largest = |curve: &[(f64, f64)], floor: f64| {
        curve.iter().map(|(_, value)| value.abs()).fold(floor, f64::max) * 1.1
    };
    let start = speed.first().map_or(0.0, |(time, _)| *time);
    let end = speed.last().map_or(1.0, |(time, _)| *time).max(start + 1.0);
    let slowest = speed.iter().map(|(_, speed)| *speed).fold(0.0, f64::min) * 1.1;
    let (fastest, sharpest) = (largest(&speed, 1.0), largest(&steering, 0.06));

    let mut chart = ChartBuilder::on(area)
        .margin_top(fine(14))
        .margin_bottom(fine(8))
        .margin_left(fine(EDGE))
        .margin_right(fine(EDGE))
        .x_label_area_size(fine(38))
        .y_label_area_size(fine(60 - EDGE))
        .right_y_label_area_size(fine(66 - EDGE))
        .build_cartesian_2d(start..end, slowest..fastest)?
        .set_secondary_coord(start..end, -sharpest..sharpest);
    mesh(&mut chart)
        .x_labels(14)
        .y_labels(5)
        .x_label_formatter(&|time| format!("{time:.0}"))
        .y_label_formatter(&|speed| format!("{speed:.1}"))
        .axis_desc_style(font(13).into_font().color(&SPEED))
        .y_desc("speed [m/s]")
        .draw()?;
    chart
        .configure_secondary_axes()
        .axis_style(INK.stroke_width(fine(1) as u32))
        .y_labels(5)
        .y_label_formatter(&|angle| if angle.abs() < 5e-3 { "0".to_owned() } else { format!("{angle:+.2}") })
        .label_style(font(12).into_font().color(&INK))
        .axis_desc_style(font(13).into_font().color(&STEERING))
        .y_desc("steering [rad]")
        .set_all_tick_mark_size(fine(4))
        .draw()?;
    let width = fine(2) as u32 * 4 / 5;
    chart.draw_secondary_series(LineSeries::new(steering, STEERING.stroke_width(width)))?;
    chart.draw_series(LineSeries::new(speed, SPEED.stroke_width(width)))?;
    // Each vertical axis is named in the colour of its curve, so the horizontal one is named here.
    let style = font(13).into_font().color(&INK).pos(Pos::new(HPos::Center, VPos::Bottom));
    Ok(area.draw_text("time [s]", &style, (fine(WIDTH / 2), fine(HEIGHT - 5)))?)
}

/// At most about [`MAX_POINTS`] points: of each group the lowest and the highest, in their order.
fn keep_peaks(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let group = (2 * points.len()).div_ceil(MAX_POINTS);
    if group <= 2 {
        return points;
    }
    let peaks = points.chunks(group).flat_map(|chunk| {
        let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let low = chunk.iter().min_by(by_value).copied();
        let high = chunk.iter().max_by(by_value).copied();
        let mut both: Vec<(f64, f64)> = low.into_iter().chain(high).collect();
        both.sort_by(|a, b| a.0.total_cmp(&b.0));
        both
    });
    peaks.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_peak_among_many_points_is_kept() {
        let mut points: Vec<(f64, f64)> = (0..100_000).map(|step| (f64::from(step), 0.0)).collect();
        points[54_321].1 = 3.0;
        let kept = keep_peaks(points);
        assert!(kept.len() <= MAX_POINTS + 2, "{}", kept.len());
        assert_eq!(kept.iter().filter(|point| **point == (54_321.0, 3.0)).count(), 1);
        assert!(kept.windows(2).all(|pair| pair[0].0 <= pair[1].0));
    }
}
