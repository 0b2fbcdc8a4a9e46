//! The picture of a campaign: the share of courses that the robot passed, over the width of the gap.

use report::picture::PictureError;
use report::picture::chart::{self, Chart, Curve};

use super::summary::FamilySummary;

/// Draws one curve per family with gaps as the text of an SVG file; `None` without any.
///
/// # Errors
/// [`PictureError`] when the drawing library refuses.
pub(super) fn draw(families: &[FamilySummary], robot: &str) -> Result<Option<String>, PictureError> {
    let with_gaps = families.iter().filter(|family| !family.gaps.is_empty());
    let curves: Vec<Curve> = with_gaps.map(curve).collect();
    if curves.is_empty() {
        return Ok(None);
    }
    let chart = Chart {
        title: format!("Share passed over the width of the gap, robot {robot}"),
        subtitle: "a course is passed if the robot lands or drives past the goal; the body is 0.40 m wide"
            .to_owned(),
        x: "width of the narrowest place [m]".to_owned(),
        y: "share passed".to_owned(),
        curves,
        ..Chart::default()
    };
    chart::draw(&chart).map(Some)
}

fn curve(family: &FamilySummary) -> Curve {
    let points = family.gaps.iter().map(|class| [class.gap_m, class.passed as f64 / class.runs as f64]);
    Curve { name: family.name.clone(), points: points.collect(), dots: true }
}
