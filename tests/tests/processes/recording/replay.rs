//! Replays with other settings and other programs, and of drives with faults.

use scanloop_tests::machine::repeat_when_late;
use std::path::Path;

use scanloop_tests::recordings::{self, RecordingKind};
use scanloop_tests::{SHORT_CORRIDOR, SHORT_FREE, TestSystem};

use super::{EXECUTABLE, recorded, replayed, rewrite_with, text};
use crate::languages::tools;

const FAULTY_CONTROLLER: &str = env!("CARGO_BIN_EXE_faulty-controller");

#[test]
fn another_setting_is_judged_by_the_bounds_of_a_swap() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_CORRIDOR);
        let (same, code) =
            replayed(&system, &file, &["--stage", "controller", "--set", "controller.horizon_s=5.5"]);
        assert_eq!((code, &same["beyond"]), (0, &0.into()), "{same}");
        let change = ["--stage", "controller", "--set", "controller.horizon_s=3.0", "--tolerance", "0"];
        let (other, code) = replayed(&system, &file, &change);
        assert_eq!(code, 1, "{other}");
        assert!(other["beyond"].as_u64() > Some(0), "{other}");
        let unknown = system.run(&["replay", text(&file), "--set", "controller.horizon=2"]);
        assert_eq!(unknown.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&unknown.stderr).contains("unknown key horizon"));
    });
}

#[test]
fn drives_with_a_kill_a_hang_late_samples_and_200_scans_a_second_are_replayed_to_the_bit() {
    repeat_when_late(|| {
        let kinds = [
            (RecordingKind::Kill, 3),
            (RecordingKind::Hang, 5),
            (RecordingKind::Late, 7),
            (RecordingKind::ScannerInLockstep, 9),
            (RecordingKind::Fast, 11),
        ];
        std::thread::scope(|scope| {
            for (kind, seed) in kinds {
                scope.spawn(move || {
                    let (tally, printed) = recordings::check(EXECUTABLE, kind, seed);
                    assert!(tally.compared > 300 && tally.same == 1, "{kind:?}: {tally}\n{printed}");
                });
            }
        });
    });
}

#[test]
fn a_program_in_place_of_a_stage_gets_the_recorded_inputs() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_CORRIDOR);
        let whole = replayed(&system, &file, &[]).0;
        let of_role = |role: &str| whole["compared"].as_u64().map(|all| all / 7).filter(|_| !role.is_empty());
        for (role, implementation) in [
            ("estimator", "ekf"),
            ("obstacles", "ellipses"),
            ("controller", "nmpc"),
            ("actuator", "actuation"),
        ] {
            let with = format!("{role}={implementation}");
            let (same, code) = replayed(&system, &file, &["--with", &with]);
            assert_eq!(
                (code, &same["identical"], &same["beyond"]),
                (0, &same["compared"], &0.into()),
                "{same}"
            );
            assert_eq!((same["compared"].as_u64(), &same["skipped"]), (of_role(role), &0.into()), "{same}");
            let statistics = &same["statistics"][0];
            assert_eq!((&statistics["role"], &statistics["compared"]), (&role.into(), &same["compared"]));
            let largest = statistics["differences"].as_array().expect("of a test").iter();
            assert!(
                largest.map(|found| found["max_abs"].as_f64()).all(|largest| largest == Some(0.0)),
                "{same}"
            );
        }
        let part = ["--with", "controller=nmpc", "--from", "40", "--to", "60"];
        let (part, code) = replayed(&system, &file, &part);
        assert_eq!((code, &part["identical"], &part["compared"]), (0, &21.into(), &21.into()), "{part}");
        // A fifth more steering is beyond the bounds, and within twice as wide ones.
        let steer = format!("controller={FAULTY_CONTROLLER} steer");
        let (other, code) = replayed(&system, &file, &["--with", &steer]);
        assert!(code == 1 && other["beyond"].as_u64() > Some(0), "{other}");
        let (within, code) = replayed(&system, &file, &["--with", &steer, "--tolerance", "2"]);
        assert_eq!((code, &within["beyond"]), (0, &0.into()), "{within}");
        let invalid = format!("controller={FAULTY_CONTROLLER} nan");
        let (invalid, code) = replayed(&system, &file, &["--with", &invalid]);
        assert_eq!((code, &invalid["beyond"]), (1, &invalid["compared"]), "{invalid}");
        let dead = system.run(&[
            "replay",
            text(&file),
            "--with",
            &format!("controller={FAULTY_CONTROLLER} exit-after 5"),
        ]);
        assert_eq!(dead.status.code(), Some(4));
        assert!(String::from_utf8_lossy(&dead.stderr).contains("the command ended"));
        for (with, reason) in [
            ("robot=emulator", "not possible"),
            ("controller=./does-not-exist", "was not found"),
            ("wheels=nmpc", "wheels"),
            ("controller", "expected ROLE=COMMAND"),
        ] {
            let output = system.run(&["replay", text(&file), "--with", with]);
            let message = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(matches!(output.status.code(), Some(2 | 4)) && message.contains(reason), "{message}");
        }
        system.assert_nothing_left();
    });
}

#[test]
fn the_regression_test_of_the_examples_passes_and_fails() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let script = tools::root().join("examples/regression-test.sh");
        let folder = Path::new(EXECUTABLE).parent().expect("of a test");
        std::os::unix::fs::symlink(EXECUTABLE, system.folder().join("scanloop")).expect("of a test");
        let path = format!("{}:{}:{}", text(system.folder()), text(folder), std::env::var("PATH").unwrap());
        let run = |controller: &str| {
            let mut command = std::process::Command::new(&script);
            command.arg(controller).env("PATH", &path).env("SCANLOOP_SYSTEM_ID", system.id());
            command.current_dir(system.folder()).output().expect("the script runs")
        };
        let same = run("nmpc");
        assert_eq!(same.status.code(), Some(0), "{}", String::from_utf8_lossy(&same.stderr));
        let other = run(&format!("{FAULTY_CONTROLLER} steer"));
        assert_eq!(other.status.code(), Some(1), "{}", String::from_utf8_lossy(&other.stderr));
    });
}

#[test]
fn in_real_time_a_replay_takes_as_long_as_the_drive() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_FREE);
        let started = std::time::Instant::now();
        let limits = ["--from", "10", "--to", "25", "--stage", "obstacles"];
        let (report, code) = replayed(&system, &file, &[&limits[..], &["--speed", "1"]].concat());
        assert_eq!((code, &report["compared"]), (0, &16.into()), "{report}");
        assert!(started.elapsed().as_secs_f64() >= 1.5, "{:?}", started.elapsed());
        let refused = system.run(&["replay", text(&file), "--speed", "2"]);
        assert_eq!(refused.status.code(), Some(2));
    });
}

#[test]
fn stages_whose_samples_have_the_same_layout_are_replayed() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_FREE);
        let other = system.folder().join("other.mcap");
        let change = |name: &str, data: &[u8]| {
            let text = String::from_utf8_lossy(data);
            match name {
                "layouts.txt" => text.replace("\nobstacles count ", "\nobstacles number ").into_bytes(),
                _ => data.to_vec(),
            }
        };
        rewrite_with(&file, &other, change, |_, _, _| {});
        let (report, code) = replayed(&system, &other, &[]);
        assert_eq!((code, &report["identical"]), (0, &report["compared"]), "{report}");
        let left: Vec<&str> = report["not_replayed"]
            .as_array()
            .unwrap()
            .iter()
            .filter_map(|row| row["role"].as_str())
            .collect();
        assert_eq!(left, ["obstacles", "controller"], "{report}");
        let fields = report["not_replayed"][0]["fields"].to_string();
        assert!(fields.contains("number") && fields.contains("count"), "{fields}");
        let refused = system.run(&["replay", text(&other), "--stage", "controller"]);
        let message = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(refused.status.code() == Some(2) && message.contains("field number"), "{message}");
        let damaged = system.folder().join("damaged.mcap");
        rewrite_with(
            &file,
            &damaged,
            |name, data| if name == "layouts.txt" { b"?".to_vec() } else { data.to_vec() },
            |_, _, _| {},
        );
        let refused = system.run(&["replay", text(&damaged)]);
        let message = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(refused.status.code() == Some(2) && message.contains("layouts.txt"), "{message}");
    });
}
