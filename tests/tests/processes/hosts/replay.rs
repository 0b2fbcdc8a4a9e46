//! Replays of drives whose stages ran on other hosts: each is recomputed on the clock of its host, to the bit.

use scanloop_tests::SHORT_CORRIDOR;
use scanloop_tests::machine::repeat_when_late;
use serde_json::Value;

use super::*;
use crate::recording::{replayed, rewrite};

/// Where the host's clock stands in a message of topic `clock`: behind the encapsulation, the header, the name and the
/// orchestrator's clock.
const HOST_NS: usize = 4 + 288 + 16 + 8;

impl TwoHosts {
    /// [`TwoHosts::start`] of a drive that is recorded.
    pub(super) fn start_recorded(&mut self, scenario: &[&str]) {
        self.start(&[scenario, &["--record=drive.mcap"]].concat());
    }

    /// Checks that the replay of the recorded drive is identical, and that nearly all of it was compared. Returns the report
    /// of the replay.
    pub(super) fn assert_replayed(&self) -> Value {
        let (report, code) = replayed(&self.system, &self.system.folder().join("drive.mcap"), &[]);
        let count = |key: &str| report[key].as_u64().unwrap();
        assert_eq!((code, count("identical")), (0, count("compared")), "{report}");
        // A busy machine may lose a journal or a state; then all is skipped until the next recorded one, a second at most.
        assert!(20 * count("skipped") < count("samples"), "{report}");
        for skipped in report["reasons"].as_array().unwrap() {
            assert!(skipped["reason"].as_str().unwrap().ends_with("recorded"), "{report}");
        }
        report
    }
}

#[test]
fn a_drive_from_another_host_with_a_kill_there_is_replayed_to_the_bit_and_a_wrong_offset_is_found() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::new("a replay of a drive over two hosts") else { return };
        hosts.start_agent();
        hosts.start_recorded(&SHORT_CORRIDOR);
        hosts.system.wait_until_driving();
        let killed = process_of(&hosts.other_id(), Role::Estimator).unwrap();
        kill_process(killed, Signal::KILL).unwrap();
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let published = hosts.system.report().scans.published;
        let report = hosts.assert_replayed();
        // Those of the robot, and nearly all of the four others: some scans have no answer because of the kill.
        assert!(report["compared"].as_u64().unwrap() > 6 * published, "{report}");
        let file = hosts.system.folder().join("drive.mcap");
        let from = published / 2;
        let (later, code) = replayed(&hosts.system, &file, &["--from", &from.to_string()]);
        assert_eq!((code, &later["identical"]), (0, &later["compared"]), "{later}");
        // One bit, a nanosecond, in one offset.
        let flipped = hosts.system.folder().join("flipped.mcap");
        rewrite(&file, &flipped, "/scanloop/clock", |number, data| {
            data[HOST_NS] ^= u8::from(number as u64 == from);
        });
        let (report, code) = replayed(&hosts.system, &flipped, &[]);
        assert_eq!(code, 1, "{report}");
        assert!(!report["differences"].as_array().unwrap().is_empty(), "{report}");
        hosts.end();
    });
}
