//! A table as text: columns as wide as their widest cell, two blanks apart.

use std::fmt;

/// Alignment of the cells of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Align {
    /// Texts.
    Left,
    /// Numbers.
    Right,
}

/// Rows of cells below a heading; [`fmt::Display`] lays them out.
#[derive(Debug, Clone)]
pub struct Table {
    columns: Vec<Align>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table with these headings.
    pub fn new(columns: &[(&str, Align)]) -> Self {
        let heading = columns.iter().map(|(name, _)| (*name).to_owned()).collect();
        Self { columns: columns.iter().map(|(_, align)| *align).collect(), rows: vec![heading] }
    }

    /// A table with a column of names, and columns of numbers.
    pub fn of_numbers(name: &str, numbers: &[&str]) -> Self {
        let numbers = numbers.iter().map(|heading| (*heading, Align::Right));
        Self::new(&std::iter::once((name, Align::Left)).chain(numbers).collect::<Vec<_>>())
    }

    /// Adds a row; cells beyond the columns are left out.
    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }
}

impl fmt::Display for Table {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = |column: usize| {
            let cells = self.rows.iter().filter_map(|row| row.get(column));
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.columns.len()).map(width).collect();
        for row in &self.rows {
            let mut line = String::new();
            for ((cell, align), width) in row.iter().zip(&self.columns).zip(&widths) {
                line += &match align {
                    Align::Left => format!("{cell:<width$}  "),
                    Align::Right => format!("{cell:>width$}  "),
                };
            }
            writeln!(formatter, "{}", line.trim_end())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_wide_as_their_widest_cell() {
        let mut table = Table::new(&[("name", Align::Left), ("p50", Align::Right), ("verdict", Align::Left)]);
        table.row(["a longer one", "1.5", "no"].map(str::to_owned));
        table.row(["short", "12345.0", "yes"].map(str::to_owned));
        let lines = "name              p50  verdict\na longer one      1.5  no\nshort         12345.0  yes\n";
        assert_eq!(table.to_string(), lines);
    }

    #[test]
    fn a_row_may_be_short() {
        let mut table = Table::of_numbers("time", &["p50"]);
        table.row(["none".to_owned()]);
        assert_eq!(table.to_string(), "time  p50\nnone\n");
    }
}
