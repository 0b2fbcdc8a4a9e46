//! A topic under observation, and how many of its samples were published meanwhile.

use console::exit::Failure;
use runtime::{
    Bus, Domain, Observer, OwnObserver, OwnTopics, Priority, RuntimeError, Shutdown, monotonic_ns, print,
    wait_for,
};
use shared_types::{
    Actuation, Checkpoint, ClockOffset, Command, Directive, Field, Header, Heartbeat, Journal, MAX_NUMBER,
    Obstacles, Odometry, Pose, Sample, Scan, Topic, Truth, did_you_mean, require_sequence,
};
use supervision::lock::Standstill;

/// Longest sleep between two polls of a topic; a buffer of 16 samples lasts longer than this at 500 Hz.
const POLL_NS: u64 = 20_000_000;

/// Time between two looks at the system itself: whether it has ended, or its orchestrator stands still [ns].
const CHECK_NS: u64 = 200_000_000;

/// Returns the bytes of the next sample of a topic.
type NextSample = Box<dyn FnMut() -> Result<Option<Vec<u8>>, RuntimeError>>;

/// A topic under observation, of any type.
pub(super) struct Watch {
    /// Of its samples.
    pub(super) fields: &'static [Field],
    /// Whether its samples are numbered by one process.
    is_numbered: bool,
    next: NextSample,
    shutdown: Shutdown,
    pub(super) count: Count,
    domain: Domain,
    _bus: Bus,
    standstill: Standstill,
    next_check_ns: u64,
    /// Whether the system has ended.
    pub(super) has_ended: bool,
}

/// Writers of a topic that are told apart: those in charge, candidates and those that are ending.
const MAX_WRITERS: usize = 16;

/// How many samples of a topic were published while it was observed.
#[derive(Debug, Clone, Default)]
pub(super) struct Count {
    /// That arrived here.
    seen: u64,
    /// That did not, by the numbers of those that did.
    lost: u64,
    /// That have a number that they can't have.
    impossible: u64,
    /// Incarnation and newest number of each writer, the latest last, and when it came [ns].
    writers: Vec<(u32, u64, u64)>,
}

impl Count {
    /// Counts a sample of a topic that each writer numbers without gaps.
    fn add(&mut self, header: &Header, now_ns: u64) {
        self.seen += 1;
        let Header { incarnation, sequence, .. } = *header;
        let known = self.writers.iter().position(|(of, ..)| *of == incarnation);
        let (newest, since_ns) = match known.map(|index| self.writers.remove(index)) {
            Some((_, newest, at_ns)) => (newest, at_ns),
            None => (sequence.saturating_sub(1), 0),
        };
        let is_possible = require_sequence(sequence, newest, now_ns.saturating_sub(since_ns)).is_ok()
            && sequence <= MAX_NUMBER;
        if is_possible {
            self.lost += sequence.saturating_sub(newest).saturating_sub(1);
        } else {
            self.impossible += 1;
        }
        if self.writers.len() == MAX_WRITERS {
            self.writers.remove(0);
        }
        if is_possible || known.is_some() {
            self.writers.push((incarnation, if is_possible { sequence } else { newest }, now_ns));
        }
    }

    /// Samples published per second since an earlier count, seen or not.
    pub(super) fn rate_hz(&self, before: &Self, elapsed_ns: u64) -> f64 {
        let published = (self.seen + self.lost).saturating_sub(before.seen + before.lost);
        published as f64 / (elapsed_ns.max(1) as f64 * 1e-9)
    }
}

impl std::fmt::Display for Count {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{} samples seen, {} lost", self.seen, self.lost)?;
        if self.impossible > 0 {
            write!(formatter, ", {} with an impossible number", self.impossible)?;
        }
        Ok(())
    }
}

impl Watch {
    /// The topic of that name of a running system.
    pub(super) fn open(system_id: &str, topic: &str) -> anyhow::Result<Self> {
        let of_loop = topic.parse::<Topic>();
        let found = supervision::runs::existing(system_id);
        let domain = match &of_loop {
            Ok(_) => found?,
            // Only a running system has other topics.
            Err(unknown) => found.map_err(|_| Failure::bad_input(unknown))?,
        };
        let own = OwnTopics::of(&domain)?.filter(|own| own.find(topic).is_some());
        let bus = Bus::open(&domain, "observer")?;
        if let Some(own) = own {
            return Self::own((domain, bus), &own, topic);
        }
        let topic = of_loop.map_err(|unknown| {
            let own = OwnTopics::of(&domain).ok().flatten().map_or_else(Vec::new, |own| own.topic);
            let names: Vec<&str> = own.iter().map(|row| row.name.as_str()).collect();
            let meant = did_you_mean(topic, names.iter().copied());
            let of_file = format!("; the system file adds {}.{meant}", names.join(", "));
            Failure::bad_input(format!("{unknown}{}", if names.is_empty() { "" } else { &of_file }))
        })?;
        fn of<S: Sample>(bus: &Bus) -> Result<NextSample, RuntimeError> {
            let observer = Observer::<S>::new(bus)?;
            Ok(Box::new(move || Ok(observer.next()?.map(|(sample, _)| bytemuck::bytes_of(&sample).to_vec()))))
        }
        let next = match topic {
            Topic::Scan => of::<Scan>(&bus),
            Topic::Odometry => of::<Odometry>(&bus),
            Topic::Pose => of::<Pose>(&bus),
            Topic::Obstacles => of::<Obstacles>(&bus),
            Topic::Command => of::<Command>(&bus),
            Topic::Actuation => of::<Actuation>(&bus),
            Topic::Heartbeat => of::<Heartbeat>(&bus),
            Topic::Directive => of::<Directive>(&bus),
            Topic::Checkpoint => of::<Checkpoint>(&bus),
            Topic::Truth => of::<Truth>(&bus),
            Topic::Journal => of::<Journal>(&bus),
            Topic::Clock => of::<ClockOffset>(&bus),
        }?;
        Self::of((domain, bus), topic.fields(), topic.writer().is_some(), next)
    }

    /// A topic that the system file added.
    fn own(system: (Domain, Bus), own: &OwnTopics, topic: &str) -> anyhow::Result<Self> {
        let observer = OwnObserver::new(&system.1, own, topic)?;
        let fields = observer.own_type().fields();
        Self::of(system, fields, true, Box::new(move || observer.next()))
    }

    fn of(
        (domain, bus): (Domain, Bus),
        fields: &'static [Field],
        is_numbered: bool,
        next: NextSample,
    ) -> anyhow::Result<Self> {
        Ok(Self {
            fields,
            is_numbered,
            next,
            shutdown: Shutdown::on_signals()?,
            count: Count::default(),
            domain,
            _bus: bus,
            standstill: Standstill::default(),
            next_check_ns: 0,
            has_ended: false,
        })
    }

    /// Sleeps until the next poll; false when the user wants to end, or the system has ended.
    pub(super) fn sleep(&mut self) -> bool {
        wait_for(&[self.shutdown.descriptor()], POLL_NS);
        let now_ns = monotonic_ns();
        if now_ns >= self.next_check_ns && !self.has_ended {
            self.next_check_ns = now_ns + CHECK_NS;
            if let Some(change) = self.standstill.change(&self.domain) {
                print(Priority::Warning, &change);
            }
            self.has_ended = !self.domain.is_current();
            if self.has_ended {
                print(Priority::Warning, &format!("system `{}` has ended", self.domain.system_id()));
                // What it published last.
                return true;
            }
        }
        !self.has_ended && !self.shutdown.requested()
    }

    /// Passes the bytes of the samples that have arrived to `each` until it returns false.
    pub(super) fn poll(&mut self, each: &mut impl FnMut(&[u8]) -> bool) -> anyhow::Result<()> {
        let now_ns = monotonic_ns();
        while let Some(bytes) = (self.next)()? {
            let header: Header = bytemuck::pod_read_unaligned(&bytes[..size_of::<Header>()]);
            match self.is_numbered {
                true => self.count.add(&header, now_ns),
                false => self.count.seen += 1,
            }
            if !each(&bytes) {
                break;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_counts_what_was_published_not_what_was_seen() {
        let header = |incarnation, sequence| Header { incarnation, sequence, ..Header::default() };
        let mut count = Count::default();
        // Of 1,000 samples in a second, every fifth is seen; two writers, one of which starts at 7.
        (1..=100).for_each(|index| count.add(&header(1, 5 * index), 10_000_000 * index));
        (0..100).for_each(|index| count.add(&header(2, 7 + 5 * index), 10_000_000 * index));
        assert_eq!((count.seen, count.lost, count.impossible), (200, 4 * 99 + 4 * 99, 0));
        assert_eq!(count.rate_hz(&Count::default(), 1_000_000_000), 992.0);
        let before = count.clone();
        for wrong in [1 << 63, u64::MAX, 1 << 47] {
            count.add(&header(1, wrong), 1_000_000_000);
        }
        count.add(&header(9, u64::MAX), 1_000_000_000);
        count.add(&header(1, 501), 1_010_000_000);
        assert_eq!((count.lost - before.lost, count.impossible), (0, 4));
        assert_eq!(count.to_string(), "205 samples seen, 792 lost, 4 with an impossible number");
        for incarnation in 0..1_000 {
            count.add(&header(incarnation, 1), 2_000_000_000);
        }
        assert!(count.writers.len() <= MAX_WRITERS);
    }
}
