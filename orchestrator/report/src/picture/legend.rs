//! Title, second line and the meaning of colours, at the top of the picture.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::map::Plan;
use super::{
    Area, BODY, BOUND, ELLIPSE, ESTIMATED_PATH, GOAL, INK, OBSTACLE, PictureError, Scene, TRUE_PATH,
};
use super::{fine, font};

/// Height of this part [pixels].
pub(super) const HEIGHT: u32 = 88;

/// Left end of text [pixels].
const LEFT: u32 = 60;
/// Middle of the row of samples [pixels].
const ROW: u32 = 72;
/// Width of a sample [pixels].
const SAMPLE: u32 = 26;
/// Estimated width of a letter; the library can't measure text [pixels].
const LETTER: f64 = 6.6;

pub(super) fn draw(area: &Area<'_>, scene: &Scene, plan: &Plan) -> Result<(), PictureError> {
    text(area, &scene.title, 19, LEFT, 20)?;
    let part = if plan.is_cut() { " (only the last part of the drive is shown)" } else { "" };
    text(area, &format!("{}{part}", scene.subtitle), 13, LEFT, 44)?;
    let bound = if scene.walls { ("wall", OBSTACLE) } else { ("bound of the track", BOUND) };
    let samples = [
        ("true path", TRUE_PATH, Kind::Line),
        ("estimated path", ESTIMATED_PATH, Kind::Dashes),
        ("body", BODY, Kind::Outline),
        ("obstacle", OBSTACLE, Kind::Filled),
        ("ellipse the centre keeps out of", ELLIPSE, Kind::Tinted),
        ("goal and tolerance", GOAL, Kind::Goal),
        ("start", TRUE_PATH, Kind::Dot),
        (bound.0, bound.1, if scene.walls { Kind::Thick } else { Kind::Dashes }),
    ];
    let mut left = LEFT;
    for (name, colour, kind) in samples {
        kind.draw(area, colour, left).map_err(PictureError::of)?;
        text(area, name, 12, left + SAMPLE + 6, ROW)?;
        left += SAMPLE + 6 + (name.len() as f64 * LETTER) as u32 + 16;
    }
    Ok(())
}

/// How a thing is drawn.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Line,
    Thick,
    Dashes,
    Outline,
    Filled,
    Tinted,
    Goal,
    Dot,
}

impl Kind {
    fn draw(
        self,
        area: &Area<'_>,
        colour: RGBColor,
        left: u32,
    ) -> Result<(), impl std::fmt::Display + use<>> {
        let at = |x: u32, y: u32| (fine(left + x), fine(y));
        let middle = at(SAMPLE / 2, ROW);
        let bar = vec![at(0, ROW), at(SAMPLE, ROW)];
        let rectangle = [at(2, ROW - 6), at(SAMPLE - 2, ROW + 6)];
        // The library ignores the line width of rectangles that are not filled.
        let outline = || {
            let [(left, top), (right, bottom)] = rectangle;
            let corners = vec![(left, top), (right, top), (right, bottom), (left, bottom), (left, top)];
            PathElement::new(corners, colour.stroke_width(fine(1) as u32))
        };
        match self {
            Self::Line => area.draw(&PathElement::new(bar, colour.stroke_width(fine(2) as u32))),
            Self::Thick => area.draw(&PathElement::new(bar, colour.stroke_width(fine(4) as u32))),
            Self::Dashes => {
                for dash in [0, 10, 20] {
                    let dash = vec![at(dash, ROW), at(dash + 6, ROW)];
                    area.draw(&PathElement::new(dash, colour.stroke_width(fine(2) as u32)))?;
                }
                Ok(())
            }
            Self::Outline => area.draw(&outline()),
            Self::Filled => area.draw(&Rectangle::new(rectangle, colour.filled())),
            Self::Tinted => {
                area.draw(&Rectangle::new(rectangle, colour.mix(0.18).filled()))?;
                area.draw(&outline())
            }
            Self::Goal => {
                area.draw(&Circle::new(middle, fine(7), colour.stroke_width(fine(2) as u32)))?;
                area.draw(&Circle::new(middle, fine(2), colour.filled()))
            }
            Self::Dot => area.draw(&Circle::new(middle, fine(5), colour.filled())),
        }
    }
}

fn text(area: &Area<'_>, text: &str, size: u32, x: u32, y: u32) -> Result<(), PictureError> {
    let style = font(size).into_font().color(&INK).pos(Pos::new(HPos::Left, VPos::Center));
    area.draw_text(text, &style, (fine(x), fine(y))).map_err(PictureError::of)
}
