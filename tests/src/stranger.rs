//! Another local user, who tries all that the kernel permits.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use rustix::process::{Gid, Pid, Signal, Uid, kill_process};
use rustix::thread::{set_thread_groups, set_thread_res_gid, set_thread_res_uid};

use crate::TestSystem;
use crate::namespace::executable_for_all;

/// Number of the other user and of its group.
pub const STRANGER: u32 = 65_534;
/// Default place of the systems of root.
pub const PLACE: &str = "/tmp/scanloop-0";
/// Default place of the systems of the other user.
pub const PLACE_OF_STRANGER: &str = "/tmp/scanloop-65534";
/// A folder of the other user, in a namespace of [`crate::namespace::is_among_users`].
pub const HOME: &str = "/tmp/stranger";

/// Does something with the rights of the other user alone, on a thread that has them.
pub fn as_stranger<T: Send>(act: impl FnOnce() -> T + Send) -> T {
    std::thread::scope(|scope| {
        let thread = scope.spawn(|| {
            let (uid, gid) = (Uid::from_raw(STRANGER), Gid::from_raw(STRANGER));
            set_thread_groups(&[]).expect("the test is root's");
            set_thread_res_gid(gid, gid, gid).expect("the test is root's");
            set_thread_res_uid(uid, uid, uid).expect("the test is root's");
            act()
        });
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

/// A system of root.
pub fn system() -> TestSystem {
    TestSystem::new(&executable_for_all())
}

/// A command of the other user for a system of that id.
pub fn of_stranger(id: &str, arguments: &[&str]) -> Command {
    let mut command = Command::new(executable_for_all());
    let _ = as_stranger(|| std::fs::create_dir(HOME));
    command.args(["--system-id", id]).args(arguments).current_dir(HOME).uid(STRANGER).gid(STRANGER);
    command
}

/// What a command wrote.
pub fn text(output: &Output) -> String {
    crate::printed(output)
}

/// Asserts that a command was refused (exit code 2) with a message that has all these parts.
pub fn assert_refused(output: &Output, parts: &[&str]) {
    let text = text(output);
    assert_eq!(output.status.code(), Some(2), "{text}");
    for part in parts {
        assert!(text.contains(part), "no `{part}` in: {text}");
    }
}

/// Makes a directory with that mode, whatever the umask.
pub fn make_folder(path: impl AsRef<Path>, mode: u32) {
    std::fs::create_dir(&path).expect("a new folder");
    std::fs::set_permissions(path, Permissions::from_mode(mode)).expect("a folder of ours");
}

/// Whether the system drives.
pub fn is_driving(system: &TestSystem) -> bool {
    system.status().is_some_and(|status| status.state == "driving")
}

/// Names in shared memory.
pub fn shared_memory() -> impl Iterator<Item = String> {
    let entries = std::fs::read_dir("/dev/shm").expect("shared memory").flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned())
}

/// Kills processes, except those that have already ended.
pub fn kill(processes: &[i32]) {
    for pid in processes.iter().filter_map(|pid| Pid::from_raw(*pid)) {
        let _ = kill_process(pid, Signal::KILL);
    }
}

/// All files and directories below a path, itself included; entries of a directory that may not be read are not.
pub fn tree(path: &Path) -> Vec<PathBuf> {
    let mut found = vec![path.to_path_buf()];
    let is_folder = path.symlink_metadata().is_ok_and(|found| found.is_dir());
    if is_folder && let Ok(entries) = std::fs::read_dir(path) {
        found.extend(entries.flatten().flat_map(|entry| tree(&entry.path())));
    }
    found
}
