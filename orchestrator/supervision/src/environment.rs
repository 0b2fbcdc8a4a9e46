//! What a process of a run finds in its environment.

use std::ffi::OsString;

use runtime::{
    DIRECTORY_VARIABLE, Domain, INCARNATION_VARIABLE, RESTART_VARIABLE, ROLE_VARIABLE, RUN_ID_VARIABLE,
    STOP_FD_VARIABLE, SYSTEM_ID_VARIABLE, StopWord,
};
use shared_types::Role;

/// The variables by which a process of a role joins its run.
pub fn environment_of(
    domain: &Domain,
    stop_word: &StopWord,
    role: Role,
    incarnation: u32,
    restart: bool,
) -> Vec<(OsString, OsString)> {
    let mut variables = joining(domain, stop_word, incarnation, restart);
    variables.push(variable(ROLE_VARIABLE, role.name()));
    variables
}

/// The variables by which any process joins its run.
pub(crate) fn joining(
    domain: &Domain,
    stop_word: &StopWord,
    incarnation: u32,
    restart: bool,
) -> Vec<(OsString, OsString)> {
    vec![
        variable(SYSTEM_ID_VARIABLE, domain.system_id()),
        variable(RUN_ID_VARIABLE, domain.run_id()),
        (DIRECTORY_VARIABLE.into(), domain.directory().into()),
        variable(INCARNATION_VARIABLE, incarnation),
        variable(RESTART_VARIABLE, u8::from(restart)),
        variable(STOP_FD_VARIABLE, stop_word.descriptor()),
    ]
}

/// One variable.
pub fn variable(name: &str, value: impl ToString) -> (OsString, OsString) {
    (name.into(), value.to_string().into())
}
