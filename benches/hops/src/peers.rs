//! Where the programs of the peers are, and which command builds them.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::{Contender, TIDY};

/// The folder of the peers in the source tree.
const FOLDER: &str = "benches/peers";

/// Why a contender can't run on this machine, with the command to fix that.
pub fn missing(contender: Contender) -> Option<String> {
    let name = setup_name(contender)?;
    let built = program(contender).is_some() && (contender != Contender::Dora || dora().is_some());
    (!built).then(|| format!("not built: run {FOLDER}/setup.sh {name}"))
}

/// The program of a peer; `None` when it is not built, or when the contender is in this tree.
pub(crate) fn program(contender: Contender) -> Option<PathBuf> {
    let program = folder()?.join("target/release").join(format!("{}-hop", setup_name(contender)?));
    program.is_file().then_some(program)
}

/// Removes what a chain has left in shared memory. Zenoh's processes remove what belongs to nobody any more; those of
/// a chain end at the same time, and each still sees the others.
pub(crate) fn tidy(contender: Contender) {
    if let (Contender::ZenohShm, Some(program)) = (contender, program(contender)) {
        let _ = Command::new(program)
            .arg(TIDY)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
    }
}

/// dora's own program, which starts the processes of a dataflow.
pub(crate) fn dora() -> Option<PathBuf> {
    let program = folder()?.join("dora/.venv/bin/dora");
    program.is_file().then_some(program)
}

/// What `setup.sh` calls the peer.
fn setup_name(contender: Contender) -> Option<&'static str> {
    match contender {
        Contender::Zenoh | Contender::ZenohShm => Some("zenoh"),
        Contender::Zeromq => Some("zeromq"),
        Contender::Dora => Some("dora"),
        _ => None,
    }
}

/// The folder of the peers, found upwards from the working directory or from the executable.
fn folder() -> Option<PathBuf> {
    let executable = std::env::current_exe().ok();
    let starts =
        [std::env::current_dir().ok(), executable.as_deref().and_then(Path::parent).map(Path::to_owned)];
    starts.into_iter().flatten().find_map(|start| {
        start.ancestors().map(|folder| folder.join(FOLDER)).find(|folder| folder.join("setup.sh").exists())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_in_this_crate_can_always_be_run() {
        for contender in &Contender::ALL[..5] {
            assert_eq!(missing(*contender), None);
        }
    }
}
