//! Tables of recorded runs.
//!
//! Comma separated values, one header line, columns by name in any order, units in their names; lines that begin
//! with `#` are comments. A value may be left empty where the column's description allows it.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::Refusal;

/// One straight run between two fixed points, passed at full speed.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StraightRun {
    /// Velocity sent to the robot during the whole run [m/s].
    pub sent_velocity_mps: f64,
    /// Distance of the two points by tape measure [m].
    pub distance_m: f64,
    /// Time from passing the first to passing the second by stopwatch [s].
    pub time_s: f64,
    /// File and line, for messages.
    #[serde(skip)]
    pub place: String,
}

/// From which side the shaft came to its angle; with play the wheels lag to that side.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// From smaller angles (further right): the wheels lag to the right.
    Below,
    /// From larger angles: the wheels lag to the left.
    Above,
}

/// One steady circle run: an arc marked on the ground.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CircleRun {
    /// Steering angle sent to the robot during the whole run, positive to the left [rad].
    pub sent_steering_rad: f64,
    /// `below` or `above`: from which side the angle was approached; empty when it is not known.
    #[serde(default)]
    pub approached_from: Option<Side>,
    /// Chord of the arc, s [m].
    pub chord_m: f64,
    /// Height of the arc over the middle of its chord, h; positive for a left turn, negative for a right one [m].
    pub height_m: f64,
    /// File and line, for messages.
    #[serde(skip)]
    pub place: String,
}

/// One odometry sample of a sine run, and where the robot really was.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SineRow {
    /// Number of the run; the rows of a run stand together, in the order of time.
    pub run: u32,
    /// Time since the run began to move [s].
    pub time_s: f64,
    /// Steering angle sent from this row to the next; empty when it was not recorded [rad].
    #[serde(default)]
    pub sent_steering_rad: Option<f64>,
    /// Reported position [m].
    pub reported_x_m: f64,
    /// Reported position [m].
    pub reported_y_m: f64,
    /// Reported yaw [rad].
    pub reported_yaw_rad: f64,
    /// Speed measured at the wheels, from this row on [m/s].
    pub speed_mps: f64,
    /// True position by tape measure; both are empty where it was not measured [m].
    #[serde(default)]
    pub measured_x_m: Option<f64>,
    /// True position by tape measure [m].
    #[serde(default)]
    pub measured_y_m: Option<f64>,
    /// File and line, for messages.
    #[serde(skip)]
    pub place: String,
}

/// A row of a table.
pub trait Record: Serialize + DeserializeOwned {
    /// Remembers file and line for messages.
    fn locate(&mut self, place: String);

    /// Number of the run where rows have one.
    fn run(&mut self) -> Option<&mut u32> {
        None
    }
}

impl Record for StraightRun {
    fn locate(&mut self, place: String) {
        self.place = place;
    }
}

impl Record for CircleRun {
    fn locate(&mut self, place: String) {
        self.place = place;
    }
}

impl Record for SineRow {
    fn locate(&mut self, place: String) {
        self.place = place;
    }

    fn run(&mut self) -> Option<&mut u32> {
        Some(&mut self.run)
    }
}

/// Adds the rows of a further table; its runs get numbers after all others, because each table counts from one.
pub fn append<R: Record>(rows: &mut Vec<R>, more: &mut Vec<R>) {
    let last = rows.iter_mut().filter_map(|row| row.run().copied()).max().unwrap_or(0);
    for number in more.iter_mut().filter_map(|row| row.run()) {
        *number = number.saturating_add(last).saturating_add(1);
    }
    rows.append(more);
}

/// The rows of a table; `file` stands in messages only.
///
/// # Errors
/// [`Refusal::Unreadable`] with file, line and column.
pub fn read<R: Record>(text: &str, file: &str) -> Result<Vec<R>, Refusal> {
    let mut reader =
        csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(text.as_bytes());
    let headers = reader.headers().map_err(|error| unreadable(file, &error, None))?.clone();
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| unreadable(file, &error, Some(&headers)))?;
        let line = record.position().map_or(0, csv::Position::line);
        let mut row: R =
            record.deserialize(Some(&headers)).map_err(|error| unreadable(file, &error, Some(&headers)))?;
        row.locate(format!("{file}: line {line}"));
        rows.push(row);
    }
    Ok(rows)
}

/// The table that reads back as these rows.
pub fn write<R: Record>(rows: &[R]) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        // Plain structs of numbers and texts can always be written to memory.
        let _ = writer.serialize(row);
    }
    writer.into_inner().ok().and_then(|bytes| String::from_utf8(bytes).ok()).unwrap_or_default()
}

fn unreadable(file: &str, error: &csv::Error, headers: Option<&csv::StringRecord>) -> Refusal {
    // A column that is missing or unknown is the fault of the header line, not of the row where it is noticed.
    let of_header = matches!(error.kind(), csv::ErrorKind::Deserialize { err, .. } if err.field().is_none());
    let line = error.position().map_or(1, csv::Position::line);
    let place = if of_header { format!("{file}: header") } else { format!("{file}: line {line}") };
    let message = match error.kind() {
        csv::ErrorKind::Deserialize { err, .. } => {
            let field = err.field().and_then(|field| headers?.get(usize::try_from(field).ok()?));
            let column = field.map_or_else(String::new, |name| format!("{name}: "));
            format!("{column}{}", err.kind())
        }
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("{len} values, but the header names {expected_len} columns")
        }
        _ => error.to_string(),
    };
    Refusal::unreadable(place, message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_reads_back_as_it_was_written() {
        let rows = vec![
            CircleRun {
                sent_steering_rad: 0.05,
                approached_from: Some(Side::Below),
                chord_m: 2.5,
                height_m: 0.2,
                ..CircleRun::default()
            },
            CircleRun {
                sent_steering_rad: -0.1 / 3.0,
                chord_m: 2.5,
                height_m: -1e-9,
                ..CircleRun::default()
            },
        ];
        let mut read: Vec<CircleRun> = read(&write(&rows), "runs.csv").unwrap();
        assert_eq!(read[1].place, "runs.csv: line 3");
        read.iter_mut().for_each(|row| row.place.clear());
        assert_eq!(read, rows);
    }

    #[test]
    fn columns_may_come_in_any_order_with_comments_and_optional_ones_left_out() {
        let text = "# hall 3, dry floor\nheight_m, chord_m, sent_steering_rad\n0.2, 2.5, 0.05\n";
        let rows: Vec<CircleRun> = read(text, "a.csv").unwrap();
        assert_eq!((rows[0].height_m, rows[0].approached_from), (0.2, None));
    }

    #[test]
    fn runs_of_further_tables_get_numbers_of_their_own() {
        let table = |numbers: &[u32]| -> Vec<SineRow> {
            numbers.iter().map(|run| SineRow { run: *run, ..SineRow::default() }).collect()
        };
        let mut rows = Vec::new();
        append(&mut rows, &mut table(&[1, 1, 2]));
        append(&mut rows, &mut table(&[1, 2]));
        assert_eq!(rows.iter().map(|row| row.run).collect::<Vec<_>>(), [2, 2, 3, 5, 6]);
    }

    #[test]
    fn messages_name_file_line_and_column() {
        let message = |text: &str| read::<StraightRun>(text, "a.csv").unwrap_err().to_string();
        let head = "sent_velocity_mps,distance_m,time_s\n";
        assert_eq!(
            message(&format!("{head}1.0,5.0,6.9\n1.0,5.0,fast\n")),
            "a.csv: line 3: time_s: invalid float literal"
        );
        assert_eq!(
            message(&format!("{head}1.0,5.0\n")),
            "a.csv: line 2: 2 values, but the header names 3 columns"
        );
        let missing = message("# hall 3\nsent_velocity_mps,distance_m\n1.0,5.0\n");
        assert_eq!(missing, "a.csv: header: missing field `time_s`");
        let unknown = message("sent_velocity_mps,distance_m,time_s,note\n1.0,5.0,6.9,x\n");
        assert!(unknown.contains("unknown field `note`"), "{unknown}");
    }
}
