//! What a stage took before each of its outputs: by its journals, or by the stamps of the output where a process has none.

use std::collections::{BTreeMap, BTreeSet};

use bytemuck::bytes_of;
use shared_types::{
    Actuation, Checkpoint, Command, Header, JournalEntry, JournalKind, Obstacles, Odometry, Pose, Role,
    Sample, Scan, Topic,
};

use crate::ReplayDrive;

/// A recorded sample that a stage reads.
pub(super) struct Input {
    pub(super) topic: Topic,
    scan_id: u64,
    /// Samples begin at multiples of eight bytes.
    words: Vec<u64>,
}

impl Input {
    fn of<S: Sample>(sample: &S) -> Self {
        let mut words = vec![0; size_of::<S>().div_ceil(8)];
        bytemuck::cast_slice_mut::<u64, u8>(&mut words)[..size_of::<S>()].copy_from_slice(bytes_of(sample));
        Self { topic: S::TOPIC, scan_id: sample.header().scan_id, words }
    }

    pub(super) fn bytes_mut(&mut self) -> &mut [u8] {
        &mut bytemuck::cast_slice_mut(&mut self.words)[..self.topic.size()]
    }
}

/// A sample of a process: topic, incarnation, sequence number.
type Number = (u16, u32, u64);

/// What the journals of one process state, as far as its inputs depend on it.
enum Event {
    Taken(Number),
    Saved(u64),
    /// The output with this sequence number, for this scan.
    Output(u64, u64),
    /// A journal is missing.
    Gap,
}

/// The journals of one process, up to the output that was asked for last.
struct Process {
    events: Vec<Event>,
    next: usize,
}

/// The inputs of one role, from its first output on.
pub(super) struct Inputs<'a> {
    role: Role,
    drive: &'a ReplayDrive,
    processes: BTreeMap<u32, Process>,
    /// The actuations that count, in the order of their publication, for an estimator without journals.
    actuations: Vec<&'a Actuation>,
    /// What was given already, or is contained in the state that the program continues from.
    given: BTreeSet<Number>,
    /// The scan of the output before.
    last_scan: u64,
    /// The newest actuation that was given.
    actuation: Option<&'a Actuation>,
}

impl<'a> Inputs<'a> {
    /// The inputs of a role.
    pub(super) fn new(role: Role, drive: &'a ReplayDrive) -> Self {
        let counts = |actuation: &&Actuation| drive.counts(Role::Actuator, &actuation.header);
        let mut actuations: Vec<&Actuation> = drive.actuations.samples.iter().filter(counts).collect();
        actuations.sort_by_key(|actuation| (published_ns(actuation), actuation.header.scan_id));
        Self {
            role,
            drive,
            processes: BTreeMap::new(),
            actuations,
            given: BTreeSet::new(),
            last_scan: 0,
            actuation: None,
        }
    }

    /// The scan of the first output after a state.
    pub(super) fn scan_after(&mut self, state: &Checkpoint) -> u64 {
        let (events, place) = self.saved(state);
        place
            .and_then(|place| events[place..].iter().find_map(Event::scan))
            .unwrap_or(state.header.scan_id.saturating_add(1))
    }

    /// From now on, leaves out what a state contains.
    pub(super) fn continue_from(&mut self, state: &Checkpoint) {
        let (events, place) = self.saved(state);
        let contained: Vec<Number> = events[..place.unwrap_or(0)].iter().filter_map(Event::taken).collect();
        let is_actuation = |(topic, ..): &&Number| *topic == Topic::Actuation as u16;
        let newest = contained.iter().rfind(is_actuation);
        self.actuation = newest
            .and_then(|(_, incarnation, sequence)| self.drive.actuations.of_number(*incarnation, *sequence));
        self.given.extend(contained);
    }

    /// What the process of a state did, and where it saved the state.
    fn saved(&mut self, state: &Checkpoint) -> (&[Event], Option<usize>) {
        let Header { incarnation, sequence, .. } = state.header;
        let events = &process(&mut self.processes, self.drive, incarnation).events;
        let is_it = |event: &Event| matches!(event, Event::Saved(saved) if *saved == sequence);
        (events, events.iter().position(is_it))
    }

    /// What the process of an output took for it, in order and each sample once; `None` when a sample was not recorded.
    pub(super) fn of_output(&mut self, header: &Header) -> Option<Vec<Input>> {
        let numbers = self.taken(header).or_else(|| self.by_stamps(header))?;
        let mut inputs = Vec::with_capacity(numbers.len());
        for number in numbers {
            if !self.given.insert(number) {
                continue;
            }
            let (input, is_actuation) = (self.recorded(number)?, number.0 == Topic::Actuation as u16);
            let is_answered = match self.role {
                Role::Estimator => input.topic == Topic::Odometry,
                _ => !is_actuation,
            };
            // What was taken before an output of another process would be answered once more.
            if !is_answered || input.scan_id > self.last_scan {
                inputs.push(input);
            }
            if is_actuation {
                self.actuation = self.drive.actuations.of_number(number.1, number.2);
            }
        }
        self.last_scan = header.scan_id;
        self.repeat_actuation(header.scan_id.saturating_sub(1), &mut inputs);
        Some(inputs)
    }

    /// In lock-step an estimator waits for the answer to the scan before: where there was none, the newest actuation is
    /// repeated under that number.
    fn repeat_actuation(&self, scan_before: u64, inputs: &mut Vec<Input>) {
        if self.role == Role::Estimator
            && let Some(newest) = self.actuation
            && newest.header.scan_id < scan_before
        {
            let header = Header { scan_id: scan_before, ..newest.header };
            let place = inputs.iter().position(|input| input.topic != Topic::Actuation);
            let repeated = Input::of(&Actuation { header, ..*newest });
            inputs.insert(place.unwrap_or(inputs.len()), repeated);
        }
    }

    /// What the journals name; `None` where one is missing.
    fn taken(&mut self, header: &Header) -> Option<Vec<Number>> {
        let process = process(&mut self.processes, self.drive, header.incarnation);
        let rest = &process.events[process.next..];
        let is_it = |event: &Event| matches!(event, Event::Output(output, _) if *output == header.sequence);
        let length = rest.iter().position(is_it)?;
        process.next += length + 1;
        let events = &rest[..length];
        let is_whole = events.iter().all(|event| !matches!(event, Event::Gap));
        is_whole.then(|| events.iter().filter_map(Event::taken).collect())
    }

    /// What fits the stamps of an output.
    fn by_stamps(&self, header: &Header) -> Option<Vec<Number>> {
        let drive = self.drive;
        let mut numbers = match self.role {
            Role::Estimator => self.actuations_before(header),
            _ => Vec::new(),
        };
        let topics = self.role.reads().iter().filter(|topic| **topic != Topic::Actuation);
        for topic in topics {
            numbers.push(match topic {
                Topic::Scan => number(drive.input(&drive.scans, Role::Robot, header)?),
                Topic::Odometry => number(drive.input(&drive.odometries, Role::Robot, header)?),
                Topic::Pose => number(drive.input(&drive.poses, Role::Estimator, header)?),
                Topic::Obstacles => number(drive.input(&drive.obstacles, Role::Obstacles, header)?),
                Topic::Command => number(drive.input(&drive.commands, Role::Controller, header)?),
                _ => return None,
            });
        }
        Some(numbers)
    }

    /// The actuations that were received before the inputs of a pose.
    fn actuations_before(&self, header: &Header) -> Vec<Number> {
        let taken_ns = header.stage(Role::Estimator).taken_ns;
        let is_before = |actuation: &&&Actuation| match self.drive.simulated {
            true => actuation.header.scan_id < header.scan_id,
            false => published_ns(actuation) < taken_ns,
        };
        self.actuations.iter().take_while(is_before).map(|actuation| number(*actuation)).collect()
    }

    fn recorded(&self, (topic, incarnation, sequence): Number) -> Option<Input> {
        let drive = self.drive;
        match Topic::ALL.get(usize::from(topic))? {
            Topic::Scan => drive.scans.of_number(incarnation, sequence).map(Input::of::<Scan>),
            Topic::Odometry => drive.odometries.of_number(incarnation, sequence).map(Input::of::<Odometry>),
            Topic::Pose => drive.poses.of_number(incarnation, sequence).map(Input::of::<Pose>),
            Topic::Obstacles => drive.obstacles.of_number(incarnation, sequence).map(Input::of::<Obstacles>),
            Topic::Command => drive.commands.of_number(incarnation, sequence).map(Input::of::<Command>),
            Topic::Actuation => drive.actuations.of_number(incarnation, sequence).map(Input::of),
            _ => None,
        }
    }
}

/// The journals of a process.
fn process<'p>(
    processes: &'p mut BTreeMap<u32, Process>,
    drive: &ReplayDrive,
    incarnation: u32,
) -> &'p mut Process {
    processes.entry(incarnation).or_insert_with(|| {
        let mut events = Vec::new();
        for (journal, follows) in drive.numbered_journals(incarnation) {
            if !follows {
                events.push(Event::Gap);
            }
            events.extend(journal.used().iter().filter_map(Event::of));
            if journal.output > 0 {
                events.push(Event::Output(journal.output, journal.header.scan_id));
            }
        }
        Process { events, next: 0 }
    })
}

impl Event {
    fn of(entry: &JournalEntry) -> Option<Self> {
        let JournalEntry { kind, topic, incarnation, value } = *entry;
        match JournalKind::try_from(u32::from(kind)) {
            Ok(JournalKind::Taken) => Some(Self::Taken((topic, incarnation, value))),
            Ok(JournalKind::Saved) => Some(Self::Saved(value)),
            _ => None,
        }
    }

    fn taken(&self) -> Option<Number> {
        if let Self::Taken(number) = self { Some(*number) } else { None }
    }

    fn scan(&self) -> Option<u64> {
        if let Self::Output(_, scan_id) = self { Some(*scan_id) } else { None }
    }
}

fn number<S: Sample>(sample: &S) -> Number {
    let Header { incarnation, sequence, .. } = *sample.header();
    (S::TOPIC as u16, incarnation, sequence)
}

fn published_ns(actuation: &Actuation) -> u64 {
    actuation.header.stage(Role::Actuator).published_ns
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::tests::{ESTIMATOR, late_actuation};

    #[test]
    fn inputs_come_in_the_order_in_which_they_were_taken_and_once() {
        let drive = late_actuation();
        let of_scan = |inputs: &mut Inputs<'_>, scan_id| {
            let header = Header { scan_id, sequence: scan_id, incarnation: ESTIMATOR, ..Header::default() };
            let taken = inputs.of_output(&header).expect("all were recorded").into_iter();
            taken.map(|input| (input.topic, input.scan_id)).collect::<Vec<_>>()
        };
        let (odometry, actuation) = (Topic::Odometry, Topic::Actuation);
        let mut inputs = Inputs::new(Role::Estimator, &drive);
        assert_eq!(of_scan(&mut inputs, 1), [(odometry, 1)]);
        assert_eq!(of_scan(&mut inputs, 2), [(odometry, 2)]);
        // In lock-step the program waits for the answer to the scan before, which stands for a newer one.
        assert_eq!(of_scan(&mut inputs, 3), [(actuation, 1), (actuation, 2), (odometry, 3)]);
        assert_eq!(of_scan(&mut inputs, 4), [(actuation, 3), (odometry, 4)]);
        // State 3 contains the actuation, so only its repetition is left.
        let mut inputs = Inputs::new(Role::Estimator, &drive);
        inputs.continue_from(&drive.checkpoints.samples[2]);
        (1..=2).for_each(|scan_id| assert_eq!(of_scan(&mut inputs, scan_id), []));
        assert_eq!(of_scan(&mut inputs, 3), [(actuation, 2), (odometry, 3)]);
    }
}
