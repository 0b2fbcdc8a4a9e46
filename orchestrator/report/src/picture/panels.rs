//! Several charts, one below the other: measured points, the fit, and its residuals.

use calibration::FitChart;
use plotters::prelude::*;

use super::chart::range;
use super::{Area, EDGE, INK, Result, fine, font, mesh, svg};

/// Height of one chart [pixels].
const HEIGHT: u32 = 300;
/// Radius of a point [pixels].
const POINT: u32 = 3;
/// Colour of measured points.
const MEASURED: RGBColor = RGBColor(0, 92, 158);
/// Colour of the fit.
const FITTED: RGBColor = RGBColor(240, 110, 0);

/// Draws charts as the text of an SVG file.
///
/// # Errors
/// [`super::PictureError`] when the drawing library refuses.
pub fn draw(charts: &[FitChart]) -> Result<String> {
    let count = charts.len().max(1);
    svg(HEIGHT * count as u32, |root| {
        let areas = root.split_evenly((count, 1));
        areas.iter().zip(charts).try_for_each(|(area, chart)| panel(area, chart))
    })
}

fn panel(area: &Area<'_>, chart: &FitChart) -> Result<()> {
    let finite = |points: &[[f64; 2]]| -> Vec<(f64, f64)> {
        let pairs = points.iter().map(|[x, y]| (*x, *y));
        pairs.filter(|(x, y)| x.is_finite() && y.is_finite()).collect()
    };
    let (points, line) = (finite(&chart.points), finite(&chart.line));
    let all = || points.iter().chain(&line);
    let (left, right) = range(all().map(|point| point.0), 0.06);
    // The zero line belongs to every picture of errors.
    let (low, high) = range(all().map(|point| point.1).chain([0.0]), 0.06);
    let mut axes = ChartBuilder::on(area)
        .caption(&chart.title, font(15).into_font().color(&INK))
        .margin(fine(EDGE))
        .margin_right(fine(28))
        .x_label_area_size(fine(42))
        .y_label_area_size(fine(84 - EDGE))
        .build_cartesian_2d(left..right, low..high)?;
    let decimals = |span: f64| (1.0 - span.log10().floor()).clamp(0.0, 6.0) as usize;
    let (across, up) = (decimals(right - left), decimals(high - low));
    mesh(&mut axes)
        .x_labels(10)
        .y_labels(5)
        .x_label_formatter(&|value| format!("{value:.across$}"))
        .y_label_formatter(&|value| format!("{value:.up$}"))
        .x_desc(chart.across)
        .y_desc(chart.up)
        .draw()?;
    let thin = fine(1) as u32;
    axes.draw_series(LineSeries::new([(left, 0.0), (right, 0.0)], INK.stroke_width(thin)))?;
    axes.draw_series(LineSeries::new(line, FITTED.stroke_width(2 * thin)))?;
    let dot = |point: &(f64, f64)| Circle::new(*point, fine(POINT), MEASURED.filled());
    axes.draw_series(points.iter().map(dot))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<[f64; 2]>) -> FitChart {
        FitChart {
            title: "what the map misses".to_owned(),
            across: "angle [rad]",
            up: "residual [mrad]",
            points,
            line: vec![[0.0, 0.0], [1.0, 2.0]],
        }
    }

    #[test]
    fn every_point_is_drawn_with_title_and_axes() {
        let svg = draw(&[chart(vec![[0.0, 1.0], [0.5, 2.0]]), chart(vec![[0.1, 0.2]])]).unwrap();
        assert!(svg.starts_with("<svg width=\"1200\" height=\"600\""));
        assert_eq!(svg.matches("<circle").count(), 3);
        assert!(
            svg.contains("what the map misses")
                && svg.contains("residual [mrad]")
                && svg.contains("angle [rad]")
        );
    }

    #[test]
    fn nothing_nonsense_and_a_single_value_are_drawn_too() {
        draw(&[]).unwrap();
        draw(&[chart(vec![[f64::NAN, 1.0], [1.0, f64::INFINITY]])]).unwrap();
        draw(&[FitChart { line: Vec::new(), ..chart(vec![[2.0, 0.0]]) }]).unwrap();
        draw(&[FitChart { line: Vec::new(), ..chart(Vec::new()) }]).unwrap();
    }
}
