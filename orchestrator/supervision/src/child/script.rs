//! Why a file is not executed: what its first bytes are instead of a program or a script.

use std::path::Path;

use console::user_file::read_start;

/// The kernel reads so much of a script to find its interpreter [bytes].
const START_BYTES: u64 = 256;
/// Header of an ELF file of 64 bits [bytes].
const ELF_HEADER: usize = 64;

/// Passes when a program is not a script that can't be executed; also when there is no such file.
///
/// # Errors
/// The program, the line, and what is wrong there.
pub fn require_script(program: &Path) -> Result<(), String> {
    let start = start(program);
    let fault = match start.strip_prefix(b"#!") {
        Some(_) => spoilt_first_line(program).or_else(|| unusable_interpreter(program)),
        // What else is no text may be a program that the kernel was taught to execute.
        None => (!start.is_empty() && is_text(&start)).then(|| why_not_executed(program)),
    };
    fault.map_or(Ok(()), |fault| Err(format!("command `{}` can't be executed: {fault}", program.display())))
}

/// Whether only a text has such bytes, in UTF-8 or with one byte per letter.
fn is_text(start: &[u8]) -> bool {
    !start.iter().any(|byte| matches!(byte, 0..=0x08 | 0x0b | 0x0e..=0x1a | 0x1c..=0x1f | 0x7f))
}

/// What a file is that the kernel does not know how to execute.
pub(super) fn why_not_executed(program: &Path) -> String {
    let start = start(program);
    match start.as_slice() {
        [] if !has_slash(program) => "what PATH leads to is neither a program nor a script".to_owned(),
        [] => "the file is empty".to_owned(),
        [0xef, 0xbb, 0xbf, ..] => "it begins with a byte order mark; save it as UTF-8 without one".to_owned(),
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] | [b'#', 0, ..] | [0, b'#', ..] => {
            "it is a text in UTF-16; save it as UTF-8".to_owned()
        }
        [0x7f, b'E', b'L', b'F', ..] if is_of_this_machine(&start) => {
            "it is a program of which a part is missing or damaged; copy or build it again".to_owned()
        }
        [0x7f, b'E', b'L', b'F', ..] => "it is a program for another kind of processor".to_owned(),
        [b'P', b'K', 3, 4, ..] => "it is a ZIP archive; unpack it".to_owned(),
        [b'#', b'!', ..] => unusable_interpreter(program).unwrap_or_else(|| {
            let interpreter = interpreter(program).unwrap_or_default();
            // An interpreter is not searched in PATH.
            let fault = why_not_executed_unless_script(&Path::new(".").join(&interpreter));
            format!("line 1: the interpreter `{interpreter}` can't be executed: {fault}")
        }),
        text if is_text(text) => {
            "line 1: a script must begin with `#!` and its interpreter, as in `#!/bin/sh`".to_owned()
        }
        _ => "it is neither a program nor a script".to_owned(),
    }
}

/// The same for an interpreter; one that is a script itself is not followed further.
fn why_not_executed_unless_script(interpreter: &Path) -> String {
    match start(interpreter).starts_with(b"#!") {
        true => "it is a script".to_owned(),
        false => why_not_executed(interpreter),
    }
}

/// Whether the header of an ELF file is cut off, or names the processor of this program.
fn is_of_this_machine(start: &[u8]) -> bool {
    /// Class and byte order, and the kind of processor behind them.
    const PLACES: [std::ops::Range<usize>; 2] = [4..6, 18..20];
    let own = self::start(Path::new("/proc/self/exe"));
    let is_cut = start.len() < ELF_HEADER || own.len() < ELF_HEADER;
    is_cut || PLACES.into_iter().all(|place| start[place.clone()] == own[place])
}

/// What is wrong with the interpreter of a script that is there.
pub(super) fn unusable_interpreter(program: &Path) -> Option<String> {
    let interpreter = interpreter(program)?;
    let path = Path::new(&interpreter);
    let fault = match std::fs::metadata(path) {
        _ if interpreter.is_empty() => return Some("line 1: no interpreter follows `#!`".to_owned()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Some(format!("line 1: there is no interpreter `{interpreter}`"));
        }
        Err(error) => error.to_string(),
        Ok(found) if found.is_dir() => "is a directory".to_owned(),
        Ok(_) if !is_executable(path) => "is not executable".to_owned(),
        Ok(_) => return None,
    };
    Some(format!("line 1: the interpreter `{interpreter}` {fault}"))
}

/// Whether this user may execute a file.
pub(super) fn is_executable(path: &Path) -> bool {
    rustix::fs::access(path, rustix::fs::Access::EXEC_OK).is_ok()
}

/// The interpreter that the first line of a script names; empty where none follows.
fn interpreter(program: &Path) -> Option<String> {
    Some(first_line(program)?.split_whitespace().next().unwrap_or_default().to_owned())
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

/// The first bytes of a program; none of what is no regular file.
fn start(program: &Path) -> Vec<u8> {
    // A name without a slash is searched in PATH: a file of that name in the working folder is another one.
    if !has_slash(program) {
        return Vec::new();
    }
    read_start(program, START_BYTES).unwrap_or_default()
}

fn has_slash(program: &Path) -> bool {
    program.as_os_str().as_encoded_bytes().contains(&b'/')
}
