//! The picture: error of the position and NEES over the time of the drives.

use report::picture::PictureError;
use report::picture::chart::{self, Chart, Curve};

use super::results::{Results, Row};
use super::tally::{COMPONENTS, Moment};

/// Draws the figures as the text of an SVG file.
///
/// # Errors
/// [`PictureError`] when the drawing library refuses.
pub(super) fn draw(results: &Results) -> Result<String, PictureError> {
    let Results { way_m, seeds, .. } = results;
    let title = format!("Error and consistency of the estimated pose, {seeds} drives of {way_m} m");
    let subtitle = "NEES: squared error over its covariance; 3 is right, dashed are 95 % bounds of the mean";
    let error = panel(results, "error of the position, rms [m]", |moment| Some(moment.rms_m));
    let mut nees = panel(results, "NEES, mean", |moment| moment.nees);
    let bounds = results.rows.first().and_then(|row| row.nees_bounds_95);
    nees.limits = std::iter::once(COMPONENTS)
        .chain(bounds.into_iter().flatten())
        .map(|value| ("consistent".to_owned(), value))
        .collect();
    chart::draw_row(&title, subtitle, &[error, nees])
}

fn panel(results: &Results, y: &str, figure: fn(&Moment) -> Option<f64>) -> Chart {
    let several = results.rows.iter().any(|row| row.scenario != results.rows[0].scenario);
    let curve = |row: &Row, laser: &str| {
        let scenario = if several { format!("{} ", row.scenario) } else { String::new() };
        let points = row.over_time.iter().filter_map(|moment| Some([moment.time_s, figure(moment)?]));
        Curve { name: format!("{scenario}{}, {laser}", row.robot), points: points.collect(), dots: false }
    };
    let estimates = results.rows.iter().map(|row| curve(row, row.laser));
    let odometers = results.odometer.iter().map(|row| curve(row, "no filter"));
    Chart {
        x: "time [s]".to_owned(),
        y: y.to_owned(),
        logarithmic: true,
        curves: estimates.chain(odometers).collect(),
        ..Chart::default()
    }
}
