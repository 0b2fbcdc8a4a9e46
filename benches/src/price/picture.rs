//! The picture of `price`: gap and stopping distance over latency, scan period and pose sigma.

use report::picture::PictureError;
use report::picture::chart::{self, Chart, Curve};

use super::condition::Varied;
use super::costs::points;
use super::{Price, Row};

/// Draws the figures as the text of an SVG file.
///
/// # Errors
/// [`PictureError`] when the drawing library refuses.
pub(super) fn draw(price: &Price) -> Result<String, PictureError> {
    let subtitle = format!(
        "smallest gap that the robot passes (its body is {:.0} cm wide), and largest distance from the appearance of an \
         obstacle to standstill",
        price.body_width_m * 100.0
    );
    let panels = [
        panel(&price.rows, Varied::Latency, "added latency [ms]", 1.0),
        panel(&price.rows, Varied::Rate, "scan period [ms]", 1.0),
        panel(&price.rows, Varied::PoseSigma, "pose sigma [cm]", 100.0),
    ];
    chart::draw_row("What latency, scan rate and pose uncertainty cost", &subtitle, &panels)
}

/// One panel; `scale` turns the varied quantity into the unit of the axis.
fn panel(rows: &[Row], varied: Varied, x: &str, scale: f64) -> Chart {
    let curve = |name: &str, figure: fn(&Row) -> Option<f64>| {
        let points = points(rows, varied, figure);
        let points = points.iter().map(|[x, metres]| [x * scale, metres * 100.0]).collect();
        Curve { name: name.to_owned(), points, dots: true }
    };
    Chart {
        x: x.to_owned(),
        y: "distance [cm]".to_owned(),
        curves: vec![
            curve("smallest gap", |row| row.smallest_gap_m),
            curve("stopping distance", |row| row.stopping_distance_m),
        ],
        ..Chart::default()
    }
}
