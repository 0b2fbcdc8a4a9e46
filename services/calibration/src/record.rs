//! Tables of recorded runs.
//!
//! Comma separated values, one header line, columns by name in any order, units in their names; lines that begin
//! with `#` are comments. A value may be left empty where the column's description allows it.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::RunRefusal;

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
pub enum ApproachSide {
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
    pub approached_from: Option<ApproachSide>,
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
/// [`RunRefusal::Unreadable`] with file, line and column.
pub fn read<R: Record>(text: &str, file: &str) -> Result<Vec<R>, RunRefusal> {
    let mut reader =
        csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(text.as_bytes());
    let headers = reader.headers().map_err(|error| unreadable(text, file, &error))?.clone();
    let (mut rows, mut lines) = (Vec::new(), Lines::of(text));
    for record in reader.records() {
        let record = record.map_err(|error| unreadable(text, file, &error))?;
        let place = format!("{file}: line {}", lines.line(record.position()));
        let mut row: R = record
            .deserialize(Some(&headers))
            .map_err(|error| not_a_row(file, &place, &error, &headers, &record))?;
        row.locate(place);
        rows.push(row);
    }
    Ok(rows)
}

/// Counts the lines of a text up to one record after the other.
struct Lines<'a> {
    text: &'a str,
    counted: usize,
    line: usize,
}

impl<'a> Lines<'a> {
    fn of(text: &'a str) -> Self {
        Self { text, counted: 0, line: 1 }
    }

    /// The line of a record. Its position is the end of the record before, so comments and empty lines may follow that.
    fn line(&mut self, position: Option<&csv::Position>) -> usize {
        let start = position.and_then(|position| usize::try_from(position.byte()).ok());
        let start = start.unwrap_or_default().clamp(self.counted, self.text.len());
        self.line += self.text[self.counted..start].matches('\n').count();
        self.counted = start;
        let is_skipped = |line: &&str| line.is_empty() || line.starts_with('#');
        self.line + self.text[start..].lines().take_while(is_skipped).count()
    }
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

/// A text that is no table.
fn unreadable(text: &str, file: &str, error: &csv::Error) -> RunRefusal {
    let line = Lines::of(text).line(error.position());
    let message = match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("{len} values, but the header names {expected_len} columns")
        }
        _ => error.to_string(),
    };
    RunRefusal::unreadable(format!("{file}: line {line}"), message)
}

/// A row with a value that its column can't have.
fn not_a_row(
    file: &str,
    place: &str,
    error: &csv::Error,
    headers: &csv::StringRecord,
    record: &csv::StringRecord,
) -> RunRefusal {
    use csv::DeserializeErrorKind::{ParseFloat, ParseInt};

    let csv::ErrorKind::Deserialize { err, .. } = error.kind() else {
        return RunRefusal::unreadable(place, error.to_string());
    };
    // A column that is missing or unknown is the fault of the header line, not of the row where it is noticed.
    let Some(field) = err.field().and_then(|field| usize::try_from(field).ok()) else {
        return RunRefusal::unreadable(format!("{file}: header"), err.kind().to_string());
    };
    let [name, value] = [headers, record].map(|row| row.get(field).unwrap_or_default());
    let allowed = match err.kind() {
        ParseFloat(_) => "a number, with a point and without its unit".to_owned(),
        ParseInt(_) => "a whole number from 0".to_owned(),
        other => other.to_string(),
    };
    RunRefusal::unreadable(place, format!("{name} = {value} is not allowed: {allowed}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_reads_back_as_it_was_written() {
        let rows = vec![
            CircleRun {
                sent_steering_rad: 0.05,
                approached_from: Some(ApproachSide::Below),
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
            "a.csv: line 3: time_s = fast is not allowed: a number, with a point and without its unit"
        );
        assert!(
            message(&format!("{head}# fast\n\n1.0,5.0,fast\n")).starts_with("a.csv: line 4: time_s = fast")
        );
        assert!(message(&format!("{head}# fast\r\n\r\n1.0,5.0\r\n")).starts_with("a.csv: line 4: 2 values"));
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
