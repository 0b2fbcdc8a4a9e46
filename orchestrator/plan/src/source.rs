//! A file of settings as it was read, so that messages name the line of a key.

use console::exit::Failure;
use toml::Table;
use toml::de::{DeTable, DeValue};

/// A file that was read, with the name that it has in messages.
#[derive(Debug, Clone)]
pub struct SourceFile {
    /// What is in it, possibly with tables that it leaves out.
    pub table: Table,
    /// Its name.
    pub name: String,
    /// The text that the table was read from.
    pub(crate) text: String,
    /// Whether it comes with this program, so that no user wrote it.
    pub(crate) is_shipped: bool,
}

impl SourceFile {
    /// The table in the text of a file.
    ///
    /// # Errors
    /// A message with the file, and the line where the text is no TOML; exit code 2.
    pub fn parse(text: String, name: String) -> anyhow::Result<Self> {
        match vehicle::parse(&text) {
            Ok(table) => Ok(Self { table, name, text, is_shipped: false }),
            Err(error) => Err(Failure::bad_input(format!("{name}: {error}"))),
        }
    }

    /// The same of a file that comes with this program.
    ///
    /// # Errors
    /// As [`Self::parse`].
    pub(crate) fn shipped(text: &str, name: String) -> anyhow::Result<Self> {
        Self::parse(text.to_owned(), name).map(|source| Self { is_shipped: true, ..source })
    }

    /// Name of the file and line of a key in it.
    pub(crate) fn place(&self, path: &str) -> Option<String> {
        let root = DeTable::parse(&self.text).ok()?;
        let mut parts = path.split('.');
        let (mut span, mut value) = entry(root.get_ref(), parts.next()?)?;
        for part in parts {
            (span, value) = match value {
                DeValue::Table(table) => entry(table, part)?,
                DeValue::Array(items) => {
                    let item = items.get(part.parse::<usize>().ok()?)?;
                    (item.span().start, item.get_ref())
                }
                _ => return None,
            };
        }
        let line = 1 + self.text[..span].matches('\n').count();
        Some(format!("{}: line {line}", self.name))
    }
}

/// Where a key begins in the text, and its value.
fn entry<'a>(table: &'a DeTable<'_>, name: &str) -> Option<(usize, &'a DeValue<'a>)> {
    let (key, value) = table.iter().find(|(key, _)| key.get_ref() == name)?;
    Some((key.span().start, value.get_ref()))
}
