//! Initial states for the benchmark, from a CSV file with a header.
//!
//! Columns are found by name: `x1` to `x5` (sideslip, yaw, yaw rate, x, y) must be there, `goal_x_m`, `goal_y_m`,
//! `obstacle_x_m`, `obstacle_y_m`, `obstacle_a_m`, `obstacle_b_m` and `lap` may be, others are ignored. Rows of the same
//! `lap` that follow each other are consecutive scans; without that column every row stands for itself. There is no
//! quoting inside of fields: all that is read is numbers.

use vehicle::State;

use super::problem::{Case, Ellipse};

/// The default set: three laps, recorded by `cargo run -p scanloop-benches --example record_solver_cases`.
pub(super) const SHIPPED: &str = include_str!("../../../../../benches/cases/solver.csv");

/// More rows than this are a mistake.
const MAX_ROWS: usize = 100_000;

/// What is wrong with a file of cases.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum BadCases {
    /// Nothing to read the names of the columns from.
    #[error("line 1: a header with the columns x1, x2, x3, x4, x5 is missing")]
    NoHeader,
    /// A column that must be there is not.
    #[error("line 1: column `{column}` is missing; x1, x2, x3, x4, x5 must be there")]
    Missing {
        /// Its name.
        column: String,
    },
    /// A column that is used stands there twice.
    #[error("line 1: column `{column}` is there twice")]
    Twice {
        /// Its name.
        column: String,
    },
    /// A row is shorter than the header.
    #[error("line {line}: column `{column}` is missing")]
    Short {
        /// Number of the line.
        line: usize,
        /// The column.
        column: String,
    },
    /// A field is not what it must be.
    #[error("line {line}, column `{column}`: `{value}` is not {allowed}")]
    Value {
        /// Number of the line.
        line: usize,
        /// The column.
        column: String,
        /// What stands there.
        value: String,
        /// What may stand there.
        allowed: String,
    },
    /// No rows.
    #[error("no case below the header")]
    Empty,
    /// Too many rows.
    #[error("line {line}: more than {MAX_ROWS} cases")]
    TooMany {
        /// Number of the line.
        line: usize,
    },
}

/// Reads all cases.
pub(super) fn parse(text: &str) -> Result<Vec<Case>, BadCases> {
    let mut lines = text.lines().enumerate().map(|(index, line)| (index + 1, line));
    // A mark of byte order, as some programs write it, is no part of the first name.
    let (_, header) = lines.next().ok_or(BadCases::NoHeader)?;
    let header: Vec<&str> = header.trim_start_matches('\u{feff}').split(',').map(bare).collect();
    if header.iter().all(|name| name.is_empty()) {
        return Err(BadCases::NoHeader);
    }
    let states = ["x1", "x2", "x3", "x4", "x5"].map(|name| required(&header, name));
    let [x1, x2, x3, x4, x5] = states;
    let states = [x1?, x2?, x3?, x4?, x5?];
    let default = Case::default();
    let columns = [
        ("goal_x_m", default.goal[0]),
        ("goal_y_m", default.goal[1]),
        ("obstacle_x_m", default.obstacle.x),
        ("obstacle_y_m", default.obstacle.y),
        ("obstacle_a_m", default.obstacle.a),
        ("obstacle_b_m", default.obstacle.b),
    ];
    let mut optional = Vec::new();
    for (name, value) in columns {
        optional.push((find(&header, name)?, value));
    }
    let lap = find(&header, "lap")?;

    let mut cases = Vec::new();
    for (line, text) in lines.filter(|(_, text)| !text.trim().is_empty()) {
        if cases.len() == MAX_ROWS {
            return Err(BadCases::TooMany { line });
        }
        let row = Row { line, header: &header, fields: text.split(',').map(bare).collect() };
        let [sideslip, yaw, yaw_rate, x, y] = states;
        let state = State {
            // The model divides by cos(sideslip); a yaw beyond a turn and a track beyond 100 km are slips of the pen.
            sideslip: row.number(sideslip, -1.5, 1.5)?,
            yaw: row.number(yaw, -10.0, 10.0)?,
            yaw_rate: row.number(yaw_rate, -100.0, 100.0)?,
            x: row.number(x, -1e5, 1e5)?,
            y: row.number(y, -1e5, 1e5)?,
        };
        let mut values = [0.0; 6];
        for (index, (column, value)) in optional.iter().enumerate() {
            let (least, most) = if index < 4 { (-1e5, 1e5) } else { (0.01, 100.0) };
            values[index] = column.map_or(Ok(*value), |column| row.number(column, least, most))?;
        }
        let [goal_x, goal_y, x, y, a, b] = values;
        let lap = lap.map(|column| row.whole(column)).transpose()?;
        cases.push(Case { line, state, goal: [goal_x, goal_y], obstacle: Ellipse { x, y, a, b }, lap });
    }
    if cases.is_empty() { Err(BadCases::Empty) } else { Ok(cases) }
}

/// A field without blanks and the quotes that some programs put around names.
fn bare(field: &str) -> &str {
    field.trim().trim_matches('"')
}

fn find(header: &[&str], name: &str) -> Result<Option<usize>, BadCases> {
    let mut found = header.iter().enumerate().filter(|(_, column)| **column == name).map(|(index, _)| index);
    let first = found.next();
    match found.next() {
        Some(_) => Err(BadCases::Twice { column: name.to_owned() }),
        None => Ok(first),
    }
}

fn required(header: &[&str], name: &str) -> Result<usize, BadCases> {
    find(header, name)?.ok_or_else(|| BadCases::Missing { column: name.to_owned() })
}

struct Row<'a> {
    line: usize,
    header: &'a [&'a str],
    fields: Vec<&'a str>,
}

impl Row<'_> {
    fn field(&self, column: usize) -> Result<&str, BadCases> {
        self.fields
            .get(column)
            .copied()
            .ok_or_else(|| BadCases::Short { line: self.line, column: self.header[column].to_owned() })
    }

    fn bad(&self, column: usize, value: &str, allowed: String) -> BadCases {
        let (column, value) = (self.header[column].to_owned(), value.to_owned());
        BadCases::Value { line: self.line, column, value, allowed }
    }

    fn number(&self, column: usize, least: f64, most: f64) -> Result<f64, BadCases> {
        let field = self.field(column)?;
        let value = field.parse::<f64>().ok().filter(|value| (least..=most).contains(value));
        value.ok_or_else(|| self.bad(column, field, format!("a number from {least} to {most}")))
    }

    fn whole(&self, column: usize) -> Result<u64, BadCases> {
        let field = self.field(column)?;
        field.parse().map_err(|_| self.bad(column, field, "a whole number from 0".to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        parse(text).unwrap_err().to_string()
    }

    #[test]
    fn columns_are_found_by_name_and_others_are_ignored() {
        let cases = parse("note,x5,x4,\"x3\",x2,x1\nhello,0.5,4,0.3,0.2,0.1\n\n,1,2,3,4,0\n").unwrap();
        assert_eq!(cases.len(), 2);
        assert_eq!(cases[0].state, State { sideslip: 0.1, yaw: 0.2, yaw_rate: 0.3, x: 4.0, y: 0.5 });
        assert_eq!((cases[0].line, cases[1].line), (2, 4));
        assert_eq!(cases[0].goal, [10.0, 0.0]);
        assert_eq!(cases[0].obstacle, Ellipse { x: 5.0, y: 0.1, a: 1.2, b: 0.8 });
        assert_eq!(cases[0].lap, None);
    }

    #[test]
    fn goal_obstacle_and_lap_are_taken_where_they_are_given() {
        let text = "x1,x2,x3,x4,x5,goal_x_m,obstacle_b_m,lap\n0,0,0,1,0,12,0.5,3";
        let case = parse(text).unwrap()[0];
        assert_eq!((case.goal, case.obstacle.a, case.obstacle.b, case.lap), ([12.0, 0.0], 1.2, 0.5, Some(3)));
    }

    #[test]
    fn messages_name_line_and_column() {
        let header = "x1,x2,x3,x4,x5";
        assert!(message("").contains("header"));
        assert!(message("\n1,2").contains("header"));
        assert!(message("x1,x2,x3,x4\n").contains("`x5` is missing"));
        assert!(message("x1,x1,x2,x3,x4,x5\n").contains("`x1` is there twice"));
        assert_eq!(message(header), "no case below the header");
        assert_eq!(message(&format!("{header}\n0,0,0,0")), "line 2: column `x5` is missing");
        assert_eq!(
            message(&format!("{header}\n0,0,0,0,0\n0,0,zero,0,0")),
            "line 3, column `x3`: `zero` is not a number from -100 to 100"
        );
        for bad in ["NaN", "inf", "", "2e5"] {
            let text = message(&format!("{header}\n0,0,0,{bad},0"));
            assert!(text.starts_with(&format!("line 2, column `x4`: `{bad}` is not")), "{text}");
        }
        assert!(message(&format!("{header},obstacle_a_m\n0,0,0,0,0,0")).contains("0.01 to 100"));
        assert!(message(&format!("{header},lap\n0,0,0,0,0,-1")).contains("whole number"));
    }

    #[test]
    fn the_shipped_cases_are_three_laps() {
        let cases = parse(SHIPPED).unwrap();
        let mut laps: Vec<_> = cases.iter().map(|case| case.lap.unwrap()).collect();
        laps.dedup();
        assert_eq!(laps, [1, 2, 3]);
        assert!((300..=450).contains(&cases.len()), "{}", cases.len());
    }
}
