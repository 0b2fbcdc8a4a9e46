//! Initial states for the benchmark, from a CSV file with a header.
//!
//! Columns are found by name: `x1` to `x5` (sideslip, yaw, yaw rate, x, y) must be there, `goal_x_m`, `goal_y_m`,
//! `obstacle_x_m`, `obstacle_y_m`, `obstacle_a_m`, `obstacle_b_m` and `lap` may be, others are ignored. Rows of the
//! same `lap` that follow each other are consecutive scans; without that column each row starts straight on. Quotes
//! inside of fields have no meaning: all values are numbers.

use vehicle::State;

use super::problem::{Case, StaticEllipse};

/// The default set: three laps, recorded by `cargo run -p scanloop-lab --example record_solver_cases`.
pub(super) const SHIPPED: &str = include_str!("../../cases/solver.csv");

/// Maximum number of rows.
const MAX_ROWS: usize = 100_000;

/// Reads all cases.
///
/// # Errors
/// A text that names line and column, and what is allowed.
pub(super) fn parse(text: &str) -> Result<Vec<Case>, String> {
    let mut lines = text.lines().enumerate().map(|(index, line)| (index + 1, line));
    // Some programs write a byte order mark before the first name.
    let header = lines.next().map_or("", |(_, header)| header);
    let header: Vec<&str> = header.trim_start_matches('\u{feff}').split(',').map(bare).collect();
    if header.iter().all(|name| name.is_empty()) {
        return Err("line 1: a header with the columns x1, x2, x3, x4, x5 is missing".to_owned());
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
            return Err(format!("line {line}: more than {MAX_ROWS} cases"));
        }
        let row = CaseRow { line, header: &header, fields: text.split(',').map(bare).collect() };
        let [sideslip, yaw, yaw_rate, x, y] = states;
        let state = State {
            // The model divides by cos(sideslip); larger yaws and positions are typing errors.
            sideslip: row.number(sideslip, -1.5, 1.5)?,
            yaw: row.number(yaw, -10.0, 10.0)?,
            yaw_rate: row.number(yaw_rate, -100.0, 100.0)?,
            x: row.number(x, -1e5, 1e5)?,
            y: row.number(y, -1e5, 1e5)?,
        };
        let mut values = [0.0; 6];
        for (index, (column, value)) in optional.iter().enumerate() {
            let (min, max) = if index < 4 { (-1e5, 1e5) } else { (0.01, 100.0) };
            values[index] = column.map_or(Ok(*value), |column| row.number(column, min, max))?;
        }
        let [goal_x, goal_y, x, y, a, b] = values;
        let lap = lap.map(|column| row.whole(column)).transpose()?;
        cases.push(Case { line, state, goal: [goal_x, goal_y], obstacle: StaticEllipse { x, y, a, b }, lap });
    }
    if cases.is_empty() { Err("no case below the header".to_owned()) } else { Ok(cases) }
}

/// A field without blanks and quotes around it.
fn bare(field: &str) -> &str {
    field.trim().trim_matches('"')
}

fn find(header: &[&str], name: &str) -> Result<Option<usize>, String> {
    let mut found = header.iter().enumerate().filter(|(_, column)| **column == name).map(|(index, _)| index);
    let first = found.next();
    match found.next() {
        Some(_) => Err(format!("line 1: column `{name}` is there twice")),
        None => Ok(first),
    }
}

fn required(header: &[&str], name: &str) -> Result<usize, String> {
    find(header, name)?
        .ok_or_else(|| format!("line 1: column `{name}` is missing; x1, x2, x3, x4, x5 must be there"))
}

struct CaseRow<'a> {
    line: usize,
    header: &'a [&'a str],
    fields: Vec<&'a str>,
}

impl CaseRow<'_> {
    /// The value of a column, if `read` accepts it as `allowed`.
    fn value<T>(&self, column: usize, allowed: &str, read: impl Fn(&str) -> Option<T>) -> Result<T, String> {
        let (line, name) = (self.line, self.header[column]);
        let field =
            self.fields.get(column).ok_or_else(|| format!("line {line}: column `{name}` is missing"))?;
        read(field).ok_or_else(|| format!("line {line}, column `{name}`: `{field}` is not {allowed}"))
    }

    fn number(&self, column: usize, min: f64, max: f64) -> Result<f64, String> {
        let read = |field: &str| field.parse().ok().filter(|value| (min..=max).contains(value));
        self.value(column, &format!("a number from {min} to {max}"), read)
    }

    fn whole(&self, column: usize) -> Result<u64, String> {
        self.value(column, "a whole number from 0", |field| field.parse().ok())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        parse(text).unwrap_err()
    }

    #[test]
    fn columns_are_found_by_name_and_others_are_ignored() {
        let cases = parse("note,x5,x4,\"x3\",x2,x1\nhello,0.5,4,0.3,0.2,0.1\n\n,1,2,3,4,0\n").unwrap();
        assert_eq!(cases.len(), 2);
        assert_eq!(cases[0].state, State { sideslip: 0.1, yaw: 0.2, yaw_rate: 0.3, x: 4.0, y: 0.5 });
        assert_eq!((cases[0].line, cases[1].line), (2, 4));
        assert_eq!(cases[0].goal, [10.0, 0.0]);
        assert_eq!(cases[0].obstacle, StaticEllipse { x: 5.0, y: 0.1, a: 1.2, b: 0.8 });
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
