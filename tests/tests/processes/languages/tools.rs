//! Compilers and interpreters of this machine.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

pub(crate) const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
/// The examples in Rust.
pub(crate) const DEAD_RECKONING: &str = env!("CARGO_BIN_EXE_dead-reckoning-under-test");
pub(crate) const MY_ROBOT: &str = env!("CARGO_BIN_EXE_my-robot-under-test");
pub(crate) const MY_CONTROLLER: &str = env!("CARGO_BIN_EXE_my-controller-under-test");

/// Root of the repository.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_path_buf()
}

/// Folder of the examples.
pub(crate) fn examples(language: &str) -> PathBuf {
    root().join("examples").join(language)
}

/// Where cargo has put the executables of this profile.
fn profile_folder() -> &'static Path {
    Path::new(EXECUTABLE).parent().unwrap()
}

/// Compiles a C program with the header in `types` and links it with the C library.
pub(crate) fn compile(source: &Path, types: &Path, program: &Path) {
    // The tests depend on the library, so cargo has built it with their other dependencies.
    let library = profile_folder().join("deps");
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    let output = Command::new(compiler)
        .args(["-O1", "-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic"])
        .arg(source)
        .args(["-I".as_ref(), types.as_os_str(), "-I".as_ref()])
        .arg(root().join("services/c-library/include"))
        .args(["-L".as_ref(), library.as_os_str()])
        // Old tags go before the library path that cargo sets, where an older build of the library may lie.
        .arg(format!("-Wl,--disable-new-dtags,-rpath,{}", library.display()))
        .args(["-lscanloop", "-lm", "-o"])
        .arg(program)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// The interpreter with the packages of the examples; `None`, with a printed note, when they can't be installed.
pub(crate) fn python(skipped: &str) -> Option<PathBuf> {
    static FOLDER: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        let folder = profile_folder().parent().unwrap().join("python");
        let output = Command::new(examples("python").join("setup.sh"))
            .arg(&folder)
            .output()
            .map_err(|error| error.to_string())?;
        if output.status.success() {
            Ok(folder)
        } else {
            Err(String::from_utf8_lossy(&output.stderr).into_owned())
        }
    });
    match folder {
        Ok(folder) => Some(folder.join("bin/python")),
        Err(error) => {
            let printed = format!("SKIPPED {skipped}: the Python packages could not be installed: {error}\n");
            assert!(std::env::var("CI").as_deref() != Ok("true"), "{printed}");
            // Past the capture of the test harness, which shows nothing of a test that passes.
            let _ = std::io::stderr().lock().write_all(printed.as_bytes());
            None
        }
    }
}
