//! The layouts of a system in a file, so that a process built against others is refused before it joins.

use shared_types::{Layouts, NotALayout, Role, difference, topics_of};

use crate::{Domain, OwnTopics, RuntimeError};

/// Name of the file in the directory of the system.
pub const LAYOUTS_FILE: &str = "layouts.txt";

/// Compares the layouts that a process of `role` was built with to those of the system that started it.
///
/// [`crate::Process::attach`] does this with the layouts of this crate. A library for another language also does it
/// with those of the program that uses it.
///
/// # Errors
/// [`RuntimeError::Layout`] with the first field that differs, [`RuntimeError::NotInASystem`], and
/// [`RuntimeError::File`] or [`RuntimeError::Settings`] when the system's layouts can't be read.
pub fn verify_layouts(role: Role, mine: &Layouts) -> Result<(), RuntimeError> {
    verify(&Domain::of_this_process()?, role, mine)
}

pub(crate) fn verify(domain: &Domain, role: Role, mine: &Layouts) -> Result<(), RuntimeError> {
    let text = domain.folder().read_text(LAYOUTS_FILE)?;
    let theirs: Layouts = text
        .parse()
        .map_err(|error: NotALayout| RuntimeError::settings(domain.directory().join(LAYOUTS_FILE), error))?;
    difference(mine, &theirs, topics_of(role)).map_or(Ok(()), |found| Err(RuntimeError::Layout(found)))
}

/// Compares the layouts of a running system to those of this build: the orchestrator, when it adopts.
pub(crate) fn verify_all(domain: &Domain) -> Result<(), RuntimeError> {
    Role::ALL.iter().try_for_each(|role| verify(domain, *role, &Layouts::built_in()))
}

/// Writes the layouts of the system: the orchestrator, when it creates the bus.
pub(crate) fn write(domain: &Domain) -> Result<(), RuntimeError> {
    let mut layouts = Layouts::built_in();
    layouts.rows.extend(OwnTopics::of(domain)?.map_or_else(Vec::new, |table| table.rows()));
    domain.folder().write(LAYOUTS_FILE, layouts.to_string().as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::Deviation;

    #[test]
    fn a_process_of_another_version_is_refused_where_it_uses_what_differs() {
        let domain = Domain::create(&format!("l{}", std::process::id())).unwrap();
        assert!(matches!(verify(&domain, Role::Robot, &Layouts::built_in()), Err(RuntimeError::File { .. })));
        write(&domain).unwrap();
        let mut mine = Layouts::built_in();
        assert!(verify(&domain, Role::Estimator, &mine).is_ok());
        let row = mine.rows.iter_mut().find(|row| row.topic == "pose" && row.field == "nis").unwrap();
        row.offset += 8;
        let Err(RuntimeError::Layout(found)) = verify(&domain, Role::Estimator, &mine) else {
            panic!("not refused")
        };
        assert_eq!((found.topic.as_str(), found.field.as_str()), ("pose", "nis"));
        assert!(matches!(found.what, Deviation::Offset(_)));
        assert!(verify(&domain, Role::Robot, &mine).is_ok(), "the robot does not use it");
        domain.folder().write(LAYOUTS_FILE, b"nonsense").unwrap();
        assert!(matches!(verify(&domain, Role::Robot, &mine), Err(RuntimeError::Settings { .. })));
        domain.remove().unwrap();
    }
}
