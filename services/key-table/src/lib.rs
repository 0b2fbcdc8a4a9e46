//! Tables of keys: the settings of a file, each key declared once with its meaning, default and allowed values.
//!
//! [`settings!`] turns such a declaration into a struct that serde reads. The checks of its values and the pages
//! `docs/scenario-file.md` and `docs/system-file.md` come from the same declaration.

mod invalid;
mod key;
mod keyword;
mod read;
mod rule;
mod schema;
mod settings;

pub use invalid::{Invalid, require};
pub use key::{Key, Setting, read, require_key, toml_text};
pub use keyword::set_range;
pub use read::{ForeignLetter, of_text, parse, text_of, toml_fault};
#[doc(hidden)]
pub use read::{entries, unknown};
pub use rule::{Ascending, Documented, KeyRule, Numeric};
pub use schema::schema_of;
pub use shared_types::did_you_mean;
#[doc(hidden)]
pub use toml::{Table, Value};
