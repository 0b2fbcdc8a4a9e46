//! Frames of small recordings.

use super::*;
use bytemuck::bytes_of;
use shared_types::{
    Actuation, ActuationKind, Authority, Command, Directive, Header, Phase, Pose, SLOTS, Sample, Scan,
    ScanGeometry, StageStamps, Topic,
};

const PERIOD_NS: u64 = 100_000_000;

/// A file in the folder of temporary files; it is removed with the value.
pub(crate) struct File(pub(crate) std::path::PathBuf);

impl Drop for File {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn file(name: &str) -> File {
    File(std::env::temp_dir().join(format!("scanloop-view-{}-{name}.mcap", std::process::id())))
}

fn header<S: Sample>(scan_id: u64, incarnation: u32, role: Role) -> Header {
    let published_ns = scan_id * PERIOD_NS + 1_000_000 * role.index() as u64;
    let mut header =
        Header { layout: S::LAYOUT, scan_id, incarnation, sequence: scan_id, ..Header::default() };
    header.chain[role.index()] = StageStamps { published_ns, ..StageStamps::default() };
    header
}

/// Twelve seconds: the pose moves a decimetre per scan, the estimator is restarted at scan 60, and the controller is
/// silent from scan 80 on.
pub(crate) fn drive(name: &str) -> File {
    drive_with(name, 120, |_| {}, |_| {})
}

/// The same of so many scans, and what is made of the actuations and scans.
pub(crate) fn drive_with(
    name: &str,
    scans: u64,
    change: impl Fn(&mut Actuation),
    measure: impl Fn(&mut Scan),
) -> File {
    let file = file(name);
    let mut tape =
        recording::Tape::new(recording::writer(std::fs::File::create(&file.0).unwrap()).unwrap(), false, 0);
    for scan_id in 1..=scans {
        let estimator = if scan_id < 60 { 2 } else { 12 };
        let authority: [Authority; SLOTS] = std::array::from_fn(|index| {
            let is_estimator = index == Role::Estimator.index();
            let incarnation = if is_estimator { estimator } else { index as u32 + 1 };
            Authority { incarnation, ..Authority::default() }
        });
        let directive = Directive {
            header: Header { layout: Directive::LAYOUT, sequence: scan_id, ..Header::default() },
            phase: Phase::Driving.wire(),
            issued_ns: scan_id * PERIOD_NS - 1_000_000,
            authority,
            ..Directive::default()
        };
        tape.sample(Topic::Directive, bytes_of(&directive)).unwrap();
        let of = |role: Role| authority[role.index()].incarnation;
        let mut scan = Scan {
            header: header::<Scan>(scan_id, of(Role::Robot), Role::Robot),
            period_ns: PERIOD_NS,
            sweep_ns: PERIOD_NS / 2,
            ..Scan::of(ScanGeometry::URG_04LX)
        };
        measure(&mut scan);
        tape.sample(Topic::Scan, bytes_of(&scan)).unwrap();
        let pose = Pose {
            header: header::<Pose>(scan_id, of(Role::Estimator), Role::Estimator),
            x_m: 0.1 * scan_id as f64,
            ..Pose::default()
        };
        tape.sample(Topic::Pose, bytes_of(&pose)).unwrap();
        if scan_id < 80 {
            let command = Command {
                header: header::<Command>(scan_id, of(Role::Controller), Role::Controller),
                verified: 1,
                ..Command::default()
            };
            tape.sample(Topic::Command, bytes_of(&command)).unwrap();
        }
        if scan_id == 60 {
            tape.log("orchestrator", "WARN estimator (ekf) ended: killed by signal 9").unwrap();
            tape.log("robot", " INFO wheels may turn").unwrap();
            tape.log("robot", " WARN no directives: wheels are blocked").unwrap();
        }
        let kind = ActuationKind::Drive.wire();
        let mut actuation = Actuation {
            header: header::<Actuation>(scan_id, of(Role::Actuator), Role::Actuator),
            kind,
            answers: 1,
            ..Actuation::default()
        };
        change(&mut actuation);
        tape.sample(Topic::Actuation, bytes_of(&actuation)).unwrap();
    }
    tape.into_target().finish().unwrap();
    file
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

#[test]
fn each_frame_has_the_samples_of_its_time_in_any_order() {
    let file = drive("order");
    let mut drive = RecordedDrive::open(&file.0).unwrap();
    let rows = json(&drive.history(None));
    assert_eq!(rows["recording"]["frames"], 120);
    for number in [120_u64, 1, 77, 10, 11, 95] {
        let row = rows["rows"][number as usize - 1].clone();
        let frame = drive.frame(row["time_s"].as_f64().unwrap()).unwrap();
        assert_eq!(frame["row"], row);
        let ids = ["scan", "pose", "actuation"].map(|part| frame[part]["scan_id"].as_u64().unwrap());
        assert_eq!(ids, [number; 3]);
        // The newest command is more than a chunk older than the last frames.
        assert_eq!(frame["command"]["scan_id"].as_u64(), Some(number.min(79)), "{frame}");
        assert!((frame["pose"]["x_m"].as_f64().unwrap() - 0.1 * number as f64).abs() < 1e-9);
    }
    assert_eq!(drive.frame(1e9).unwrap()["row"]["number"], 120, "after the end the last one");
    assert_eq!(drive.frame(0.0).unwrap()["row"]["number"], 1);
}

#[test]
fn a_restart_is_an_event_and_the_processes_are_those_of_the_time() {
    let file = drive("restart");
    let mut drive = RecordedDrive::open(&file.0).unwrap();
    let history = json(&drive.history(None));
    let texts: Vec<&str> =
        history["events"].as_array().unwrap().iter().map(|event| event["text"].as_str().unwrap()).collect();
    assert!(texts.contains(&"estimator restarted as incarnation 12"), "{texts:?}");
    let logged: Vec<&str> =
        texts.into_iter().filter(|text| text.contains('(') || text.contains(": ")).collect();
    assert_eq!(
        logged,
        ["estimator (ekf) ended: killed by signal 9", "robot:  WARN no directives: wheels are blocked"]
    );
    let times: Vec<f64> =
        history["events"].as_array().unwrap().iter().map(|event| event["time_s"].as_f64().unwrap()).collect();
    assert!(times.is_sorted() && times.iter().any(|time_s| (5.5..6.5).contains(time_s)), "{times:?}");
    let mut restarts = |at_s: f64| {
        let frame = drive.frame(at_s).unwrap();
        let row = &frame["system"]["status"]["processes"][1];
        (row["role"].clone(), row["restarts"].clone(), frame["system"]["authority"][1].clone())
    };
    assert_eq!(restarts(3.0), ("estimator".into(), 0.into(), 2.into()));
    assert_eq!(restarts(9.0), ("estimator".into(), 1.into(), 12.into()));
}

#[test]
fn rows_around_a_time_reach_as_far_as_charts() {
    let file = drive("rows");
    let drive = RecordedDrive::open(&file.0).unwrap();
    assert_eq!(json(&drive.history(Some(5.0)))["rows"].as_array().unwrap().len(), 120);
    assert_eq!(json(&drive.history(Some(1000.0)))["rows"].as_array().unwrap().len(), 0);
}

#[test]
fn a_file_without_a_drive_is_refused() {
    let file = file("empty");
    let mut tape =
        recording::Tape::new(recording::writer(std::fs::File::create(&file.0).unwrap()).unwrap(), false, 0);
    tape.sample(Topic::Directive, bytes_of(&Directive::default())).unwrap();
    tape.into_target().finish().unwrap();
    let error = RecordedDrive::open(&file.0).err().unwrap().to_string();
    assert!(error.contains("holds no scan"), "{error}");
}

#[test]
fn a_sample_that_was_recorded_at_a_time_of_long_ago_ends_no_page() {
    let file = drive_with(
        "long-ago",
        120,
        |actuation| {
            if actuation.header.scan_id == 60 {
                actuation.header.chain[Role::Actuator.index()].published_ns = 1;
            }
        },
        |_| {},
    );
    let mut drive = RecordedDrive::open(&file.0).unwrap();
    assert_eq!(json(&drive.history(None))["recording"]["frames"], 120);
    assert_eq!(drive.frame(1e9).unwrap()["row"]["number"], 120);
}
