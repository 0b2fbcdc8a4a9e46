//! A chart of curves: the picture of a design analysis.
//!
//! A logarithmic axis is drawn by its exponents. Values that are not finite, or not positive on a logarithmic axis, are
//! left out.

use plotters::prelude::*;

use super::legend::{LEFT, Sample, width};
use super::{Area, EDGE, INK, Result, WIDTH, fine, mesh, svg, text};

/// Height of the picture [pixels].
const HEIGHT: u32 = 560;
/// Height of title, second line and one row of the legend [pixels].
const HEAD: u32 = 84;
/// Height of a further row of the legend [pixels].
const ROW: u32 = 22;
/// Height of a row of charts with its head [pixels].
const ROW_HEIGHT: u32 = 420;
/// Width for one number at the horizontal axis [pixels].
const LABEL: u32 = 85;
/// Limits.
const LIMIT: RGBColor = RGBColor(190, 60, 30);
/// One colour per curve, distinguishable in grey too.
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
/// [`super::PictureError`] when the drawing library refuses.
pub fn draw(chart: &Chart) -> Result<String> {
    let legend = Legend::of(chart);
    let head = HEAD + (legend.rows - 1) * ROW;
    svg(HEIGHT + head - HEAD, |root| {
        let (top, below) = root.split_vertically(fine(head));
        text(&top, &chart.title, 19, LEFT, 20)?;
        text(&top, &chart.subtitle, 13, LEFT, 44)?;
        legend.draw(&top)?;
        curves(&below, chart, std::slice::from_ref(chart))
    })
}

/// Draws charts side by side as the text of an SVG file: the same curves over several quantities.
///
/// Charts of one quantity have one vertical range, and all have the legend of the first one.
///
/// # Errors
/// [`super::PictureError`] when the drawing library refuses.
pub fn draw_row(title: &str, subtitle: &str, charts: &[Chart]) -> Result<String> {
    svg(ROW_HEIGHT, |root| {
        let (top, below) = root.split_vertically(fine(HEAD));
        text(&top, title, 19, LEFT, 20)?;
        text(&top, subtitle, 13, LEFT, 44)?;
        charts.first().map_or(Ok(()), |chart| Legend::of(chart).draw(&top))?;
        let areas = below.split_evenly((1, charts.len().max(1)));
        areas.iter().zip(charts).try_for_each(|(area, chart)| curves(area, chart, charts))
    })
}

impl Chart {
    /// A point as it is drawn, if it can be.
    fn place(&self, point: &[f64; 2]) -> Option<(f64, f64)> {
        let value = if self.logarithmic { point[1].log10() } else { point[1] };
        let x = if self.logarithmic_x { point[0].log10() } else { point[0] };
        (x.is_finite() && value.is_finite()).then_some((x, value))
    }

    /// All points of curves and mark.
    fn points(&self) -> impl Iterator<Item = (f64, f64)> {
        let points = self.curves.iter().flat_map(|curve| &curve.points);
        points.chain(self.mark.iter().map(|mark| &mark.1)).filter_map(|point| self.place(point))
    }

    /// Heights of the limits.
    fn heights(&self) -> impl Iterator<Item = f64> {
        self.limits.iter().filter_map(|(_, value)| self.place(&[1.0, *value])).map(|(_, value)| value)
    }
}

/// Draws a chart with the vertical range of those among several that have its quantity.
fn curves(area: &Area<'_>, chart: &Chart, together: &[Chart]) -> Result<()> {
    let place = |point: &[f64; 2]| chart.place(point);
    let (left, right) = range(chart.points().map(|point| point.0), 0.0);
    let together = together.iter().filter(|other| other.y == chart.y);
    let heights = together.flat_map(|chart| chart.points().map(|point| point.1).chain(chart.heights()));
    let (low, high) = range(heights, if chart.logarithmic { 0.15 } else { 0.06 });
    let across = area.dim_in_pixel().0 as usize / fine(LABEL) as usize;
    let mut axes = ChartBuilder::on(area)
        .margin_top(fine(6))
        .margin_bottom(fine(8))
        .margin_left(fine(EDGE))
        .margin_right(fine(28))
        .x_label_area_size(fine(46))
        .y_label_area_size(fine(84 - EDGE))
        .build_cartesian_2d(left..right, low..high)?;
    let decimals = if right - left < 1.0 { 2 } else { usize::from(right - left < 5.0) };
    let logarithmic = chart.logarithmic;
    mesh(&mut axes)
        .x_labels(across)
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
        .x_desc(&chart.x)
        .y_desc(&chart.y)
        .draw()?;
    for limit in chart.heights() {
        let (ends, style) = ([(left, limit), (right, limit)], LIMIT.stroke_width(fine(1) as u32));
        axes.draw_series(DashedLineSeries::new(ends, fine(8), fine(5), style))?;
    }
    for (curve, colour) in chart.curves.iter().zip(PALETTE.iter().cycle()) {
        let points: Vec<(f64, f64)> = curve.points.iter().filter_map(place).collect();
        axes.draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(fine(2) as u32)))?;
        if curve.dots {
            let dots = points.iter().map(|point| Circle::new(*point, fine(4), colour.filled()));
            axes.draw_series(dots)?;
        }
    }
    if let Some(point) = chart.mark.as_ref().and_then(|(_, point)| place(point)) {
        let ring = Circle::new(point, fine(8), INK.stroke_width(fine(2) as u32));
        axes.draw_series([ring])?;
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
pub(super) fn range(values: impl Iterator<Item = f64>, share: f64) -> (f64, f64) {
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
    /// Name, colour, sample, left end and middle of the row [pixels].
    entries: Vec<(&'a str, RGBColor, Sample, u32, u32)>,
}

impl<'a> Legend<'a> {
    fn of(chart: &'a Chart) -> Self {
        let curves = chart
            .curves
            .iter()
            .zip(PALETTE.iter().cycle())
            .map(|(curve, colour)| (curve.name.as_str(), *colour, Sample::Line));
        // Two limits of one name, for both sides, have one entry.
        let is_repeated =
            |index: usize| chart.limits[..index].iter().any(|limit| limit.0 == chart.limits[index].0);
        let limits = (0..chart.limits.len())
            .filter(|index| !is_repeated(*index))
            .map(|index| (chart.limits[index].0.as_str(), LIMIT, Sample::Dashes));
        let mark = chart.mark.iter().map(|(name, _)| (name.as_str(), INK, Sample::Ring));
        let mut legend = Self { rows: 1, entries: Vec::new() };
        let mut left = LEFT;
        for (name, colour, sample) in curves.chain(limits).chain(mark) {
            if left > LEFT && left + width(name) > WIDTH - EDGE {
                left = LEFT;
                legend.rows += 1;
            }
            legend.entries.push((name, colour, sample, left, 68 + (legend.rows - 1) * ROW));
            left += width(name);
        }
        legend
    }

    fn draw(&self, area: &Area<'_>) -> Result<()> {
        let mut entries = self.entries.iter();
        entries
            .try_for_each(|(name, colour, sample, left, row)| sample.draw(area, name, *colour, *left, *row))
    }
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
    fn charts_in_a_row_have_one_vertical_range() {
        let chart = |x: &str, highest: f64| Chart {
            x: x.to_owned(),
            curves: vec![Curve { points: vec![[0.0, 0.0], [1.0, highest]], ..Curve::default() }],
            ..Chart::default()
        };
        let curve = |highest: f64| {
            let svg = draw_row("costs", "three", &[chart("latency", 1.0), chart("rate", highest)]).unwrap();
            assert!(["costs", "three", "latency", "rate"].iter().all(|text| svg.contains(text)));
            let line = svg.split("stroke=\"#005C9E\" stroke-width=\"8\" points=\"").nth(2).unwrap();
            line.split('"').next().unwrap().to_owned()
        };
        // The first panel alone would look the same in both pictures.
        assert_eq!(curve(1.0), curve(1.0));
        assert_ne!(curve(1.0), curve(100.0));
        draw_row("", "", &[]).unwrap();
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
