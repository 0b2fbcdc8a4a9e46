//! Words that certain code does not contain.

use std::path::{Path, PathBuf};

use crate::{files, root};

/// All Rust sources below a folder, without build output.
fn sources(folder: &Path) -> Vec<PathBuf> {
    files(folder, ".rs")
}

fn within(path: &Path, folders: &[&str]) -> bool {
    folders.iter().any(|folder| path.starts_with(root().join(folder)))
}

#[test]
fn only_the_runtime_knows_the_bus() {
    for path in sources(&root()) {
        let text = std::fs::read_to_string(&path).unwrap();
        let uses = text.lines().any(|line| line.trim_start().starts_with("use iceoryx2"));
        assert!(!uses || within(&path, &["services/runtime", "benches"]), "{}", path.display());
    }
}

#[test]
fn unsafe_code_stays_in_the_runtime_the_c_library_and_the_benches() {
    for path in sources(&root()) {
        let text = std::fs::read_to_string(&path).unwrap();
        let uses = text.lines().any(|line| {
            let code = line.split("//").next().unwrap_or_default();
            code.contains("unsafe {") || code.contains("unsafe fn") || code.contains("unsafe impl")
        });
        let allowed = ["services/runtime", "services/c-library", "benches", "tests/architecture/tests"];
        let allowed = within(&path, &allowed);
        assert!(!uses || allowed, "{}", path.display());
    }
}

#[test]
fn algorithms_read_no_clock_and_no_file() {
    let is_process = |path: &Path| path.ends_with("service.rs");
    // The connection of a driver: sockets, timeouts, and the process of its guard.
    let is_connection = |path: &Path| {
        let parts = [
            "driver/src/feed.rs",
            "driver/src/guard/held.rs",
            "driver/src/guard/process.rs",
            "driver/src/scanner.rs",
            "player/src/client",
            "player/src/client.rs",
            "ros2/src/command.rs",
            "ros2/src/connection.rs",
            "ros2/src/guard.rs",
            "ros2/src/imu.rs",
            "ros2/src/listener.rs",
            "ros2/src/node.rs",
            "ros2/src/robot.rs",
            "ros2/src/teleop.rs",
            "ros2/src/view.rs",
        ];
        parts.iter().any(|part| path.starts_with(root().join("services").join(part)))
    };
    // The ends of the link between hosts, and programs that measure it; what they decide by is pure.
    let is_link = |path: &Path| {
        let parts = [
            "bridge.rs",
            "control.rs",
            "credentials.rs",
            "inbox.rs",
            "link.rs",
            "listener.rs",
            "ping.rs",
            "receiver.rs",
            "refusals.rs",
            "sender.rs",
            "threads.rs",
        ];
        parts.iter().any(|part| *path == root().join("services/link/src").join(part))
            || path.starts_with(root().join("services/link/examples"))
    };
    let of_connections = ["std::time::", "Instant::now", "monotonic_ns"];
    for path in sources(&root().join("services")) {
        let not_pure = ["services/runtime", "services/c-library"];
        let of_a_build = path.ends_with("build.rs");
        if of_a_build || within(&path, &not_pure) || path.components().any(|part| part.as_os_str() == "tests")
        {
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        // Tests stand at the end of a file, or in a file of their own.
        let text = text.split("#[cfg(test)]").next().unwrap_or_default();
        for word in ["std::time::", "Instant::now", "SystemTime", "std::fs::", "monotonic_ns", "HashMap"] {
            let allowed = is_process(&path) && word == "monotonic_ns"
                || is_connection(&path) && of_connections.contains(&word)
                || is_link(&path) && word != "HashMap" && word != "SystemTime"
                || path.ends_with("tests.rs");
            assert!(!text.contains(word) || allowed, "{}: {word}", path.display());
        }
    }
}

#[test]
fn the_wall_clock_is_never_read() {
    for path in sources(&root()) {
        let text = std::fs::read_to_string(&path).unwrap();
        let uses = text.contains("SystemTime::now") || text.contains("ClockId::Realtime");
        assert!(!uses || path.ends_with("rules/code.rs"), "{}", path.display());
    }
}

#[test]
fn process_tests_wait_on_conditions_and_never_sleep() {
    for path in sources(&root().join("tests")) {
        let text = std::fs::read_to_string(&path).unwrap();
        let sleeps = text.contains("thread::sleep");
        assert!(!sleeps || path.ends_with("rules/code.rs"), "{}", path.display());
    }
}

#[test]
fn the_product_knows_nothing_of_the_laboratory() {
    let manifests =
        ["shared-types", "services", "orchestrator"].map(|folder| files(&root().join(folder), "Cargo.toml"));
    for path in manifests.into_iter().flatten() {
        let text = std::fs::read_to_string(&path).unwrap();
        for name in ["hops", "fault-matrix", "scanloop-lab", "criterion"] {
            assert!(!text.lines().any(|line| line.starts_with(name)), "{}: {name}", path.display());
        }
    }
    for path in sources(&root()) {
        let text = std::fs::read_to_string(&path).unwrap();
        let allocates = text.lines().any(|line| line.trim_start().starts_with("#[global_allocator]"));
        assert!(!allocates || within(&path, &["benches"]), "{}", path.display());
    }
}

/// They panic when standard error has no reader any more, and wait for one that does not read.
#[test]
fn the_orchestrator_prints_without_panic_and_wait() {
    let of_a_build = |path: &PathBuf| path.ends_with("build.rs");
    for path in sources(&root().join("orchestrator")).into_iter().filter(|path| !of_a_build(path)) {
        let text = std::fs::read_to_string(&path).unwrap();
        for word in ["print!(", "println!(", "stderr().lock", "dbg!("] {
            assert!(!text.contains(word), "{}: {word}", path.display());
        }
    }
}

/// `console::new_file` syncs files before they have a name, and follows no link; other ways do not.
#[test]
fn files_of_users_are_made_in_one_place() {
    const OTHERS: [(&str, &str); 15] = [
        ("orchestrator/console/src/new_file.rs", "the place itself, and the opening of logs"),
        ("orchestrator/console/src/new_file", "how a file gets its name, and devices"),
        ("orchestrator/console/src/out_folder.rs", "its list grows, opened as a log is"),
        ("orchestrator/console/src/user_file.rs", "reads"),
        ("orchestrator/supervision/src/child_log.rs", "a log, opened by `new_file`"),
        ("orchestrator/session/src/run_recorder.rs", "a log, opened by `new_file`"),
        ("orchestrator/supervision/src/realtime.rs", "a device of the kernel"),
        ("orchestrator/scanloop/src/demo/system.rs", "outputs of processes in a private folder"),
        ("benches/src/faults/system.rs", "outputs of processes in a private folder"),
        ("orchestrator/scanloop/src/inject/act.rs", "fills shared memory, made with O_EXCL"),
        ("services/runtime/src", "private folders of running systems, used by descriptor"),
        ("services/faults/build.rs", "built, not run"),
        ("benches/hops/src/driver.rs", "outputs of processes in a private folder"),
        ("benches/hops/src/wiring.rs", "a private folder"),
        ("services/link/src/credentials.rs", "private folders, by `runtime::Folder`"),
    ];
    let words = ["File::create", "fs::write(", "OpenOptions", "File::options", "fs::rename(", "fs::copy("];
    let others = OTHERS.map(|(path, _)| path);
    for path in
        ["orchestrator", "services", "benches"].iter().flat_map(|folder| sources(&root().join(folder)))
    {
        let is_test = path.ends_with("tests.rs")
            || path
                .components()
                .any(|part| ["tests", "examples", "peers"].iter().any(|name| part.as_os_str() == *name));
        if is_test || within(&path, &others) {
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let text = text.split("#[cfg(test)]").next().unwrap_or_default().replace("NewFile::create", "");
        for word in words {
            assert!(!text.contains(word), "{}: {word}: use console::new_file", path.display());
        }
    }
    for path in others {
        assert!(root().join(path).exists(), "{path} is not there");
    }
}

/// `console::user_file` waits for no writer of a pipe, and refuses what has no end.
#[test]
fn files_of_users_are_opened_in_one_place() {
    let others = [
        // Whether files can be opened at all.
        "orchestrator/console/src/limits.rs",
        // Folders.
        "orchestrator/console/src/out_folder.rs",
        // Logs of a running system.
        "orchestrator/recording/src/recorder/logs.rs",
        // Regular ones only; it knows nothing of the console.
        "orchestrator/supervision/src/replaceable.rs",
    ];
    for folder in ["orchestrator", "benches"] {
        for path in sources(&root().join(folder)).into_iter().filter(|path| !within(path, &others)) {
            let text = std::fs::read_to_string(&path).unwrap();
            let text = text.split("#[cfg(test)]").next().unwrap_or_default();
            assert!(!text.contains("File::open("), "{}: use console::user_file", path.display());
        }
    }
}

/// `console::output::data` filters what a terminal would obey, and ends no command when the reader has gone.
#[test]
fn standard_output_is_written_in_one_place() {
    let others = [
        "orchestrator/console/src/output.rs",
        // Tells whether a path leads to the output itself.
        "orchestrator/console/src/new_file/device.rs",
        // Messages to the orchestrator, through a pipe.
        "orchestrator/recording/src/recorder/orchestrator.rs",
        // Asks for the size of the terminal.
        "orchestrator/scanloop/src/urg/plot.rs",
    ];
    for folder in ["orchestrator", "benches/src"] {
        for path in sources(&root().join(folder)).into_iter().filter(|path| !within(path, &others)) {
            let text = std::fs::read_to_string(&path).unwrap();
            assert!(!text.contains("stdout()"), "{}: use console::output", path.display());
        }
    }
}
