//! The top of the picture: title, second line and legend; and the samples of all legends.

use emulator::JudgedBy;
use plotters::prelude::*;

use super::map::Layout;
use super::{Area, BODY, BOUND, ELLIPSE, ESTIMATED_PATH, GOAL, OBSTACLE, PictureScene, Result, TRUE_PATH};
use super::{fine, text};

/// Height of this part [pixels].
pub(super) const HEIGHT: u32 = 88;

/// Left end of text [pixels].
pub(super) const LEFT: u32 = 60;
/// Middle of the row of samples [pixels].
const ROW: u32 = 72;
/// Width of a sample [pixels].
const SAMPLE: u32 = 26;
/// Estimated width of a letter; the library can't measure text [pixels].
const LETTER: f64 = 6.6;

pub(super) fn draw(
    area: &Area<'_>,
    scene: &PictureScene,
    layout: &Layout,
    judged_by: JudgedBy,
) -> Result<()> {
    text(area, &scene.title, 19, LEFT, 20)?;
    let part = if layout.is_cut() { " (only the last part of the drive is shown)" } else { "" };
    text(area, &format!("{}{part}", scene.subtitle), 13, LEFT, 44)?;
    let bound = match &scene.course {
        Some(_) => ("course, and bounds of its way", BOUND, Sample::Dashes),
        None if scene.walls => ("wall", OBSTACLE, Sample::Thick),
        None => ("bound of the track", BOUND, Sample::Dashes),
    };
    let samples = [
        ("true path", TRUE_PATH, Sample::Line),
        ("estimated path", ESTIMATED_PATH, Sample::Dashes),
        ("body", BODY, Sample::Outline),
        ("obstacle", OBSTACLE, Sample::Filled),
        ("ellipse the centre keeps out of", ELLIPSE, Sample::Tinted),
        ("goal and tolerance", GOAL, Sample::Goal),
        ("start", TRUE_PATH, Sample::Dot),
        bound,
    ];
    let mut left = LEFT;
    for (name, colour, sample) in samples.into_iter().skip(usize::from(judged_by == JudgedBy::Estimate)) {
        sample.draw(area, name, colour, left, ROW)?;
        left += width(name);
    }
    Ok(())
}

/// Width of a sample with its name and the gap to the next one [pixels].
pub(super) fn width(name: &str) -> u32 {
    SAMPLE + 6 + (name.len() as f64 * LETTER) as u32 + 16
}

/// How a thing is drawn.
#[derive(Debug, Clone, Copy)]
pub(super) enum Sample {
    Line,
    Thick,
    Dashes,
    Outline,
    Filled,
    Tinted,
    Goal,
    Ring,
    Dot,
}

impl Sample {
    /// Draws a sample with its name, at this left end and this middle of the row [pixels].
    pub(super) fn draw(
        self,
        area: &Area<'_>,
        name: &str,
        colour: RGBColor,
        left: u32,
        row: u32,
    ) -> Result<()> {
        let at = |x: u32, y: u32| (fine(left + x), fine(y));
        let middle = at(SAMPLE / 2, row);
        let bar = |from: u32, to: u32, width: u32| {
            area.draw(&PathElement::new(
                vec![at(from, row), at(to, row)],
                colour.stroke_width(fine(width) as u32),
            ))
        };
        let rectangle = [at(2, row - 6), at(SAMPLE - 2, row + 6)];
        // The library ignores the line width of rectangles that are not filled.
        let outline = || {
            let [(left, top), (right, bottom)] = rectangle;
            let corners = vec![(left, top), (right, top), (right, bottom), (left, bottom), (left, top)];
            area.draw(&PathElement::new(corners, colour.stroke_width(fine(1) as u32)))
        };
        let ring =
            |radius: u32| area.draw(&Circle::new(middle, fine(radius), colour.stroke_width(fine(2) as u32)));
        let dot = |radius: u32| area.draw(&Circle::new(middle, fine(radius), colour.filled()));
        match self {
            Self::Line => bar(0, SAMPLE, 2),
            Self::Thick => bar(0, SAMPLE, 4),
            Self::Dashes => [0, 10, 20].into_iter().try_for_each(|dash| bar(dash, dash + 6, 2)),
            Self::Outline => outline(),
            Self::Filled => area.draw(&Rectangle::new(rectangle, colour.filled())),
            Self::Tinted => {
                area.draw(&Rectangle::new(rectangle, colour.mix(0.18).filled())).and_then(|()| outline())
            }
            Self::Goal => ring(7).and_then(|()| dot(2)),
            Self::Ring => ring(6),
            Self::Dot => dot(5),
        }?;
        text(area, name, 12, left + SAMPLE + 6, row)
    }
}
