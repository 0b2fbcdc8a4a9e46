//! The content of a picture of a fit.

/// Points and a line over two axes.
#[derive(Debug, Clone, PartialEq)]
pub struct FitChart {
    /// Title.
    pub title: String,
    /// Name and unit of the horizontal axis.
    pub across: &'static str,
    /// Name and unit of the vertical axis.
    pub up: &'static str,
    /// Measured points.
    pub points: Vec<[f64; 2]>,
    /// The fit; empty where there is none to show.
    pub line: Vec<[f64; 2]>,
}

impl FitChart {
    /// A chart of points alone.
    pub(crate) fn of_points(
        title: &str,
        across: &'static str,
        up: &'static str,
        points: Vec<[f64; 2]>,
    ) -> Self {
        Self { title: title.to_owned(), across, up, points, line: Vec::new() }
    }
}
