//! Names and arguments of the stages that compute nothing: services of the executable `scanloop-lab`, one per role.

use shared_types::Role;

/// Prefix of the names of these services; the role follows, and after a colon the bytes of the payload.
pub const PREFIX: &str = "echo-";

/// Arguments that start the empty stage of a role.
pub fn arguments(role: Role, payload: Option<usize>) -> [String; 2] {
    let bytes = payload.map_or_else(String::new, |bytes| format!(":{bytes}"));
    ["service".to_owned(), format!("{PREFIX}{role}{bytes}")]
}
