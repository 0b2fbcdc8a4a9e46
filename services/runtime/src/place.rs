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

use rustix::fs::{Access, access};

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

/// The value of a variable that is set and not empty.
fn variable(name: &str) -> Option<PathBuf> {
    std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from)
}

/// The places, in the order in which they are used.
fn places() -> Result<Vec<Place>, RuntimeError> {
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
    places.extend(unnamed_places());
    Ok(places)
}

/// The places that the user does not name.
fn unnamed_places() -> Vec<Place> {
    let user = rustix::process::geteuid().as_raw();
    let mut places = Vec::new();
    let given = variable("XDG_RUNTIME_DIR").filter(|path| path.is_absolute());
    for path in given.into_iter().chain([Path::new("/run/user").join(user.to_string())]) {
        let place = Place::Within(path);
        if !places.contains(&place) {
            places.push(place);
        }
    }
    places.push(Place::Last(PathBuf::from(format!("/tmp/scanloop-{user}"))));
    places
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
            Err(RuntimeError::File { path, source })
                if matches!(place, Place::Named(_)) && source.kind() == std::io::ErrorKind::NotFound =>
            {
                let reason = "can't be made: the folder that it would be in does not exist".to_owned();
                return Err(RuntimeError::NotPrivate { path, reason });
            }
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

/// Passes when a new system can be made in its place, which is neither made nor changed.
///
/// # Errors
/// As [`make`].
pub(crate) fn examine() -> Result<(), RuntimeError> {
    let mut refused = None;
    for place in places()? {
        let (is_chosen, opened) = (matches!(place, Place::Named(_) | Place::Last(_)), place.open());
        // One that is missing is made in the folder around it.
        let folder = match (&place, &opened) {
            (Place::Named(path) | Place::Last(path), Ok(None)) => path.parent().map(Path::to_owned),
            (Place::Within(path), Ok(None)) => Some(path.clone()).filter(|path| path.is_dir()),
            (_, Ok(Some(folder))) => Some(folder.path().to_owned()),
            (_, Err(_)) => None,
        };
        match (opened, folder) {
            (Err(error), _) if is_chosen || error.is_shortage() => return Err(error),
            (Err(error), _) => refused = Some(error),
            (Ok(_), None) => {}
            (Ok(_), Some(folder)) => {
                let rights = Access::WRITE_OK | Access::EXEC_OK;
                return access(&folder, rights).map_err(|error| RuntimeError::file(&folder, error));
            }
        }
    }
    refused.map_or(Ok(()), Err)
}

/// All places in which systems may be, default ones that are not private left out.
///
/// # Errors
/// [`RuntimeError::NotPrivate`] when `SCANLOOP_RUNTIME_DIR` can't be used, and [`RuntimeError::File`] when the kernel allows no
/// more open files.
pub(crate) fn all() -> Result<Vec<Folder>, RuntimeError> {
    let (found, refused) = usable();
    refused.map_or(Ok(found), Err)
}

/// Whether the environment has named this place.
pub(crate) fn is_named(place: &Folder) -> bool {
    variable(RUNTIME_DIR_VARIABLE).is_some_and(|named| named == place.path())
}

/// The places of [`all`] that can be opened, and the first error of another one.
pub(crate) fn usable() -> (Vec<Folder>, Option<RuntimeError>) {
    match places() {
        Ok(places) => open_all(&places),
        Err(error) => (open_all(&unnamed_places()).0, Some(error)),
    }
}

/// Those of the places that can be opened, and the first error of another one that counts.
fn open_all(places: &[Place]) -> (Vec<Folder>, Option<RuntimeError>) {
    let (mut found, mut refused) = (Vec::new(), None);
    for place in places {
        match place.open() {
            Err(error) if matches!(place, Place::Named(_)) || error.is_shortage() => {
                refused.get_or_insert(error);
            }
            opened => found.extend(opened.ok().flatten()),
        }
    }
    (found, refused)
}

/// Whether a directory is a place that this program makes, and may remove when it is empty; never one that the user
/// named.
pub(crate) fn is_default(path: &Path) -> bool {
    let places = places().unwrap_or_default();
    !places.iter().any(|place| matches!(place, Place::Named(named) if named == path))
        && places.iter().any(|place| place.is_default(path))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_named_place_that_is_not_private_hides_no_other_place() {
        let folder = std::env::temp_dir().join(format!("scanloop-places-{}", std::process::id()));
        Folder::make(&folder).unwrap();
        let private = folder.join("private");
        Folder::make(&private).unwrap();
        let open = folder.join("open");
        std::fs::create_dir(&open).unwrap();
        std::fs::set_permissions(&open, PermissionsExt::from_mode(0o755)).unwrap();
        let places = [Place::Named(open), Place::Last(private.clone())];
        let (found, refused) = open_all(&places);
        assert_eq!(found.iter().map(Folder::path).collect::<Vec<_>>(), [private.as_path()]);
        assert!(matches!(refused, Some(RuntimeError::NotPrivate { .. })), "{refused:?}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
