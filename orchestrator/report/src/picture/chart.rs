//! Curves in one pair of axes: the picture of a design analysis.
//!
//! A logarithmic axis is drawn by its exponents. What is not finite, or not positive on a logarithmic axis, is left out.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{Area, EDGE, FINE, GRID, INK, PictureError, WIDTH, fine, font};

/// Height of the picture [pixels].
const HEIGHT: u32 = 560;
/// Height of title, second line and one row of the legend [pixels].
const HEAD: u32 = 84;
/// Height of a further row of the legend [pixels].
const ROW: u32 = 22;
/// Left end of text [pixels].
const LEFT: u32 = 60;
/// Width of a sample in the legend [pixels].
const SAMPLE: u32 = 26;
/// Estimated width of a letter; the library can't measure text [pixels].
const LETTER: f64 = 6.6;
/// What must not be passed.
const LIMIT: RGBColor = RGBColor(190, 60, 30);
/// One colour per curve, told apart in grey too.
const PALETTE: [RGBColor; 8] = [
    RGBColor(0, 92, 158),
    RGBColor(240, 110, 0),
    RGBColor(0, 140, 95),
    RGBColor(196, 78, 120),
    RGBColor(86, 160, 211),
    RGBColor(120, 94, 40),
    RGBColor(110, 80, 170),
    RGBColor(130, 130, 135),
];

/// A picture of curves.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Chart {
    /// First line.
    pub title: String,
    /// Second line.
    pub subtitle: String,
    /// Name of the horizontal axis with its unit.
    pub x: String,
    /// Whether only whole numbers are written at the horizontal axis.
    pub whole: bool,
    /// Whether the horizontal axis is logarithmic.
    pub logarithmic_x: bool,
    /// Name of the vertical axis with its unit.
    pub y: String,
    /// Whether the vertical axis is logarithmic.
    pub logarithmic: bool,
    /// The curves.
    pub curves: Vec<Curve>,
    /// Horizontal lines with their names.
    pub limits: Vec<(String, f64)>,
    /// A point that stands out, with its name.
    pub mark: Option<(String, [f64; 2])>,
}

/// A curve.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Curve {
    /// Name in the legend.
    pub name: String,
    /// Its points in order.
    pub points: Vec<[f64; 2]>,
    /// Whether the points are shown.
    pub dots: bool,
}

/// Draws curves as the text of an SVG file.
///
/// # Errors
/// [`PictureError`] when the drawing library refuses.
pub fn draw(chart: &Chart) -> Result<String, PictureError> {
    let legend = Legend::of(chart);
    let head = HEAD + (legend.rows - 1) * ROW;
    let height = HEIGHT + head - HEAD;
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (WIDTH * FINE, height * FINE)).into_drawing_area();
        root.fill(&WHITE).map_err(PictureError::of)?;
        let (top, below) = root.split_vertically(fine(head));
        text(&top, &chart.title, 19, LEFT, 20)?;
        text(&top, &chart.subtitle, 13, LEFT, 44)?;
        legend.draw(&top)?;
        curves(&below, chart)?;
        root.present().map_err(PictureError::of)?;
    }
    let drawn = format!("width=\"{}\" height=\"{}\"", WIDTH * FINE, height * FINE);
    Ok(svg.replacen(&drawn, &format!("width=\"{WIDTH}\" height=\"{height}\""), 1))
}

fn curves(area: &Area<'_>, chart: &Chart) -> Result<(), PictureError> {
    let place = |point: &[f64; 2]| {
        let value = if chart.logarithmic { point[1].log10() } else { point[1] };
        let x = if chart.logarithmic_x { point[0].log10() } else { point[0] };
        (x.is_finite() && value.is_finite()).then_some((x, value))
    };
    let all: Vec<(f64, f64)> = chart
        .curves
        .iter()
        .flat_map(|curve| &curve.points)
        .chain(chart.mark.iter().map(|mark| &mark.1))
        .filter_map(place)
        .collect();
    let limits: Vec<f64> =
        chart.limits.iter().filter_map(|(_, value)| place(&[1.0, *value])).map(|(_, value)| value).collect();
    let (left, right) = range(all.iter().map(|point| point.0), 0.0);
    let heights = all.iter().map(|point| point.1).chain(limits.iter().copied());
    let (low, high) = range(heights, if chart.logarithmic { 0.15 } else { 0.06 });
    let mut axes = ChartBuilder::on(area)
        .margin_top(fine(6))
        .margin_bottom(fine(8))
        .margin_left(fine(EDGE))
        .margin_right(fine(28))
        .x_label_area_size(fine(46))
        .y_label_area_size(fine(84 - EDGE))
        .build_cartesian_2d(left..right, low..high)
        .map_err(PictureError::of)?;
    let decimals = if right - left < 1.0 { 2 } else { usize::from(right - left < 5.0) };
    let logarithmic = chart.logarithmic;
    axes.configure_mesh()
        .max_light_lines(0)
        .bold_line_style(GRID.stroke_width(fine(1) as u32))
        .axis_style(INK.stroke_width(fine(1) as u32))
        .x_labels(14)
        .y_labels(8)
        .x_label_formatter(&|value| match value.fract().abs() > 1e-6 {
            _ if chart.logarithmic_x => significant(10f64.powf(*value)),
            true if chart.whole => String::new(),
            _ if chart.whole => format!("{value:.0}"),
            _ => format!("{value:.decimals$}"),
        })
        .y_label_formatter(&|value| {
            if logarithmic { format!("{:.0e}", 10f64.powf(*value)) } else { format!("{value:.0}") }
        })
        .label_style(font(12).into_font().color(&INK))
        .axis_desc_style(font(13).into_font().color(&INK))
        .x_desc(&chart.x)
        .y_desc(&chart.y)
        .set_all_tick_mark_size(fine(4))
        .draw()
        .map_err(PictureError::of)?;
    for limit in limits {
        let line = DashedLineSeries::new(
            [(left, limit), (right, limit)],
            fine(8),
            fine(5),
            LIMIT.stroke_width(fine(1) as u32),
        );
        axes.draw_series(line).map_err(PictureError::of)?;
    }
    for (curve, colour) in chart.curves.iter().zip(PALETTE.iter().cycle()) {
        let points: Vec<(f64, f64)> = curve.points.iter().filter_map(place).collect();
        axes.draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(fine(2) as u32)))
            .map_err(PictureError::of)?;
        if curve.dots {
            let dots = points.iter().map(|point| Circle::new(*point, fine(4), colour.filled()));
            axes.draw_series(dots).map_err(PictureError::of)?;
        }
    }
    if let Some(point) = chart.mark.as_ref().and_then(|(_, point)| place(point)) {
        let ring = Circle::new(point, fine(8), INK.stroke_width(fine(2) as u32));
        axes.draw_series([ring]).map_err(PictureError::of)?;
    }
    Ok(())
}

/// A number with two significant digits.
fn significant(value: f64) -> String {
    if value >= 10.0 {
        let unit = 10f64.powf(value.log10().floor() - 1.0);
        format!("{:.0}", (value / unit).round() * unit)
    } else {
        format!("{value:.1}")
    }
}

/// Smallest and largest value with a share of the range added at both ends.
fn range(values: impl Iterator<Item = f64>, share: f64) -> (f64, f64) {
    let (low, high) = values
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return (0.0, 1.0);
    }
    let width = (high - low).max(1e-9 * high.abs().max(1.0));
    if high - low < width { (low - 0.5, high + 0.5) } else { (low - share * width, high + share * width) }
}

/// Names and colours, in rows.
struct Legend<'a> {
    rows: u32,
    /// Name, colour, kind and place of the left end [pixels].
    entries: Vec<(&'a str, RGBColor, Kind, u32, u32)>,
}

#[derive(Clone, Copy)]
enum Kind {
    Line,
    Dashes,
    Ring,
}

impl<'a> Legend<'a> {
    fn of(chart: &'a Chart) -> Self {
        let curves = chart
            .curves
            .iter()
            .zip(PALETTE.iter().cycle())
            .map(|(curve, colour)| (curve.name.as_str(), *colour, Kind::Line));
        // Two limits of one name, for both sides, are told once.
        let told = |index: usize| chart.limits[..index].iter().any(|limit| limit.0 == chart.limits[index].0);
        let limits = (0..chart.limits.len())
            .filter(|index| !told(*index))
            .map(|index| (chart.limits[index].0.as_str(), LIMIT, Kind::Dashes));
        let mark = chart.mark.iter().map(|(name, _)| (name.as_str(), INK, Kind::Ring));
        let mut legend = Self { rows: 1, entries: Vec::new() };
        let mut left = LEFT;
        for (name, colour, kind) in curves.chain(limits).chain(mark) {
            let width = SAMPLE + 6 + (name.len() as f64 * LETTER) as u32 + 16;
            if left > LEFT && left + width > WIDTH - EDGE {
                left = LEFT;
                legend.rows += 1;
            }
            legend.entries.push((name, colour, kind, left, 68 + (legend.rows - 1) * ROW));
            left += width;
        }
        legend
    }

    fn draw(&self, area: &Area<'_>) -> Result<(), PictureError> {
        for (name, colour, kind, left, middle) in &self.entries {
            let at = |x: u32| (fine(left + x), fine(*middle));
            let mut bars: Vec<Vec<(i32, i32)>> = Vec::new();
            match kind {
                Kind::Line => bars.push(vec![at(0), at(SAMPLE)]),
                Kind::Dashes => bars.extend([0, 10, 20].map(|dash| vec![at(dash), at(dash + 6)])),
                Kind::Ring => {
                    let ring = Circle::new(at(SAMPLE / 2), fine(6), colour.stroke_width(fine(2) as u32));
                    area.draw(&ring).map_err(PictureError::of)?;
                }
            }
            for bar in bars {
                area.draw(&PathElement::new(bar, colour.stroke_width(fine(2) as u32)))
                    .map_err(PictureError::of)?;
            }
            text(area, name, 12, left + SAMPLE + 6, *middle)?;
        }
        Ok(())
    }
}

fn text(area: &Area<'_>, text: &str, size: u32, x: u32, y: u32) -> Result<(), PictureError> {
    let style = font(size).into_font().color(&INK).pos(Pos::new(HPos::Left, VPos::Center));
    area.draw_text(text, &style, (fine(x), fine(y))).map_err(PictureError::of)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_axes_and_limits_are_drawn() {
        let curve = Curve {
            name: "gauss-2".to_owned(),
            points: vec![[1.0, 5e-4], [2.0, 4e-4], [6.0, 2e-4]],
            dots: true,
        };
        let chart = Chart {
            title: "intervals".to_owned(),
            x: "N".to_owned(),
            y: "error [m]".to_owned(),
            logarithmic: true,
            curves: vec![curve; 12],
            limits: vec![("tolerance".to_owned(), 2.5e-4)],
            mark: Some(("N = 6".to_owned(), [6.0, 2e-4])),
            ..Chart::default()
        };
        let svg = draw(&chart).unwrap();
        assert!(svg.starts_with("<svg width=\"1200\" height=\"") && svg.trim_end().ends_with("</svg>"));
        for name in ["intervals", "gauss-2", "error [m]", "tolerance", "N = 6"] {
            assert!(svg.contains(name), "{name}");
        }
        assert!(Legend::of(&chart).rows > 1);
    }

    #[test]
    fn nothing_and_nonsense_are_drawn_too() {
        draw(&Chart::default()).unwrap();
        let points = vec![[0.0, 0.0], [1.0, -1.0], [f64::NAN, 1.0], [2.0, f64::INFINITY]];
        let curve = Curve { points, ..Curve::default() };
        draw(&Chart { logarithmic: true, curves: vec![curve.clone()], ..Chart::default() }).unwrap();
        draw(&Chart { curves: vec![curve], ..Chart::default() }).unwrap();
    }
}
