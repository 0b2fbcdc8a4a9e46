//! The live page over runs that begin, are disturbed, end and begin again; and in a browser where there is one.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::Mutex;

use rustix::process::{Pid, Signal, kill_process};
use scanloop_tests::{DEADLINE, SHORT_CORRIDOR, TestSystem};
use serde_json::Value;
use shared_types::Role;

use crate::recording::recorded;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// A page that is served; it ends with the value.
pub(crate) struct View {
    process: Child,
    pub(crate) address: String,
    pub(crate) token: String,
}

impl View {
    pub(crate) fn start(system: &TestSystem, options: &[&str]) -> Self {
        Self::of(system.command(&[&["view", "--port", "0"], options].concat()))
    }

    fn of(mut command: Command) -> Self {
        let mut process = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut link = String::new();
        BufReader::new(process.stdout.as_mut().unwrap()).read_line(&mut link).unwrap();
        let (address, token) = of_link(&link);
        Self { process, address, token }
    }

    pub(crate) fn ask(&self, request: &str, headers: &str, body: &str) -> (u16, String) {
        ask(&self.address, request, headers, body)
    }

    fn json(&self, path: &str) -> Value {
        let (code, text) = self.ask(&format!("GET {path}"), "", "");
        assert_eq!(code, 200, "{path}: {text}");
        serde_json::from_str(&text).unwrap()
    }

    fn system(&self) -> Value {
        self.json("/system")
    }

    pub(crate) fn wait_for(
        &self,
        system: &TestSystem,
        what: &str,
        condition: impl Fn(&Value) -> bool,
    ) -> Value {
        system.wait_until(what, |_| condition(&self.system()));
        self.system()
    }

    /// The texts of all events so far.
    fn events(&self) -> Vec<String> {
        let history = self.json("/history");
        let texts = history["events"].as_array().unwrap().iter();
        texts.map(|event| event["text"].as_str().unwrap().to_owned()).collect()
    }

    fn act(&self, body: &str, with_token: bool) -> (u16, String) {
        let headers =
            if with_token { format!("Authorization: Bearer {}\r\n", self.token) } else { String::new() };
        self.ask("POST /control", &headers, body)
    }

    pub(crate) fn end(mut self) -> (ExitStatus, String) {
        kill_process(Pid::from_child(&self.process), Signal::TERM).unwrap();
        let mut log = String::new();
        self.process.stderr.take().unwrap().read_to_string(&mut log).unwrap();
        (self.process.wait().unwrap(), log)
    }
}

impl Drop for View {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Address and token of a printed link.
fn of_link(link: &str) -> (String, String) {
    let rest = link.trim().split_once("http://").expect(link).1;
    let (address, token) = rest.split_once("/#token=").expect(link);
    (address.to_owned(), token.to_owned())
}

/// Status and content of an answer.
fn ask(address: &str, request: &str, headers: &str, body: &str) -> (u16, String) {
    let length = body.len();
    let head = format!("{request} HTTP/1.1\r\nHost: {address}\r\nContent-Length: {length}\r\n{headers}\r\n");
    raw(address, &format!("{head}{body}"))
}

/// The same of a request that is written whole.
pub(crate) fn raw(address: &str, request: &str) -> (u16, String) {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(DEADLINE)).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    let (head, content) = text.split_once("\r\n\r\n").unwrap();
    (head.split(' ').nth(1).unwrap().parse().unwrap(), content.to_owned())
}

/// The next frames of the stream.
fn frames(address: &str, count: usize) -> Vec<Value> {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(DEADLINE)).unwrap();
    write!(stream, "GET /stream HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
    let (mut found, mut is_frame) = (Vec::new(), false);
    for line in BufReader::new(stream).lines() {
        match line.unwrap().split_once(": ") {
            Some(("event", name)) => is_frame = name == "frame",
            Some(("data", data)) if is_frame => found.push(serde_json::from_str(data).unwrap()),
            _ => {}
        }
        if found.len() == count {
            break;
        }
    }
    found
}

/// Role, implementation, process and restarts of all processes in a status.
fn rows(status: &Value) -> Vec<[Value; 4]> {
    let keys = ["role", "implementation", "pid", "restarts"];
    status["processes"].as_array().unwrap().iter().map(|row| keys.map(|key| row[key].clone())).collect()
}

pub(crate) fn is_driving(system: &Value) -> bool {
    let has_scans = system["status"]["scan"].as_u64().is_some_and(|scan| scan > 3);
    system["connection"] == "live" && system["status"]["state"] == "driving" && has_scans
}

#[test]
fn the_page_shows_what_status_prints_and_survives_deaths_and_the_end_of_a_run() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let view = View::start(&system, &["--control"]);
        view.wait_for(&system, "the page waits", |shown| shown["connection"] == "waiting");

        system.start(&["endless"]);
        let shown = view.wait_for(&system, "the page shows the drive", is_driving);
        let printed: Value = serde_json::from_slice(&system.run(&["status", "--json"]).stdout).unwrap();
        assert_eq!(rows(&shown["status"]), rows(&printed));
        assert_eq!(
            (&shown["status"]["scenario"], &shown["system_id"]),
            (&printed["scenario"], &printed["system_id"])
        );
        assert_eq!(shown["course"]["body"]["length_m"], 0.56, "{shown}");

        // Ten frames take about a second, so the newest scan is at least the one that `status` had before.
        let seen = frames(&view.address, 10);
        let scans: Vec<u64> = seen.iter().map(|frame| frame["row"]["scan_id"].as_u64().unwrap()).collect();
        assert!(
            scans.is_sorted() && *scans.last().unwrap() >= printed["scan"].as_u64().unwrap(),
            "{scans:?}"
        );
        let last = seen.last().unwrap();
        assert!(
            ["scan", "pose", "truth", "command", "actuation"].iter().all(|part| last[part].is_object()),
            "{last}"
        );
        let number = seen[3]["row"]["number"].as_u64().unwrap();
        assert_eq!(view.json(&format!("/frame?number={number}")), seen[3], "an earlier frame is still there");

        system.signal(system.pid(Role::Estimator), Signal::KILL);
        system.wait_until("the restart is an event", |_| {
            view.events().iter().any(|text| text.contains("estimator restarted"))
        });
        let shown = view.wait_for(&system, "the new process is shown", |shown| {
            shown["status"]["processes"][1]["state"] == "ready"
                && shown["status"]["processes"][1]["restarts"] == 1
        });
        assert_eq!(shown["status"]["processes"][1]["pid"], system.pid(Role::Estimator));

        assert_eq!(
            view.act(r#"{"action":"stop"}"#, false).0,
            403,
            "the token is needed even for the same user"
        );
        let (code, refused) = view.act(r#"{"action":"restart","role":"robot"}"#, true);
        let refused: Value = serde_json::from_str(&refused).unwrap();
        assert_eq!(code, 200);
        assert!(refused["messages"].as_str().unwrap().contains("the robot is not restarted"), "{refused}");
        let (code, stopped) = view.act(r#"{"action":"stop"}"#, true);
        assert_eq!(
            (code, &serde_json::from_str::<Value>(&stopped).unwrap()["exit_code"]),
            (200, &0.into()),
            "{stopped}"
        );
        system.wait();
        let over = view
            .wait_for(&system, "the page knows that the run is over", |shown| shown["connection"] == "over");
        assert!(over["run_id"].is_null());
        assert_eq!(system.report().scans.unaccounted, 0);

        system.start(&["endless"]);
        view.wait_for(&system, "the page shows the next run", is_driving);
        let (ended, log) = view.end();
        assert_eq!(ended.code(), Some(0));
        assert_eq!(log.matches("its token is missing").count(), 1, "logged once: {log}");
        system.signal(system.orchestrator(), Signal::INT);
        system.wait();
        assert_eq!(system.report().scans.unaccounted, 0);
        system.assert_nothing_left();
    });
}

#[test]
fn a_page_whose_program_was_removed_still_acts() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let program = system.executable_alone("scanloop");
        let mut command = Command::new(&program);
        command.args(["--system-id", system.id(), "view", "--port", "0", "--control"]);
        let view = View::of(command);
        std::fs::remove_file(program).unwrap();
        let (code, stopped) = view.act(r#"{"action":"stop"}"#, true);
        let stopped: Value = serde_json::from_str(&stopped).unwrap();
        assert_eq!((code, &stopped["exit_code"]), (200, &0.into()), "{stopped}");
        system.wait();
        assert_eq!(view.end().0.code(), Some(0));
        system.assert_nothing_left();
    });
}

#[test]
fn a_click_on_the_map_moves_the_goal_and_what_is_shown_of_it() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let view = View::start(&system, &["--control"]);
        system.start(&["free", "--record=drive.mcap"]);
        let shown = view.wait_for(&system, "the page shows the drive", is_driving);
        assert!(shown["actions"].as_array().unwrap().contains(&"goal".into()), "{shown}");
        assert_eq!(frames(&view.address, 1)[0]["goals"], Value::Null, "those of the settings");
        let near = r#"{"action":"goal","x_m":0.1,"y_m":0}"#;
        let far = r#"{"action":"goal","x_m":6.5,"y_m":0.3}"#;
        assert_ne!(view.act(far, false).0, 200, "without the token");
        let act = |body: &str| serde_json::from_str::<Value>(&view.act(body, true).1).unwrap();
        let refused = act(near);
        assert_eq!(refused["exit_code"], 2, "{refused}");
        assert!(refused["messages"].as_str().unwrap().contains("m further on than the robot"), "{refused}");
        let moved = act(far);
        assert_eq!(moved["exit_code"], 0, "{moved}");
        let from_scan = moved["certificate"]["from_scan"].as_u64().unwrap();
        let goals = serde_json::json!([{ "x_m": 6.5, "y_m": 0.3, "tolerance_m": 0.1, "along_m": 6.5 }]);
        system.wait_until("the page shows the new goal", |_| frames(&view.address, 1)[0]["goals"] == goals);
        assert_eq!(system.wait().code(), Some(0));
        let change = system.report().goal_changes[0];
        assert_eq!((change.from_scan, change.x_m, change.y_m), (from_scan, 6.5, 0.3));
        assert_eq!(view.end().0.code(), Some(0));

        let view = View::start(&system, &[system.folder().join("drive.mcap").to_str().unwrap()]);
        for row in view.json("/history")["rows"].as_array().unwrap() {
            let at_ms = (row["time_s"].as_f64().unwrap() * 1e3).ceil();
            let frame = view.json(&format!("/frame?at_ms={at_ms}"));
            let expected = if row["scan_id"].as_u64().unwrap() < from_scan { &Value::Null } else { &goals };
            assert_eq!(&frame["goals"], expected, "{row}");
        }
        assert_eq!(view.end().0.code(), Some(0));
        system.assert_nothing_left();
    });
}

#[test]
fn buttons_of_the_page_drive_while_they_are_held() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let view = View::start(&system, &["--control"]);
        system.start(&["endless"]);
        let (held, released) =
            (r#"{"action":"teleop","velocity":0.3,"steering":0}"#, r#"{"action":"teleop"}"#);
        let driven_by = |name: &str| {
            system.wait_until(name, |system| system.status().unwrap().driven_by.as_deref() == Some(name));
        };
        assert_ne!(view.act(held, false).0, 200, "without the token");
        // Released; and without a word, as when the connection is lost.
        for ends in [Some(released), None] {
            system.wait_until("the robot drives by hand", |system| {
                (0..5).for_each(|_| assert_eq!(view.act(held, true).0, 200));
                let truth = system.newest("truth");
                truth["speed_mps"].as_f64().is_some_and(|speed| speed > 0.05)
                    && system.newest("actuation")["driven_by"] == "person"
            });
            ends.map(|ends| view.act(ends, true));
            system.await_rest();
            driven_by("nobody");
        }
        let mut other = system.command(&["teleop", "--for=600"]).spawn().unwrap();
        driven_by("person");
        let (code, text) = view.act(held, true);
        assert!(code == 409 && text.contains("another person drives"), "{code}: {text}");
        other.kill().unwrap();
        other.wait().unwrap();
        assert_eq!(view.end().0.code(), Some(0));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn a_run_serves_its_page_until_it_ends() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--view=0"]);
        system.wait_until("the link is printed", |system| system.stderr().contains("/#token="));
        let printed = system.stderr();
        let (address, _) = of_link(printed.lines().find(|line| line.contains("/#token=")).unwrap());
        assert_eq!(frames(&address, 3).len(), 3);
        system.signal(system.orchestrator(), Signal::INT);
        system.wait();
        assert!(TcpStream::connect(&address).is_err(), "the page ends with its run");
        system.assert_nothing_left();
    });
}

#[test]
fn a_port_in_use_is_refused_before_anything_starts() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let view = View::start(&system, &[]);
        let port = view.address.rsplit_once(':').unwrap().1.to_owned();
        for arguments in [vec!["view", "--port", &port], vec!["run", "free", &format!("--view={port}")]] {
            let output = system.run(&arguments);
            let message = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(2), "{message}");
            assert!(
                message.contains(&format!("port {port} of 127.0.0.1 is in use; name another")),
                "{message}"
            );
        }
        let (code, text) = view.ask("GET /system", "Origin: http://example.org\r\n", "");
        assert_eq!(code, 403, "{text}");
        let output = system.run(&["view", "--listen", "203.0.113.1"]);
        assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
    });
}

#[test]
fn a_recording_is_shown_frame_by_frame() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_CORRIDOR);
        let report = system.report();
        let path = file.to_str().unwrap();
        let view = View::start(&system, &[path]);
        let shown = view.system();
        assert_eq!(
            (&shown["connection"], &shown["file"], &shown["scenario"], &shown["complete"]),
            (&"recording".into(), &"drive.mcap".into(), &report.scenario.as_str().into(), &true.into()),
            "{shown}"
        );
        assert_eq!(shown["course"]["body"]["length_m"], 0.56, "{shown}");
        let history = view.json("/history");
        let rows = history["rows"].as_array().unwrap();
        let mut scans: Vec<u64> = rows.iter().map(|row| row["scan_id"].as_u64().unwrap()).collect();
        // The wheels are blocked once more at the end.
        scans.dedup();
        // Some scans come after the one that decided the outcome; they are recorded, and the report does not count them.
        let last = scans.len() as u64;
        assert_eq!(scans, (1..=last).collect::<Vec<_>>(), "a frame per scan at 10 Hz");
        assert!(last >= report.scans.published, "{last} of {}", report.scans.published);
        let texts = history["events"].to_string();
        assert!(texts.contains("landed"), "{texts}");
        // Backwards: a frame does not depend on those that were shown before.
        for row in rows.iter().rev().step_by(17) {
            let at_ms = (row["time_s"].as_f64().unwrap() * 1e3).ceil();
            let frame = view.json(&format!("/frame?at_ms={at_ms}"));
            assert_eq!(&frame["row"], row);
            let scan = row["scan_id"].as_u64().unwrap();
            for part in ["scan", "pose", "command", "actuation"] {
                assert_eq!(frame[part]["scan_id"].as_u64(), Some(scan), "{part} of {frame}");
            }
            if scan > report.scans.published {
                continue;
            }
            let [_, x_m, y_m, _] = report.trajectory[scan as usize - 1];
            let far = |key: &str, expected: f64| (frame["truth"][key].as_f64().unwrap() - expected).abs();
            assert!(far("x_m", x_m) < 2e-4 && far("y_m", y_m) < 2e-4, "{frame}");
            let processes = frame["system"]["status"]["processes"].as_array().unwrap();
            assert_eq!((processes.len(), &processes[3]["implementation"]), (5, &"nmpc".into()), "{frame}");
        }
        assert_eq!(view.json("/frame?at_ms=9999999")["row"]["scan_id"].as_u64(), Some(last));
        assert_eq!(view.ask("GET /frame?at_ms=soon", "", "").0, 404);
        assert_eq!(view.act(r#"{"action":"stop"}"#, true).0, 400, "there is nothing to control");
        let (ended, log) = view.end();
        assert_eq!(ended.code(), Some(0), "{log}");

        // What a crash left of the file is shown; what is no recording is refused as by `recording info`.
        let bytes = std::fs::read(&file).unwrap();
        let place = |name: &str| system.folder().join(name);
        std::fs::write(place("cut.mcap"), &bytes[..bytes.len() * 2 / 3]).unwrap();
        let view = View::start(&system, &[place("cut.mcap").to_str().unwrap()]);
        assert_eq!(view.system()["complete"], false);
        let left = view.json("/history")["rows"].as_array().unwrap().len();
        assert!((1..rows.len()).contains(&left), "{left} of {}", rows.len());
        std::fs::write(place("empty.mcap"), "").unwrap();
        std::fs::write(place("text.mcap"), "drive").unwrap();
        std::fs::write(place("start.mcap"), &bytes[..2000]).unwrap();
        let mut flipped = bytes.clone();
        // In the first chunk: what stands between chunks has no checksum.
        let chunk = bytes.windows(3).position(|name| name == b"lz4").unwrap();
        flipped[chunk + 500] ^= 1;
        std::fs::write(place("flipped.mcap"), flipped).unwrap();
        for name in ["missing.mcap", "empty.mcap", "text.mcap", "start.mcap", "flipped.mcap"] {
            let path = place(name);
            let refusal = |arguments: &[&str]| {
                let output = system.run(&[arguments, &[path.to_str().unwrap()]].concat());
                (output.status.code(), String::from_utf8(output.stderr).unwrap(), output.stdout)
            };
            let (code, message, printed) = refusal(&["view", "--port", "0"]);
            assert_eq!((code, printed.len(), message.lines().count()), (Some(2), 0, 1), "{message}");
            assert!(message.contains(name), "{message}");
            assert_eq!(refusal(&["recording", "info"]).1, message, "both say the same");
        }
        assert_eq!(system.run(&["view", path, "--control"]).status.code(), Some(2));
    });
}

fn browser_test(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("browser").join(name)
}

/// What a test in a browser says, which is given the page, its token, and the command of the state.
fn in_browser(name: &str, system: &TestSystem, view: &View) -> Output {
    let status = system.command(&["status", "--json"]);
    let mut test = Command::new("python3");
    test.arg(browser_test(name)).arg(format!("http://{}/", view.address)).arg(&view.token);
    test.arg(status.get_program()).args(status.get_args()).output().unwrap()
}

/// Whether there is a browser; in CI it is installed first, by one test at a time. A skip is printed.
fn has_browser(skipped: &str) -> bool {
    static INSTALLING: Mutex<()> = Mutex::new(());
    let is_ci = std::env::var("CI").as_deref() == Ok("true");
    let argument = if is_ci { "--install" } else { "--check" };
    let setup = {
        let _one_at_a_time = INSTALLING.lock().unwrap();
        Command::new(browser_test("setup.sh")).arg(argument).output()
    };
    let reason = match setup {
        Ok(output) if output.status.success() => return true,
        Ok(output) => String::from_utf8_lossy(&output.stderr).into_owned(),
        Err(error) => error.to_string(),
    };
    assert!(!is_ci, "{reason}");
    // Past the capture of the test harness, which shows nothing of a test that passes.
    let _ = std::io::stderr().lock().write_all(format!("SKIPPED {skipped}: {reason}").as_bytes());
    false
}

#[test]
fn the_page_works_in_a_browser() {
    repeat_when_late(|| {
        if !has_browser("the_page_works_in_a_browser") {
            return;
        }
        let mut system = TestSystem::new(EXECUTABLE);
        let view = View::start(&system, &["--control"]);
        system.start(&["endless"]);
        view.wait_for(&system, "the page shows the drive", is_driving);
        let output = in_browser("page.py", &system, &view);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        system.wait_until("the button has stopped the run", |system| system.find().is_none());
        system.wait();
        assert_eq!(system.report().scans.unaccounted, 0);
    });
}

#[test]
fn an_arrow_drives_while_it_is_pressed_in_a_browser() {
    repeat_when_late(|| {
        if !has_browser("an_arrow_drives_while_it_is_pressed_in_a_browser") {
            return;
        }
        let mut system = TestSystem::new(EXECUTABLE);
        let view = View::start(&system, &["--control"]);
        system.start(&["endless"]);
        view.wait_for(&system, "the page shows the drive", is_driving);
        let output = in_browser("hand.py", &system, &view);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn a_recording_plays_in_a_browser_from_a_server_and_from_a_file() {
    repeat_when_late(|| {
        if !has_browser("a_recording_plays_in_a_browser_from_a_server_and_from_a_file") {
            return;
        }
        let (system, file) = recorded(&SHORT_CORRIDOR);
        let view = View::start(&system, &[file.to_str().unwrap()]);
        assert!(system.run(&["report", file.to_str().unwrap()]).status.success());
        let page = system.folder().join("drive.html");
        for link in [format!("http://{}/", view.address), format!("file://{}", page.display())] {
            // The goal of the course.
            let test = browser_test("recording.py");
            let output = Command::new("python3").arg(test).args([&link, "7"]).output().unwrap();
            assert!(output.status.success(), "{link}: {}", String::from_utf8_lossy(&output.stderr));
        }
    });
}
