//! The ellipses that the optimum stays outside of.

/// Where the centre of an ellipse is.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Path {
    /// Always here [m].
    Fixed([f64; 2]),
    /// At these times here [s, m], and in between on straight lines; after the last one it keeps this velocity [m/s].
    Recorded(Vec<(f64, [f64; 2])>, [f64; 2]),
}

/// An ellipse with its margin, and from when on it is known.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Ellipse {
    /// Identity of the body that it covers, with others.
    pub body: u32,
    /// Semi-axis along the track [m].
    pub a: f64,
    /// Semi-axis across the track [m].
    pub b: f64,
    /// Whether the robot of the drive passed it on the left.
    pub passed_left: bool,
    /// Its centre.
    pub path: Path,
    /// When the command for the scan that first described it acts [s].
    pub known_s: f64,
    /// Where the robot was then [m].
    pub known_x_m: f64,
}

impl Ellipse {
    /// The centre at a time [m].
    pub(crate) fn centre_at(&self, time_s: f64) -> [f64; 2] {
        match &self.path {
            Path::Fixed(centre) => *centre,
            Path::Recorded(places, velocity) => {
                let after = places.partition_point(|(place_s, _)| *place_s <= time_s);
                match (after.checked_sub(1).map(|index| places[index]), places.get(after)) {
                    (Some((before_s, before)), Some((after_s, after))) => {
                        let share = (time_s - before_s) / (after_s - before_s);
                        std::array::from_fn(|index| before[index] + share * (after[index] - before[index]))
                    }
                    (Some((last_s, last)), None) => {
                        std::array::from_fn(|index| last[index] + velocity[index] * (time_s - last_s))
                    }
                    (None, Some((_, first))) => *first,
                    (None, None) => [0.0; 2],
                }
            }
        }
    }

    /// Whether it moves.
    pub(crate) fn moves(&self) -> bool {
        matches!(self.path, Path::Recorded(..))
    }

    /// Whether it is known to a robot that is at `x_m` at `time_s`.
    pub(crate) fn is_known(&self, time_s: f64, x_m: f64) -> bool {
        const ROUNDING: f64 = 1e-6;
        time_s >= self.known_s - ROUNDING || x_m >= self.known_x_m - ROUNDING
    }
}
