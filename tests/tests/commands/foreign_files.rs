//! Files of other editors and other programs: each is read, or named for what it is, and none speaks to the terminal.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs::File;
use std::os::unix::fs::PermissionsExt;

use recording::mcap::{Channel, Schema, Writer};
use scanloop_tests::TestSystem;
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Runs a command; returns its exit code and all that it printed.
fn printed(system: &TestSystem, arguments: &[&str]) -> (i32, String) {
    let output = system.run(arguments);
    let text = [output.stdout, output.stderr].concat();
    (output.status.code().unwrap(), String::from_utf8(text).unwrap())
}

fn refused(system: &TestSystem, arguments: &[&str], names: &[&str]) {
    let (code, text) = printed(system, arguments);
    assert_eq!(code, 2, "{arguments:?}: {text}");
    for name in names {
        assert!(text.contains(name), "{arguments:?}: `{name}` is missing in: {text}");
    }
}

fn utf_16(text: &str, mark: bool) -> Vec<u8> {
    let mark = if mark { "\u{feff}" } else { "" };
    [mark, text].concat().encode_utf16().flat_map(u16::to_le_bytes).collect()
}

#[test]
fn texts_of_other_editors_are_read_or_named_for_what_they_are() {
    let system = TestSystem::new(EXECUTABLE);
    let write = |name: &str, bytes: &[u8]| {
        let path = system.folder().join(name);
        std::fs::write(&path, bytes).unwrap();
        // As an agent wants its file.
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
    };
    let scenario = "name = \"lab\"\ntimeout_s = 20\n";
    let layout = "name = \"Imu\"\n[[field]]\nname = \"rate\"\ntype = \"f64\"\n";
    let files = [
        ("scenario.toml", scenario.to_owned(), &["check", "scenario.toml"][..]),
        ("system.toml", scanloop_tests::system_file(10, &[], "", &[]), &["check", "system.toml"]),
        ("calibration.toml", "schema = 1\n".to_owned(), &["check", "--calibration", "calibration.toml"]),
        ("agent.toml", "name = \"lab\"\n".to_owned(), &["agent", "agent.toml"]),
        ("imu.toml", layout.to_owned(), &["types", "--layout", "imu.toml", "--python"]),
    ];
    for (name, text, arguments) in &files {
        for bytes in [utf_16(text, true), utf_16(text, false)] {
            write(name, &bytes);
            refused(&system, arguments, &[name, "line 1", "UTF-16", "save it as UTF-8"]);
        }
        write(name, &text.replace('\n', "\r").into_bytes());
        refused(&system, arguments, &[name, "line 1", "CR alone"]);
        write(name, &[text.as_bytes(), b"# Gr\xfc\xdfe\n"].concat());
        refused(&system, arguments, &[name, "the byte 0xfc belongs to no text in UTF-8"]);
        for (start, kind) in [
            (&b"\x1f\x8b\x08\0"[..], "packed by gzip"),
            (b"%PDF-1.7\n%\xe2\xe3", "a PDF"),
            (b"{\\rtf1\\ansi", "a document in RTF"),
            (b"<!DOCTYPE html>", "HTML or XML"),
            (b"\x89PNG\r\n\x1a\n\0\0", "a picture, PNG"),
        ] {
            write(name, &[start, text.as_bytes()].concat());
            refused(&system, arguments, &[name, "line 1", &format!("it is {kind}; save it as text")]);
        }
        write(name, &[text.as_bytes(), &[0; 600]].concat());
        refused(&system, arguments, &[name, "line ", "zero bytes at its end, 600 of them"]);
    }
    for (name, text, arguments) in &files[..2] {
        write(name, format!("\u{feff}{}", text.replace('\n', "\r\n")).as_bytes());
        let (code, text) = printed(&system, arguments);
        assert_eq!(code, 0, "{name}: {text}");
    }
    write("scenario.toml", "timeout_s = 20\nname = \u{201c}lab\u{201d}\n".as_bytes());
    refused(
        &system,
        &["check", "scenario.toml"],
        &["scenario.toml", "line 2", "\u{201c} (U+201C), write \""],
    );
    for (text, line, reason) in [
        ("name = \"lab\"\ntimeout_s = 20,5\n", 2, "it has a decimal comma, write 20.5"),
        ("name = \"lab\";\ntimeout_s = 20;\n", 1, "it ends with a semicolon"),
        ("name = \"lab\"\ntimeout\u{200b}_s = 20\n", 2, "a letter that can't be seen (U+200B), remove it"),
        ("name = \"lab\"\n\u{feff}timeout_s = 20\n", 2, "a byte order mark (U+FEFF) within the text"),
        ("name = \"lab\"\r\n# one\rtimeout_s = 20\n", 2, "it ends with CR alone"),
    ] {
        write("scenario.toml", text.as_bytes());
        refused(&system, &["check", "scenario.toml"], &["scenario.toml", &format!("line {line}: "), reason]);
    }
    write("points.csv", b"\x1f\x8b\x08\0");
    for key in ["course.path", "estimator.map"] {
        let path = format!("{key}={}", system.folder().join("points.csv").display());
        refused(&system, &["check", "--set", &path, "corridor"], &["points.csv", key, "packed by gzip"]);
    }
    write("imu.toml", layout.replace("f64", "float").as_bytes());
    refused(&system, &["types", "--layout", "imu.toml"], &["imu.toml: line 4: rate = float is not allowed"]);
    system.assert_nothing_left();
}

#[test]
fn tables_of_spreadsheets_are_named_for_what_they_are() {
    let system = TestSystem::new(EXECUTABLE);
    let write = |bytes: &[u8]| std::fs::write(system.folder().join("runs.csv"), bytes).unwrap();
    let header = "sent_velocity_mps,distance_m,time_s";
    let rows = ["1.0,6.0,8.4", "1.3,6.0,6.5", "0.5,6.0,16.8", "0.7,6.0,12.0", "0.9,6.0,9.3"];
    let table = |header: &str, row: fn(&str) -> String| {
        rows.iter().fold(format!("{header}\n"), |text, line| text + &row(line) + "\n")
    };
    let calibrate = ["calibrate", "velocity", "runs.csv", "--out", "out"];
    let good = table(header, str::to_owned);
    for (text, line, reason) in [
        (
            table(&header.replace(',', ";"), |row| row.replace(',', ";").replace('.', ",")),
            1,
            "separated by semicolons",
        ),
        (table(&header.replace(',', "\t"), |row| row.replace(',', "\t")), 1, "separated by tabs"),
        (table(header, |row| row.replace('.', ",")), 2, "decimal commas"),
        (
            table(header, |row| format!("\"{}\"", row.replace(',', "\",\"").replace('.', ","))),
            2,
            "decimal comma",
        ),
        (table(&format!("{header},,"), |row| format!("{row},,")), 1, "have no name; remove the commas"),
        (table(header, |row| format!("{row},,")), 2, "empty values too many at its end"),
        (format!("{good},,\n"), 7, "it has commas and no value"),
        (format!("sep=,\n{good}"), 1, "`sep=,` is for a spreadsheet only; remove the line"),
        (good.replace("8.4", "8,4"), 2, "4 values under 3 names; if they have decimal commas"),
        (good.replace("0.9,6.0,9.3", "0.9;6.0;9.3"), 6, "separated by semicolons"),
        (good.replace("8.4", "\u{2212}8.4"), 2, "time_s = \u{2212}8.4: it has \u{2212} (U+2212), write -"),
        (good.replace("8.4", "\"1,000.5\""), 2, "it has commas between thousands; write 1000.5"),
        (
            good.replace("8.4", "8.4 s"),
            2,
            "time_s = 8.4 s is not allowed: a number, with a point and without its unit",
        ),
        (
            good.replace("0.5,", "#DIV/0!,"),
            4,
            "sent_velocity_mps = #DIV/0!: a spreadsheet had no result here",
        ),
        (String::new(), 1, "the table is empty"),
        (format!("{header}\n"), 1, "no row follows the header"),
        ("<html><body>runs</body></html>\n".to_owned(), 1, "it is HTML or XML"),
        ("{\"runs\": []}\n".to_owned(), 1, "it is JSON"),
    ] {
        write(text.as_bytes());
        refused(&system, &calibrate, &["runs.csv", &format!("line {line}: "), reason]);
    }
    write(&utf_16(&good, true));
    refused(&system, &calibrate, &["runs.csv", "line 1", "UTF-16"]);
    for text in
        [format!("\u{feff}{}", good.replace('\n', "\r\n")), good.replace('\n', "\r"), format!("{good} \t \n")]
    {
        write(text.as_bytes());
        let (code, text) = printed(&system, &calibrate);
        assert_eq!(code, 0, "{text}");
    }
}

#[test]
fn a_process_that_is_no_program_is_named_for_what_it_is() {
    let system = TestSystem::new(EXECUTABLE);
    let script = system.folder().join("stage");
    let table = scanloop_tests::system_file(10, &[Role::Controller], "./stage", &[]);
    std::fs::write(system.folder().join("system.toml"), table).unwrap();
    for (content, reason) in [
        (&b"import scanloop\n"[..], "line 1: a script must begin with `#!`"),
        (b"#!/usr/bin/env python3\r\nimport scanloop\r\n", "line 1: it ends with CR LF"),
        (b"\xef\xbb\xbf#!/bin/sh\n", "it begins with a byte order mark"),
        (b"import scanloop  # Gr\xfc\xdfe\n", "line 1: a script must begin with `#!`"),
        (b"#!/usr/bin\n", "line 1: the interpreter `/usr/bin` is a directory"),
        (b"#!/etc/passwd\n", "line 1: the interpreter `/etc/passwd` is not executable"),
    ] {
        std::fs::write(&script, content).unwrap();
        std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o755)).unwrap();
        let arguments = ["run", "--lockstep", "--quiet", "--system", "system.toml", "--out", "out", "free"];
        let (code, text) = printed(&system, &arguments);
        assert_eq!(code, 4, "{text}");
        assert!(text.contains("./stage` can't be executed: ") && text.contains(reason), "{text}");
        for command in ["swap", "shadow", "conformance"] {
            refused(&system, &[command, "controller", "--", "./stage"], &["`./stage` can't", reason]);
        }
    }
    system.assert_nothing_left();
}

/// Whether a terminal would do something else than show the text.
fn speaks(text: &str) -> bool {
    let is_seen = |letter: char| letter == '\n' || letter == '\t' || !letter.is_control();
    let turns = |letter: char| matches!(letter, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    !text.chars().all(|letter| is_seen(letter) && !turns(letter))
}

#[test]
fn words_of_foreign_files_do_not_speak_to_the_terminal() {
    let system = TestSystem::new(EXECUTABLE);
    // Clears the screen, sets the title, colours by an 8-bit control, turns the order round, and forges a line.
    let evil = "/\u{1b}[2J\u{1b}]0;owned\u{7}\u{9b}31m\u{202e}\u{2066}\n       99 /scanloop/forged";
    let schema =
        Schema { name: "std_msgs/msg/String".into(), encoding: "ros2msg".into(), text: String::new() };
    let encoding = "cdr".into();
    let channel = Channel { topic: evil.into(), schema: 0, encoding, metadata: Vec::new() };
    let file = File::create(system.folder().join("evil.mcap")).unwrap();
    let mut writer = Writer::new(file, evil, &[schema], &[channel]).unwrap();
    let words = ["version", "run_id", "program", "machine", "lockstep"]
        .map(|key| (key.to_owned(), if key == "version" { "1".to_owned() } else { evil.to_owned() }));
    writer.metadata("recording", &words).unwrap();
    (0..3).for_each(|second| writer.message(0, second, u64::from(second) * 1_000_000_000, &[&[0; 8]]));
    writer.finish().unwrap();

    let (_, text) = printed(&system, &["recording", "info", "evil.mcap"]);
    assert!(!speaks(&text), "{text:?}");
    assert!(
        text.contains("/\\u001b[2J") && !text.lines().any(|line| line.trim() == "99 /scanloop/forged"),
        "{text}"
    );
    // As JSON it is the same word, without a letter that speaks.
    let output = system.run(&["recording", "info", "evil.mcap", "--json"]);
    let json = String::from_utf8(output.stdout).unwrap();
    assert!(!speaks(&json), "{json:?}");
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!(json["channels"].as_object().unwrap().contains_key(evil), "{json}");

    // Names on the command line, values of files, and usage errors.
    let name = "\u{1b}[2J\u{202e}\u{9b}7m.toml";
    std::fs::write(system.folder().join(name), "name = 3\n").unwrap();
    let value = "name = \"a\u{202e}\u{9b}31m\"\nspeed = 1\n";
    std::fs::write(system.folder().join("value.toml"), value).unwrap();
    for arguments in [
        &["check", name][..],
        &["check", "free", name],
        &["run", "--set", name, "free"],
        &["recording", "info", name],
        &["replay", name],
        &["check", "value.toml"],
        &["recording", "export", "evil.mcap", "--rosbag2", "bag"],
        &["calibrate", "velocity", name],
        &[name],
    ] {
        let (_, text) = printed(&system, arguments);
        assert!(!speaks(&text), "{arguments:?}: {text:?}");
    }
}

/// A drive of 1.5 s that version 0.1 recorded; its samples have other layouts.
#[test]
fn a_recording_of_version_0_1_is_replayed_to_the_bit_and_read_by_names() {
    let system = TestSystem::new(EXECUTABLE);
    let drive = concat!(env!("CARGO_MANIFEST_DIR"), "/data/drive-0.1.mcap");
    let output = system.run(&["replay", drive, "--from", "5", "--to", "3"]);
    assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
    let output = system.run(&["replay", drive, "--json"]);
    let (code, text) = (output.status.code().unwrap(), String::from_utf8(output.stdout).unwrap());
    let replayed: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(
        (code, &replayed["skipped"], &replayed["not_replayed"]),
        (0, &0.into(), &serde_json::json!([])),
        "{text}"
    );
    assert!(
        replayed["compared"].as_u64().unwrap() >= 100 && replayed["compared"] == replayed["identical"],
        "{text}"
    );
    let (code, text) = printed(&system, &["recording", "info", drive]);
    assert!(code == 0 && !text.contains("another layout"), "{text}");
    let folder = system.folder().join("tables");
    let (code, text) = printed(&system, &["recording", "export", drive, "--csv", folder.to_str().unwrap()]);
    assert_eq!(code, 0, "{text}");
    let scans = std::fs::read_to_string(folder.join("scan.csv")).unwrap();
    let mut lines = scans.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let names = lines.next().unwrap();
    let first = lines.next().unwrap();
    let of = |name: &str| first[names.iter().position(|found| *found == name).unwrap()];
    let found = ["header.scan_id", "beams", "ranges_mm.0", "ranges_mm.682"].map(of);
    assert_eq!(found, ["1", "682", "4025", "0"]);
}
