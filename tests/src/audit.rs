//! Checks certificates against what was on the bus, independent of the orchestrator.
//!
//! Idea: an actuation carries the stamps of all samples that it rests on. In real time no two processes of a role
//! publish at the same nanosecond, so the stamp identifies the writer. Which of two actuators the robot obeyed
//! is in the state that the robot publishes. In lock-step stamps are equal; there the drive itself has to be
//! compared.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use emulator::service::RobotState;
use handover::swap::Certificate;
use runtime::{Bus, Domain, Observer, RuntimeError, wait_for};
use shared_types::{
    Actuation, Checkpoint, Command, Header, Obstacles, Odometry, Pose, Role, SLOTS, Sample, Scan,
};

/// Time between two polls of the bus [ns]; topics hold sixteen samples.
const POLL_NS: u64 = 1_000_000;
/// Scans before and after a change that are checked.
const AROUND: u64 = 3;

/// Records what is published, in a thread of its own.
#[derive(Debug)]
pub struct Audit {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<AuditRecord, RuntimeError>>,
}

/// What was published while an [`Audit`] ran.
#[derive(Debug, Clone, Default)]
pub struct AuditRecord {
    /// Answers of all actuators, by scan.
    answers: BTreeMap<u64, Vec<Answer>>,
    /// Incarnation and stamp of all outputs, by role and scan.
    outputs: BTreeMap<(usize, u64), Vec<(u32, u64)>>,
    /// The actuator that the robot obeyed, by scan.
    obeyed: BTreeMap<u64, u32>,
}

/// One answer of an actuator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// Incarnation of the actuator.
    pub incarnation: u32,
    /// When the sample of each role was published that it rests on [ns].
    pub stamps_ns: [u64; SLOTS],
    /// Desired steering angle and velocity [rad, m/s].
    pub desired: [f64; 2],
}

impl Audit {
    /// Records from now on; the system must be running.
    pub fn start(domain: &Domain) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let ready = Arc::new(AtomicBool::new(false));
        let (domain, asked, began) = (domain.clone(), Arc::clone(&stop), Arc::clone(&ready));
        let thread = std::thread::spawn(move || watch(&domain, &asked, &began));
        while !ready.load(Ordering::Acquire) && !thread.is_finished() {
            crate::pause();
        }
        Self { stop, thread }
    }

    /// Ends the recording.
    ///
    /// # Panics
    /// When the bus could not be read.
    pub fn stop(self) -> AuditRecord {
        self.stop.store(true, Ordering::Release);
        self.thread.join().expect("the thread ends").expect("the bus can be read")
    }
}

/// Passes when scans and commands of the certificate equal what was recorded.
///
/// # Errors
/// A text with all contradictions.
pub fn audit(certificate: &Certificate, recording: &AuditRecord) -> Result<(), String> {
    let mut faults = Vec::new();
    let role: Role = certificate.role.parse().map_err(|unknown| format!("{unknown}"))?;
    let (Some(last), Some(first)) = (certificate.last_scan_old, certificate.first_scan_new) else {
        return Ok(());
    };
    let back = certificate.first_scan_back;
    let (old, new) = (recording.party(role, last), recording.party(role, first));
    if old.is_none() || new.is_none() || old == new {
        faults.push(format!("scan {last} rests on incarnation {old:?}, scan {first} on {new:?}"));
        for scan in [last, first] {
            let (answers, obeyed) = (recording.answers.get(&scan), recording.obeyed.get(&scan));
            let outputs = recording.outputs.get(&(role.index(), scan));
            faults.push(format!(
                "recorded of scan {scan}: {answers:?}, robot obeyed {obeyed:?}, outputs {outputs:?}"
            ));
        }
    }
    let until = back.unwrap_or(first + AROUND).min(first + AROUND);
    let mut expect = |scans: std::ops::Range<u64>, expected: Option<u32>| {
        for scan in scans {
            let found = recording.party(role, scan);
            if found.is_some() && found != expected {
                faults.push(format!("scan {scan} rests on incarnation {found:?} instead of {expected:?}"));
            }
        }
    };
    expect(last.saturating_sub(AROUND)..first, old);
    expect(first..until, new);
    if let Some(back) = back {
        expect(back..back + AROUND, old);
    }
    let around = last.saturating_sub(AROUND)..back.unwrap_or(first) + AROUND;
    let missed = around.clone().filter(|scan| recording.is_missed(*scan)).count() as u64;
    let duplicates: u64 = around.map(|scan| recording.duplicates(scan)).sum();
    if missed > certificate.missed_scans || duplicates > certificate.duplicate_scans {
        faults.push(format!("{missed} scans missed and {duplicates} answered twice around the change"));
    }
    let jump = recording.jump(&[Some(first), back].into_iter().flatten().collect::<Vec<_>>());
    let told = [certificate.command_jump_rad, certificate.command_jump_mps];
    if jump.iter().zip(told).any(|(found, told)| (found - told).abs() > 1e-12) {
        faults.push(format!("commands jumped by {jump:?}, told are {told:?}"));
    }
    if faults.is_empty() { Ok(()) } else { Err(format!("{certificate:?}: {}", faults.join("; "))) }
}

impl AuditRecord {
    /// The incarnation of `role` that the answer to a scan rests on, as far as it can be told.
    pub fn party(&self, role: Role, scan: u64) -> Option<u32> {
        let answer = self.obeyed(scan)?;
        if role == Role::Actuator {
            return Some(answer.incarnation);
        }
        let stamp_ns = answer.stamps_ns[role.index()];
        let outputs = self.outputs.get(&(role.index(), scan))?;
        let mut found = outputs.iter().filter(|(_, published_ns)| *published_ns == stamp_ns);
        let (incarnation, _) = *found.next()?;
        found.all(|(other, _)| *other == incarnation).then_some(incarnation)
    }

    /// The answer to a scan that the robot obeyed.
    pub fn obeyed(&self, scan: u64) -> Option<&Answer> {
        let answers = self.answers.get(&scan)?;
        match self.obeyed.get(&scan) {
            Some(obeyed) => answers.iter().find(|answer| answer.incarnation == *obeyed),
            None => answers
                .first()
                .filter(|first| answers.iter().all(|answer| answer.incarnation == first.incarnation)),
        }
    }

    /// Largest change of steering angle and velocity from one answer to the next, from two scans before to three
    /// after each of the `changes` [rad, m/s].
    pub fn jump(&self, changes: &[u64]) -> [f64; 2] {
        self.largest_change(|before, scan| {
            changes.iter().any(|change| before + 2 >= *change && scan <= *change + 3)
        })
    }

    /// The same of all answers that are not within `scans` scans of one of the `changes`: what is normal.
    pub fn normal_change(&self, changes: &[u64], scans: u64) -> [f64; 2] {
        self.largest_change(|_, scan| changes.iter().all(|change| scan.abs_diff(*change) > scans))
    }

    fn largest_change(&self, counts: impl Fn(u64, u64) -> bool) -> [f64; 2] {
        let mut largest = [0.0_f64; 2];
        let mut before: Option<(u64, [f64; 2])> = None;
        for (scan, desired) in
            self.answers.keys().filter_map(|scan| Some((*scan, self.obeyed(*scan)?.desired)))
        {
            if let Some((earlier, last)) = before
                && counts(earlier, scan)
            {
                for (largest, (one, other)) in largest.iter_mut().zip(last.iter().zip(&desired)) {
                    *largest = largest.max((other - one).abs());
                }
            }
            before = Some((scan, desired));
        }
        largest
    }

    fn is_missed(&self, scan: u64) -> bool {
        self.outputs.contains_key(&(Role::Robot.index(), scan)) && !self.answers.contains_key(&scan)
    }

    fn duplicates(&self, scan: u64) -> u64 {
        let (Some(answers), Some(obeyed)) = (self.answers.get(&scan), self.obeyed(scan)) else { return 0 };
        let count = answers.iter().filter(|answer| answer.incarnation == obeyed.incarnation).count() as u64;
        count.saturating_sub(1)
    }

    fn output(&mut self, role: Role, header: &Header) {
        let published_ns = header.stage(role).published_ns;
        let outputs = self.outputs.entry((role.index(), header.scan_id)).or_default();
        outputs.push((header.incarnation, published_ns));
    }

    fn answer(&mut self, actuation: &Actuation) {
        if actuation.answers == 1 {
            let header = &actuation.header;
            self.answers.entry(header.scan_id).or_default().push(Answer {
                incarnation: header.incarnation,
                stamps_ns: header.chain.map(|stage| stage.published_ns),
                desired: [actuation.desired_steering_rad, actuation.desired_velocity_mps],
            });
        }
    }
}

fn watch(domain: &Domain, stop: &AtomicBool, ready: &AtomicBool) -> Result<AuditRecord, RuntimeError> {
    let bus = Bus::open(domain, "audit")?;
    let scans = Observer::<Scan>::new(&bus)?;
    let odometries = Observer::<Odometry>::new(&bus)?;
    let poses = Observer::<Pose>::new(&bus)?;
    let obstacles = Observer::<Obstacles>::new(&bus)?;
    let commands = Observer::<Command>::new(&bus)?;
    let actuations = Observer::<Actuation>::new(&bus)?;
    let states = Observer::<Checkpoint>::new(&bus)?;
    let mut recording = AuditRecord::default();
    while !stop.load(Ordering::Acquire) {
        outputs(&scans, Role::Robot, &mut recording)?;
        outputs(&odometries, Role::Robot, &mut recording)?;
        outputs(&poses, Role::Estimator, &mut recording)?;
        outputs(&obstacles, Role::Obstacles, &mut recording)?;
        outputs(&commands, Role::Controller, &mut recording)?;
        actuations.poll(|actuation| recording.answer(actuation))?;
        states.poll(|checkpoint| {
            if checkpoint.role == Role::Robot.wire()
                && let Ok(state) = checkpoint.state::<RobotState>()
                && state.answered == checkpoint.header.scan_id
            {
                recording.obeyed.entry(state.answered).or_insert(state.received_incarnation);
            }
        })?;
        ready.store(true, Ordering::Release);
        wait_for(&[], POLL_NS);
    }
    Ok(recording)
}

fn outputs<S: Sample>(
    observer: &Observer<S>,
    role: Role,
    recording: &mut AuditRecord,
) -> Result<(), RuntimeError> {
    observer.poll(|sample| recording.output(role, sample.header())).map(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scans 1 to 20 with two controllers; 4 is used before scan 10, 9 from there on.
    fn recording() -> AuditRecord {
        let mut recording = AuditRecord::default();
        for scan in 1..=20 {
            for incarnation in [4, 9] {
                let mut header = Header { scan_id: scan, incarnation, ..Header::default() };
                header.stage_mut(Role::Controller).published_ns = scan * 1000 + u64::from(incarnation);
                recording.output(Role::Controller, &header);
                if incarnation == if scan < 10 { 4 } else { 9 } {
                    let desired_steering_rad = if scan < 10 { 0.0 } else { 0.01 };
                    let header = Header { incarnation: 5, ..header };
                    recording.answer(&Actuation {
                        header,
                        answers: 1,
                        desired_steering_rad,
                        ..Actuation::default()
                    });
                }
            }
        }
        recording
    }

    fn certificate() -> Certificate {
        Certificate {
            role: "controller".to_owned(),
            last_scan_old: Some(9),
            first_scan_new: Some(10),
            command_jump_rad: 0.01,
            ..Certificate::default()
        }
    }

    #[test]
    fn a_true_certificate_passes() {
        assert_eq!(audit(&certificate(), &recording()), Ok(()));
    }

    #[test]
    fn a_false_certificate_is_found() {
        let error_of = |certificate: Certificate| audit(&certificate, &recording()).unwrap_err();
        let late = Certificate { last_scan_old: Some(10), first_scan_new: Some(11), ..certificate() };
        assert!(error_of(late).contains("scan 10 rests on incarnation Some(9), scan 11 on Some(9)"));
        let back = Certificate { first_scan_back: Some(12), ..certificate() };
        assert!(error_of(back).contains("scan 12 rests on incarnation Some(9) instead of Some(4)"));
        let smooth = Certificate { command_jump_rad: 0.005, ..certificate() };
        assert!(error_of(smooth).contains("commands jumped by [0.01, 0.0]"));
        let mut gap = recording();
        gap.output(Role::Robot, &Header { scan_id: 8, ..Header::default() });
        gap.answers.remove(&8);
        assert!(audit(&certificate(), &gap).unwrap_err().contains("1 scans missed"));
    }

    #[test]
    fn what_is_normal_excludes_the_changes() {
        assert_eq!(recording().normal_change(&[10], 3), [0.0, 0.0]);
        assert_eq!(recording().normal_change(&[], 3), [0.01, 0.0]);
    }
}
