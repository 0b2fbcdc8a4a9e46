//! Types of samples that a system file adds: a header, fields of your own, and the stamps of the stage.
//!
//! The header is that of all samples. The stamps of the process that wrote the sample are its last field, `stage`,
//! because the header has places for the five roles only. A type is known by its name and by the fingerprint of its
//! fields, as the built-in ones are.
//!
//! Limit: a type that is made at run time lives until its process ends. A process makes each of them once.

use std::fmt;

use crate::describe::{Described, FNV_OFFSET, Field, Kind, fingerprint};
use crate::layouts::{LayoutRow, rows_of};
use crate::{Header, StageStamps};

/// Largest sample of a topic of your own [bytes].
pub const MAX_OWN_BYTES: usize = 4 << 20;
/// Most fields of one: each name is compared with all others.
const MAX_FIELDS: usize = 4096;
/// What header and stamps need of a sample [bytes].
const FRAME: usize = size_of::<Header>() + size_of::<StageStamps>();

/// The type of the samples of a topic of your own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OwnType {
    name: &'static str,
    fields: &'static [Field],
}

/// One field of such a type as a file describes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OwnField<'a> {
    /// Its name.
    pub name: &'a str,
    /// `u8`, `u16`, `u32`, `u64`, `i32` or `f64`, also with a number of elements: `f64[3]`.
    pub kind: &'a str,
    /// What it means, with the unit in brackets.
    pub doc: &'a str,
}

/// Why fields make no type of samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LayoutFault {
    /// The field, or the name of the type.
    pub at: String,
    /// What it is.
    pub value: String,
    /// What is allowed.
    pub allowed: String,
}

impl fmt::Display for LayoutFault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} = {} is not allowed: {}", self.at, self.value, self.allowed)
    }
}

impl std::error::Error for LayoutFault {}

impl OwnType {
    /// The type of a Rust struct.
    ///
    /// # Errors
    /// A struct that does not begin with `header: Header` and end with `stage: StageStamps`, or has nothing between.
    pub fn of<S: Described>() -> Result<Self, LayoutFault> {
        let fault = |at: &str, value: &str, allowed: &str| {
            Err(LayoutFault { at: at.to_owned(), value: value.to_owned(), allowed: allowed.to_owned() })
        };
        let Kind::Struct(name, fields) = S::KIND else {
            return fault("sample", "a value", "a struct that `plain_state!` declares");
        };
        match fields {
            [first, _, .., last] => {
                if first.name != "header" || first.kind != Header::KIND {
                    return fault(first.name, "the first field", "`header: Header` comes first");
                }
                if last.name != "stage" || last.kind != StageStamps::KIND {
                    return fault(last.name, "the last field", "`stage: StageStamps` comes last");
                }
                Ok(Self { name, fields })
            }
            _ => fault(name, "a struct of size 0", "fields between `header` and `stage`"),
        }
    }

    /// A type with these fields between header and stamps.
    ///
    /// # Errors
    /// A name or a kind that is not allowed, a name twice, a hole between two fields, no field, and too large a sample.
    pub fn new(name: &str, fields: &[OwnField<'_>]) -> Result<Self, LayoutFault> {
        let fault = |at: &str, value: String, allowed: &str| LayoutFault {
            at: at.to_owned(),
            value,
            allowed: allowed.to_owned(),
        };
        if !is_type_name(name) {
            return Err(fault(
                "name",
                name.to_owned(),
                "a capital letter, then letters and digits; at most 32",
            ));
        }
        if fields.is_empty() {
            return Err(fault(
                "field",
                "[]".to_owned(),
                "at least one field: a sample of size 0 says nothing",
            ));
        }
        if fields.len() > MAX_FIELDS {
            let allowed = format!("at most {MAX_FIELDS} fields");
            return Err(fault("field", format!("{} fields", fields.len()), &allowed));
        }
        let header = "Identity and stamps of the sample that this one answers";
        let mut all = vec![Field { name: "header", doc: header, offset: 0, kind: Header::KIND }];
        let mut offset = size_of::<Header>();
        for OwnField { name, kind, doc } in fields {
            if !is_field_name(name) || ["header", "stage"].contains(name) {
                let allowed = "a small letter, then small letters, digits and `_`; not header or stage";
                return Err(fault("field.name", (*name).to_owned(), allowed));
            }
            if all.iter().any(|field| field.name == *name) {
                return Err(fault("field.name", (*name).to_owned(), "each name once"));
            }
            let known = "u8, u16, u32, u64, i32 or f64, also with a number of elements as in f64[3]";
            let parsed = parse_kind(kind).ok_or_else(|| fault(name, (*kind).to_owned(), known))?;
            let alignment = match parsed {
                Kind::Array(element, _) => element.size(),
                single => single.size(),
            };
            require_no_hole(name, offset, alignment)?;
            all.push(Field { name: kept(name), doc: kept(doc), offset, kind: parsed });
            offset += parsed.size();
            if offset + FRAME > MAX_OWN_BYTES {
                return Err(fault(name, (*kind).to_owned(), "samples of at most 4 MiB"));
            }
        }
        require_no_hole("stage", offset, align_of::<StageStamps>())?;
        let stage = "When the process that published it worked on it";
        all.push(Field { name: "stage", doc: stage, offset, kind: StageStamps::KIND });
        Ok(Self { name: kept(name), fields: Box::leak(all.into_boxed_slice()) })
    }

    /// Its name, as `Imu`.
    pub const fn name(&self) -> &'static str {
        self.name
    }

    /// The fields, the header first and the stamps last.
    pub const fn fields(&self) -> &'static [Field] {
        self.fields
    }

    /// Size of a sample [bytes].
    pub const fn size(&self) -> usize {
        Kind::Struct(self.name, self.fields).size()
    }

    /// Hash of names, kinds and offsets of all fields, as [`crate::Sample::LAYOUT`].
    pub const fn layout(&self) -> u32 {
        fingerprint(&Kind::Struct(self.name, self.fields), FNV_OFFSET)
    }

    /// Name of the type on the bus: types with other fields have another name there.
    pub fn type_name(&self) -> String {
        format!("own.{}.{:08x}", self.name, self.layout())
    }

    /// The rows of a table of layouts for the topic that carries it.
    pub fn rows(&self, topic: &str) -> Vec<LayoutRow> {
        rows_of(topic, self.name, self.size(), self.fields)
    }

    /// Offsets of all numbers with a fraction behind the header: they must be finite [bytes].
    pub fn numbers(&self) -> Vec<usize> {
        let own = self.fields.iter().filter(|field| !matches!(field.kind, Kind::Struct(..)));
        own.flat_map(|field| {
            let (element, count) = match field.kind {
                Kind::Array(element, count) => (*element, count),
                single => (single, 1),
            };
            let count = if element == Kind::Scalar("f64") { count } else { 0 };
            (0..count).map(move |index| field.offset + index * size_of::<f64>())
        })
        .collect()
    }
}

fn require_no_hole(name: &str, offset: usize, alignment: usize) -> Result<(), LayoutFault> {
    let missing = offset.next_multiple_of(alignment) - offset;
    if missing == 0 {
        return Ok(());
    }
    Err(LayoutFault {
        at: name.to_owned(),
        value: format!("a field that begins at byte {offset}"),
        allowed: format!(
            "no hole before a field: it has to begin at a multiple of {alignment}; put a field `reserved` of type \
             u8[{missing}] before it"
        ),
    })
}

/// A text that lives as long as the process.
fn kept(text: &str) -> &'static str {
    Box::leak(text.to_owned().into_boxed_str())
}

fn is_type_name(name: &str) -> bool {
    let rest = name.strip_prefix(|first: char| first.is_ascii_uppercase());
    rest.is_some_and(|rest| rest.len() < 32 && rest.chars().all(|letter| letter.is_ascii_alphanumeric()))
}

fn is_field_name(name: &str) -> bool {
    let rest = name.strip_prefix(|first: char| first.is_ascii_lowercase());
    let allowed = |letter: char| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == '_';
    rest.is_some_and(|rest| rest.len() < 48 && rest.chars().all(allowed))
}

fn parse_kind(text: &str) -> Option<Kind> {
    let (name, count) = match text.split_once('[') {
        Some((name, count)) => (name, Some(count.strip_suffix(']')?.parse::<usize>().ok()?)),
        None => (text, None),
    };
    let element: &'static Kind = match name {
        "u8" => &Kind::Scalar("u8"),
        "u16" => &Kind::Scalar("u16"),
        "u32" => &Kind::Scalar("u32"),
        "u64" => &Kind::Scalar("u64"),
        "i32" => &Kind::Scalar("i32"),
        "f64" => &Kind::Scalar("f64"),
        _ => return None,
    };
    match count {
        None => Some(*element),
        Some(1..=MAX_OWN_BYTES) => Some(Kind::Array(element, count?)),
        Some(_) => None,
    }
}

#[cfg(test)]
#[expect(unreachable_pub, reason = "the macro declares public structs")]
mod tests {
    use super::*;

    crate::plain_state! {
        /// An inertial sensor.
        pub struct Imu {
            /// Identity and stamps of the sample that this one answers
            pub header: Header,
            /// Yaw rate [rad/s]
            pub yaw_rate_radps: f64,
            /// Temperatures [K]
            pub temperature_k: [f64; 2],
            /// Number of the sensor
            pub sensor: u32,
            /// Unused, zero
            pub reserved: u32,
            /// When the process that published it worked on it
            pub stage: StageStamps,
        }
    }

    const FIELDS: [OwnField<'static>; 4] = [
        OwnField { name: "yaw_rate_radps", kind: "f64", doc: "Yaw rate [rad/s]" },
        OwnField { name: "temperature_k", kind: "f64[2]", doc: "Temperatures [K]" },
        OwnField { name: "sensor", kind: "u32", doc: "Number of the sensor" },
        OwnField { name: "reserved", kind: "u32", doc: "Unused, zero" },
    ];

    #[test]
    fn a_struct_and_a_list_of_fields_make_the_same_type() {
        let (struct_, list) = (OwnType::of::<Imu>().unwrap(), OwnType::new("Imu", &FIELDS).unwrap());
        assert_eq!((struct_.size(), struct_.layout()), (size_of::<Imu>(), list.layout()));
        assert_eq!(struct_.rows("imu"), list.rows("imu"));
        assert_eq!(struct_.numbers(), [288, 296, 304]);
        let other = OwnType::new("Imu", &FIELDS[..2]).unwrap();
        assert_ne!(other.type_name(), list.type_name());
    }

    #[test]
    fn fields_that_make_no_type_are_refused_by_name() {
        let message =
            |name: &str, fields: &[OwnField<'_>]| OwnType::new(name, fields).unwrap_err().to_string();
        let field = |name, kind| OwnField { name, kind, doc: "" };
        assert!(message("Imu", &[field("sensor", "u32"), FIELDS[0]]).starts_with(
            "yaw_rate_radps = a field that begins at byte 292 is not allowed: no hole before a field"
        ));
        assert!(message("Imu", &[FIELDS[2]]).starts_with("stage = "), "the stamps begin at a multiple of 8");
        assert!(message("Imu", &[]).contains("a sample of size 0 says nothing"));
        assert!(message("imu", &FIELDS).starts_with("name = imu is not allowed"));
        assert!(message("Imu", &[field("x", "f32")]).starts_with("x = f32 is not allowed: u8, u16"));
        assert!(message("Imu", &[field("x", "f64[0]")]).starts_with("x = f64[0] is not allowed"));
        assert!(message("Imu", &[field("stage", "f64")]).contains("field.name = stage"));
        assert!(message("Imu", &[FIELDS[0], FIELDS[0]]).contains("each name once"));
        assert!(message("Imu", &[field("x", "f64[4000000]")]).contains("at most 4 MiB"));
        let many = vec![FIELDS[2]; MAX_FIELDS + 1];
        assert!(message("Imu", &many).contains("field = 4097 fields is not allowed: at most 4096 fields"));
    }

    #[test]
    fn a_struct_without_header_or_stamps_is_refused() {
        assert!(OwnType::of::<Header>().unwrap_err().to_string().contains("`header: Header` comes first"));
        assert!(OwnType::of::<crate::Odometry>().unwrap_err().to_string().contains("`stage: StageStamps`"));
        assert!(OwnType::of::<f64>().is_err());
    }
}
