//! An emergency stop from outside, by the example in Python.

use rustix::process::Signal;
use scanloop_tests::TestSystem;
use scanloop_tests::machine::repeat_when_late;

use super::tools::{EXECUTABLE, examples, python};

fn drives(system: &TestSystem) -> bool {
    system.newest("actuation")["kind"] == "drive"
}

#[test]
fn a_button_that_is_pressed_or_silent_blocks_the_wheels_until_a_person_resumes() {
    repeat_when_late(|| {
        let Some(python) = python("the emergency stop in Python") else { return };
        let folder = examples("python").join("emergency-stop");
        let mut system = TestSystem::new(EXECUTABLE);
        let contact = system.folder().join("contact");
        let press = |text: &str| std::fs::write(&contact, text).unwrap();
        press("0\n");
        let words = [&python, &folder.join("contact.py"), &contact];
        let words = words.map(|path| path.to_str().unwrap().to_owned());
        let command = format!("process.contact.command={words:?}");
        let file = folder.join("system.toml");
        system.start(&["endless", "--record", "--system", file.to_str().unwrap(), "--set", &command]);
        // Until the process in Python has begun the button is silent, which is as if it were pressed.
        let resume = |system: &TestSystem| {
            system.wait_until("the robot drives", |system| {
                let _ = system.run(&["resume"]);
                drives(system)
            });
        };
        resume(&system);
        for text in ["1\n", "", "no contact"] {
            press(text);
            system.await_rest();
            assert_eq!(system.newest("actuation")["reason"], "emergency_stop", "{text:?}");
            // While it is pressed nobody drives on.
            let _ = system.run(&["resume"]);
            system.wait_until("it holds", |system| system.newest("actuation")["driven_by"] == "nobody");
            system.await_rest();
            press("0\n");
            system.wait_until("it is released", |system| system.newest("actuation")["reason"] == "paused");
            system.await_rest();
            resume(&system);
        }
        let pid = system.status().unwrap().companions[0].pid;
        system.signal(i32::try_from(pid).unwrap(), Signal::STOP);
        system.await_rest();
        assert_eq!(system.newest("actuation")["reason"], "emergency_stop", "it is silent");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_replayed();
    });
}

#[test]
fn a_topic_that_tells_of_no_button_is_refused() {
    let folder = examples("python").join("emergency-stop");
    let system = TestSystem::new(EXECUTABLE);
    let text = std::fs::read_to_string(folder.join("system.toml")).unwrap();
    let layout = std::fs::read_to_string(folder.join("button.toml")).unwrap();
    std::fs::write(system.folder().join("system.toml"), text).unwrap();
    std::fs::write(system.folder().join("button.toml"), layout.replace("\"pressed\"", "\"state\"")).unwrap();
    let output = system.run(&["check", "system.toml"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("topic button") && message.contains("`pressed`"), "{message}");
}
