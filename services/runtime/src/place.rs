//! Where the directories of this user's systems are: the first place of four that is usable.
//!
//! 1. `SCANLOOP_RUNTIME_DIR`, made when it is missing;
//! 2. `$XDG_RUNTIME_DIR/scanloop`, when that variable names a private directory of this user;
//! 3. `/run/user/UID/scanloop`, likewise;
//! 4. `/tmp/scanloop-UID`.
//!
//! A new system is made in the first usable place. Systems are searched in all of them, because a session of another
//! kind (ssh, cron, a service) has other variables. A place that is not private is never used, searched or changed. One
//! that the user named is refused then.

use std::path::{Path, PathBuf};

use crate::folder::Folder;
use crate::{RUNTIME_DIR_VARIABLE, RuntimeError};

/// Name of the directory for systems within a directory for all programs of a user.
const NAME: &str = "scanloop";

/// A directory that may hold systems.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Place {
    /// This directory itself, which the user named.
    Named(PathBuf),
    /// This directory itself, the last resort.
    Last(PathBuf),
    /// The directory `scanloop` within one that the machine gives to the user.
    Within(PathBuf),
}

impl Place {
    /// The directory that holds the systems; `None` where there is none.
    fn open(&self) -> Result<Option<Folder>, RuntimeError> {
        match self {
            Self::Named(path) | Self::Last(path) => Folder::open(path),
            Self::Within(path) => match Folder::open(path)? {
                Some(parent) => parent.folder(NAME),
                None => Ok(None),
            },
        }
    }

    /// The directory that holds the systems, made when missing; `None` when the machine has no such place.
    fn make(&self) -> Result<Option<Folder>, RuntimeError> {
        loop {
            if let Some(there) = self.open()? {
                return Ok(Some(there));
            }
            let made = match self {
                Self::Named(path) | Self::Last(path) => Folder::make(path),
                Self::Within(path) => match Folder::open(path)? {
                    Some(parent) => parent.make_folder(NAME),
                    None => return Ok(None),
                },
            };
            match made {
                // Another system of this user was faster.
                Err(RuntimeError::File { source, .. })
                    if source.kind() == std::io::ErrorKind::AlreadyExists => {}
                made => return made.map(Some),
            }
        }
    }

    /// Whether `path` is this place, and one that this program makes and removes.
    fn is_default(&self, path: &Path) -> bool {
        match self {
            Self::Named(_) => false,
            Self::Last(own) => own == path,
            Self::Within(parent) => path.strip_prefix(parent).is_ok_and(|name| name == Path::new(NAME)),
        }
    }
}

/// The places, in the order in which they are used.
fn places() -> Result<Vec<Place>, RuntimeError> {
    let variable = |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let user = rustix::process::geteuid().as_raw();
    let mut places = Vec::new();
    if let Some(path) = variable(RUNTIME_DIR_VARIABLE) {
        if !path.is_absolute() {
            return Err(RuntimeError::NotPrivate {
                path,
                reason: format!("is no absolute path ({RUNTIME_DIR_VARIABLE})"),
            });
        }
        places.push(Place::Named(path));
    }
    let given = variable("XDG_RUNTIME_DIR").filter(|path| path.is_absolute());
    for path in given.into_iter().chain([Path::new("/run/user").join(user.to_string())]) {
        let place = Place::Within(path);
        if !places.contains(&place) {
            places.push(place);
        }
    }
    places.push(Place::Last(PathBuf::from(format!("/tmp/scanloop-{user}"))));
    Ok(places)
}

/// The place for a new system.
///
/// # Errors
/// [`RuntimeError::NotPrivate`] when `SCANLOOP_RUNTIME_DIR`, or the last place, can't be used, and errors of the file
/// system.
pub(crate) fn make() -> Result<Folder, RuntimeError> {
    let mut refused = None;
    for place in places()? {
        match place.make() {
            Ok(Some(folder)) => return Ok(folder),
            Ok(None) => {}
            Err(error) if matches!(place, Place::Named(_) | Place::Last(_)) || error.is_shortage() => {
                return Err(error);
            }
            Err(error) => refused = Some(error),
        }
    }
    Err(refused.unwrap_or_else(|| RuntimeError::NotPrivate {
        path: "/tmp".into(),
        reason: "does not exist".to_owned(),
    }))
}

/// All places in which systems may be, default ones that are not private left out.
///
/// # Errors
/// [`RuntimeError::NotPrivate`] when `SCANLOOP_RUNTIME_DIR` can't be used, and [`RuntimeError::File`] when the kernel allows no
/// more open files.
pub(crate) fn all() -> Result<Vec<Folder>, RuntimeError> {
    let mut found = Vec::new();
    for place in places()? {
        match place.open() {
            Err(error) if matches!(place, Place::Named(_)) || error.is_shortage() => return Err(error),
            opened => found.extend(opened.ok().flatten()),
        }
    }
    Ok(found)
}

/// Whether a directory is a place that this program makes, and may remove when it is empty; never one that the user
/// named.
pub(crate) fn is_default(path: &Path) -> bool {
    let places = places().unwrap_or_default();
    !places.iter().any(|place| matches!(place, Place::Named(named) if named == path))
        && places.iter().any(|place| place.is_default(path))
}
