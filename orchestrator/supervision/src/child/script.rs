//! Why a file is not executed: what its first bytes are instead of a program or a script.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// The kernel reads so much of a script to find its interpreter [bytes].
const START_BYTES: u64 = 256;

/// Passes when a program is not a script that can't be executed; also when there is no such file.
///
/// # Errors
/// The program, the line, and what is wrong there.
pub fn require_script(program: &Path) -> Result<(), String> {
    let start = start(program);
    let fault = match start.strip_prefix(b"#!") {
        Some(_) => spoilt_first_line(program).or_else(|| missing_interpreter(program)),
        // What else is no text may be a program that the kernel was taught to execute.
        None => (!start.is_empty() && is_text(&start)).then(|| why_not_executed(program)),
    };
    fault.map_or(Ok(()), |fault| Err(format!("command `{}` can't be executed: {fault}", program.display())))
}

fn is_text(start: &[u8]) -> bool {
    let is_cut = |error: std::str::Utf8Error| error.error_len().is_none();
    !start.contains(&0) && std::str::from_utf8(start).map_or_else(is_cut, |_| true)
}

/// What a file is that the kernel does not know how to execute.
pub(super) fn why_not_executed(program: &Path) -> String {
    let start = start(program);
    match start.as_slice() {
        [] => "the file is empty".to_owned(),
        [0xef, 0xbb, 0xbf, ..] => "it begins with a byte order mark; save it as UTF-8 without one".to_owned(),
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] | [b'#', 0, ..] | [0, b'#', ..] => {
            "it is a text in UTF-16; save it as UTF-8".to_owned()
        }
        [0x7f, b'E', b'L', b'F', ..] => "it is a program for another kind of processor".to_owned(),
        text if is_text(text) => {
            "line 1: a script must begin with `#!` and its interpreter, as in `#!/bin/sh`".to_owned()
        }
        _ => "it is neither a program nor a script".to_owned(),
    }
}

/// The interpreter of a script that is there, when the interpreter is not.
pub(super) fn missing_interpreter(program: &Path) -> Option<String> {
    let line = first_line(program)?;
    let interpreter = line.split_whitespace().next().unwrap_or_default();
    let is_missing = !Path::new(interpreter).exists();
    is_missing.then(|| format!("line 1: there is no interpreter `{interpreter}`"))
}

/// A first line that names another interpreter than it seems to: the `\r` before its end belongs to the name.
pub(super) fn spoilt_first_line(program: &Path) -> Option<String> {
    let is_spoilt = first_line(program)?.ends_with('\r');
    let reason = "line 1: it ends with CR LF, so that no interpreter has its name; save the script with LF";
    is_spoilt.then(|| reason.to_owned())
}

/// The first line of a script, without `#!`.
fn first_line(program: &Path) -> Option<String> {
    let start = start(program);
    let line = start.strip_prefix(b"#!")?.split(|byte| *byte == b'\n').next()?;
    Some(String::from_utf8_lossy(line).into_owned())
}

fn start(program: &Path) -> Vec<u8> {
    let mut start = Vec::new();
    // A name without a slash was looked up in PATH, where a file that can't be executed is passed over.
    if let Ok(file) = File::open(program) {
        let _ = file.take(START_BYTES).read_to_end(&mut start);
    }
    start
}
