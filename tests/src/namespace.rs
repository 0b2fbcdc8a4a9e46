//! Tests with file systems of their own: they start themselves again in a mount namespace.

use std::process::{Command, Stdio};

/// Variable that is set for a test in its namespace.
const INSIDE: &str = "SCANLOOP_TEST_INSIDE";
/// Where the test and the executable are in a namespace of [`is_among_users`].
const PROGRAMS: &str = "/mnt";

/// Whether this is `test`, as `module_path!()::name`, in a mount namespace of its own. If not, it is started there,
/// after the commands of `script`, each ending with `&&`; its result is that of this test. Prints a note where
/// mounting is not permitted.
pub fn is_inside(test: &str, script: &str, configure: impl FnOnce(&mut Command)) -> bool {
    // The test harness leaves out the name of the crate.
    let test = test.split_once("::").map_or(test, |(_, name)| name);
    if std::env::var(INSIDE).is_ok_and(|inside| inside == test) {
        return true;
    }
    if !Command::new("unshare").args(["-m", "true"]).status().is_ok_and(|status| status.success()) {
        eprintln!("skipped {test}: mounting is not permitted");
        return false;
    }
    let mut command = Command::new("unshare");
    command.args(["-m", "sh", "-c", &format!("{script} exec \"$0\" \"$@\"")]);
    command.arg(std::env::current_exe().expect("this test")).args(["--exact", test, "--nocapture"]);
    command.env(INSIDE, test);
    configure(&mut command);
    let output = command.stderr(Stdio::inherit()).output().expect("unshare runs");
    let printed = String::from_utf8_lossy(&output.stdout);
    // A name that no test has is no error of the harness.
    assert!(output.status.success() && printed.contains("1 passed"), "{test}: {}: {printed}", output.status);
    false
}

/// [`is_inside`] with an empty `/tmp`, `/dev/shm` and `/run/user`, where all users may do what they may on any
/// machine, and the executable at [`executable_for_all`]. Prints a note where the test does not run as root.
pub fn is_among_users(test: &str, executable: &str) -> bool {
    if !rustix::process::geteuid().is_root() {
        eprintln!("skipped {test}: only root can act as another user");
        return false;
    }
    let script = format!(
        "mount -t tmpfs -o mode=0755 tmpfs {PROGRAMS} && touch {PROGRAMS}/test {PROGRAMS}/scanloop && \
         mount --bind \"$0\" {PROGRAMS}/test && mount --bind '{executable}' {PROGRAMS}/scanloop && \
         mount -t tmpfs -o mode=1777 tmpfs /tmp && mount -t tmpfs -o mode=1777 tmpfs /dev/shm && \
         if [ -d /run/user ]; then mount -t tmpfs -o mode=0755 tmpfs /run/user; fi && set -- {PROGRAMS}/test \"$@\" && \
         cd / && umask 022 && exec \"$@\" &&"
    );
    is_inside(test, &script, |command| {
        command.env_remove(runtime::RUNTIME_DIR_VARIABLE).env_remove("XDG_RUNTIME_DIR").env_remove("TMPDIR");
    })
}

/// The executable under test in a namespace of [`is_among_users`]: other users may run it, wherever it was built.
pub fn executable_for_all() -> String {
    format!("{PROGRAMS}/scanloop")
}

/// Ends a test here unless it runs in a namespace of [`is_among_users`].
#[macro_export]
macro_rules! among_users {
    ($test:expr) => {
        if !$crate::namespace::is_among_users(
            concat!(module_path!(), "::", $test),
            env!("CARGO_BIN_EXE_scanloop-under-test"),
        ) {
            return;
        }
    };
}
