//! The mapping: stamps and arrivals in, times on CLOCK_MONOTONIC out.

use crate::counter::{Counter, Order};
use crate::envelope::{Envelope, Line, SETTLED};
use crate::set_back::SetBack;
use crate::settings::ClockSettings;

/// Times after this are taken as this: 73 years, so that no sum of times overflows [ns].
const MAX_TIME_NS: u64 = 1 << 61;
/// Mappings of one clock differ by less: it is the longest delay of a message [ns].
const MAX_APART_NS: u64 = 1_000_000_000;
/// All samples of this time, and at least [`SUSPECTED`], are late before a jump of the device's clock is assumed [ns].
const SUSPECTED_NS: u64 = 5_000_000_000;
/// See [`SUSPECTED_NS`].
const SUSPECTED: u32 = 20;

/// What a stamp shows about the clock of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ClockEvent {
    /// As expected, also when it arrived late.
    Regular,
    /// Before the newest stamp: the sample was overtaken by others. Its time is right, and it is to be dropped.
    Overtaken,
    /// So far before the newest stamp that no delay explains it: the device was restarted, or its clock was set back.
    Backwards,
    /// The clock of the device jumped by this time; positive is forwards [ns].
    Jumped(i64),
}

/// A stamp on CLOCK_MONOTONIC.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mapped {
    /// Its time, never after its arrival [ns].
    pub time_ns: u64,
    /// The true time is at most this far away [ns].
    pub error_ns: u64,
    /// What the stamp shows about the clock of the device.
    pub event: ClockEvent,
}

/// Offset between the clocks from round trips: between `low_ns` and `high_ns`.
#[derive(Debug, Clone, Copy)]
struct Reference {
    low_ns: i64,
    high_ns: i64,
    at_ns: u64,
}

impl Reference {
    fn middle_ns(&self) -> i64 {
        self.low_ns + (self.high_ns - self.low_ns) / 2
    }

    fn error_ns(&self) -> u64 {
        (self.high_ns - self.low_ns).unsigned_abs() / 2
    }

    /// What both allow; `None` if they contradict each other.
    fn and(&self, older: &Self, aged_ns: u64) -> Option<Self> {
        let aged_ns = aged_ns.cast_signed();
        let low_ns = self.low_ns.max(older.low_ns.saturating_sub(aged_ns));
        let high_ns = self.high_ns.min(older.high_ns.saturating_add(aged_ns));
        (low_ns <= high_ns).then_some(Self { low_ns, high_ns, at_ns: self.at_ns })
    }
}

/// Smallest delay from stamp to arrival.
#[derive(Debug, Clone, Copy)]
struct Delay {
    ns: i64,
    error_ns: u64,
    is_measured: bool,
}

/// Samples in a row that are late by more than [`ClockSettings::jump_ns`].
#[derive(Debug, Clone, Copy)]
struct LateRun {
    since_ns: u64,
    count: u32,
    /// The one with the smallest arrival minus stamp.
    arrived_ns: u64,
    offset_ns: i64,
}

/// Maps the stamps of one device to CLOCK_MONOTONIC. Makes no allocation.
#[derive(Debug, Clone)]
pub struct DeviceClock {
    settings: ClockSettings,
    counter: Counter,
    envelope: Envelope,
    reference: Option<Reference>,
    delay: Delay,
    samples: u32,
    late: Option<LateRun>,
    set_back: SetBack,
}

impl DeviceClock {
    /// A clock of which nothing is known yet.
    pub fn new(settings: ClockSettings) -> Self {
        Self {
            settings,
            counter: Counter::new(&settings),
            envelope: Envelope::new(settings.max_drift_ppm),
            reference: None,
            delay: Delay {
                ns: settings.delay_ns.cast_signed(),
                error_ns: settings.delay_error_ns,
                is_measured: false,
            },
            samples: 0,
            late: None,
            set_back: SetBack::default(),
        }
    }

    /// Takes a round trip: the host asked at `sent_ns`, the device answered with `ticks`, the answer arrived at
    /// `received_ns`. Of several round trips the shortest ones count.
    pub fn round_trip(&mut self, ticks: u64, sent_ns: u64, received_ns: u64) -> ClockEvent {
        let (sent_ns, received_ns) = (sent_ns.min(MAX_TIME_NS), received_ns.min(MAX_TIME_NS));
        let stamp_ns = self.counter.extend(ticks, received_ns);
        let event = match self.counter.keep(stamp_ns, received_ns) {
            Order::Newest => ClockEvent::Regular,
            Order::Overtaken => return ClockEvent::Overtaken,
            Order::Restarted => self.restart(ClockEvent::Backwards),
        };
        let offset_at = |time_ns: u64| time_ns.cast_signed().saturating_sub(stamp_ns);
        let low_ns = offset_at(sent_ns).saturating_sub(self.settings.resolution_ns.cast_signed());
        let new = Reference { low_ns, high_ns: offset_at(received_ns.max(sent_ns)), at_ns: received_ns };
        let Some(older) = self.reference else {
            self.reference = Some(new);
            return event;
        };
        let merged = new.and(&older, self.drifted_ns(received_ns.abs_diff(older.at_ns)));
        let by_ns = older.middle_ns().saturating_sub(new.middle_ns());
        let event = if merged.is_some() { event } else { self.restart(ClockEvent::Jumped(by_ns)) };
        self.reference = Some(merged.unwrap_or(new));
        self.measure_delay();
        event
    }

    /// Takes the stamp of data that arrived at `arrived_ns`, and maps it. Arrivals must not go back in time.
    pub fn arrival(&mut self, ticks: u64, arrived_ns: u64) -> Mapped {
        let arrived_ns = arrived_ns.min(MAX_TIME_NS);
        let stamp_ns = self.counter.extend(ticks, arrived_ns);
        let offset_ns = arrived_ns.cast_signed().saturating_sub(stamp_ns);
        let order = self.counter.keep(stamp_ns, arrived_ns);
        let mut event = match order {
            Order::Newest | Order::Overtaken if self.is_set_back(offset_ns, arrived_ns, order) => {
                self.counter.begin_at(stamp_ns, arrived_ns);
                self.restart(ClockEvent::Backwards)
            }
            Order::Newest => ClockEvent::Regular,
            Order::Overtaken => {
                let (time_ns, error_ns) = self.mapped(stamp_ns, arrived_ns);
                return Mapped { time_ns: time_ns.min(arrived_ns), error_ns, event: ClockEvent::Overtaken };
            }
            Order::Restarted => self.restart(ClockEvent::Backwards),
        };
        let excess_ns = self.excess_ns(offset_ns, arrived_ns);
        if self.is_ahead(stamp_ns, excess_ns, arrived_ns) {
            event = self.restart(ClockEvent::Jumped(excess_ns.saturating_neg()));
        }
        self.envelope.add(arrived_ns, offset_ns);
        self.samples = self.samples.saturating_add(1);
        event = self.suspect(offset_ns, excess_ns, arrived_ns).unwrap_or(event);
        // Again when the drift is known, which makes older samples useful.
        if self.samples.is_multiple_of(SETTLED) {
            self.measure_delay();
        }
        // Late data, or a clock that has just jumped back: the bound covers both until that is known.
        let late_ns = if self.late.is_some() { excess_ns.unsigned_abs() } else { 0 };
        let (time_ns, error_ns) = self.mapped(stamp_ns, arrived_ns);
        Mapped { time_ns: time_ns.min(arrived_ns), error_ns: error_ns.saturating_add(late_ns), event }
    }

    /// As [`Self::arrival`], where `other` maps other data of the same clock, whose smallest delay may be seen earlier: the
    /// smaller of both counts. With a mapping each, what was stamped at once would get two times until both have settled.
    pub fn arrival_beside(&mut self, other: &Self, ticks: u64, arrived_ns: u64) -> Mapped {
        let own = self.arrival(ticks, arrived_ns);
        let earlier = other.map(ticks, arrived_ns).filter(|other| other.time_ns < own.time_ns);
        // Further apart they are only while one of both knows of a restart.
        match earlier.filter(|other| own.time_ns - other.time_ns < MAX_APART_NS) {
            Some(other) => Mapped { event: own.event, ..other },
            None => own,
        }
    }

    /// Maps a stamp without its arrival, as that of other data of the same device; `now_ns` is the present.
    /// `None` before the first sample.
    pub fn map(&self, ticks: u64, now_ns: u64) -> Option<Mapped> {
        if self.samples == 0 && self.reference.is_none() {
            return None;
        }
        let now_ns = now_ns.min(MAX_TIME_NS);
        let (time_ns, error_ns) = self.mapped(self.counter.extend(ticks, now_ns), now_ns);
        Some(Mapped { time_ns, error_ns, event: ClockEvent::Regular })
    }

    /// Estimated drift: growth of CLOCK_MONOTONIC minus device per time [ppm].
    pub fn drift_ppm(&self) -> f64 {
        self.envelope.drift_ppm()
    }

    /// Smallest delay from stamp to arrival, `None` while no round trip has shown it [ns].
    pub fn measured_delay_ns(&self) -> Option<i64> {
        self.delay.is_measured.then_some(self.delay.ns)
    }

    /// Whether enough samples were seen since the start, or since the last restart or jump of the device's clock.
    pub fn is_settled(&self) -> bool {
        self.samples >= SETTLED
    }

    /// Forgets the offset between the clocks. Drift and smallest delay belong to the device, and stay.
    fn restart(&mut self, event: ClockEvent) -> ClockEvent {
        self.envelope.clear();
        self.reference = None;
        self.samples = 0;
        self.late = None;
        event
    }

    /// Whether the clock of the device was set back, by less than what overtaking explains.
    fn is_set_back(&mut self, offset_ns: i64, arrived_ns: u64, order: Order) -> bool {
        let excess_ns = self.excess_ns(offset_ns, arrived_ns);
        let spread_ns = self.settings.jump_ns.cast_signed();
        self.set_back.decides([offset_ns, excess_ns], arrived_ns, order == Order::Overtaken, spread_ns)
    }

    /// Whether the clock of the device has jumped ahead: data can't arrive before they are stamped.
    fn is_ahead(&self, stamp_ns: i64, excess_ns: i64, arrived_ns: u64) -> bool {
        if self.is_settled() {
            return excess_ns < -self.jump_ns(arrived_ns).cast_signed();
        }
        let (time_ns, error_ns) = self.mapped(stamp_ns, arrived_ns);
        time_ns > arrived_ns.saturating_add(error_ns)
    }

    /// Smallest deviation that drift does not explain [ns].
    fn jump_ns(&self, time_ns: u64) -> u64 {
        let age_ns = self.envelope.at(time_ns).map_or(0, |line| line.age_ns);
        self.settings.jump_ns.saturating_add(self.drifted_ns(age_ns))
    }

    /// Arrival minus stamp, compared with the smallest one [ns].
    fn excess_ns(&self, offset_ns: i64, time_ns: u64) -> i64 {
        self.envelope.at(time_ns).map_or(0, |line| offset_ns.saturating_sub(line.offset_ns))
    }

    /// Follows samples that are late in a row; when all are for long, the clock of the device has jumped back.
    fn suspect(&mut self, offset_ns: i64, excess_ns: i64, arrived_ns: u64) -> Option<ClockEvent> {
        if excess_ns <= self.jump_ns(arrived_ns).cast_signed() {
            self.late = None;
            return None;
        }
        let first = LateRun { since_ns: arrived_ns, count: 0, arrived_ns, offset_ns };
        let run = self.late.get_or_insert(first);
        run.count += 1;
        if offset_ns <= run.offset_ns {
            (run.arrived_ns, run.offset_ns) = (arrived_ns, offset_ns);
        }
        let run = *run;
        if run.count < SUSPECTED || arrived_ns.saturating_sub(run.since_ns) < SUSPECTED_NS {
            return None;
        }
        let event = self.restart(ClockEvent::Jumped(excess_ns.saturating_neg()));
        self.envelope.add(run.arrived_ns, run.offset_ns);
        self.samples = run.count;
        Some(event)
    }

    /// Compares samples and round trips, if that is more exact than what is known.
    fn measure_delay(&mut self) {
        let Some(reference) = self.reference.filter(|_| self.is_settled()) else { return };
        let lines = [self.envelope.at(reference.at_ns), self.envelope.at_start(reference.at_ns)];
        let Some(line) = lines.into_iter().flatten().min_by_key(|line| line.age_ns) else { return };
        let error_ns = reference.error_ns() + self.drifted_ns(line.age_ns);
        if !self.delay.is_measured || error_ns < self.delay.error_ns {
            let ns = line.offset_ns.saturating_sub(reference.middle_ns());
            self.delay = Delay { ns, error_ns, is_measured: true };
        }
    }

    /// Time of a stamp, and its error bound [ns].
    fn mapped(&self, stamp_ns: i64, now_ns: u64) -> (u64, u64) {
        let (offset_ns, error_ns) = self.offset(now_ns);
        let half_tick_ns = (self.settings.resolution_ns / 2).cast_signed();
        let time_ns = stamp_ns.saturating_add(offset_ns).saturating_add(half_tick_ns);
        (u64::try_from(time_ns).unwrap_or(0), error_ns.saturating_add(self.settings.resolution_ns))
    }

    /// Offset between the clocks, and its error bound [ns].
    fn offset(&self, now_ns: u64) -> (i64, u64) {
        match (self.reference, self.envelope.at(now_ns)) {
            // The smallest delay is not known yet.
            (Some(reference), line) if line.is_none() || !self.is_settled() => {
                let age_ns = now_ns.abs_diff(reference.at_ns);
                (reference.middle_ns(), reference.error_ns() + self.drifted_ns(age_ns))
            }
            (_, Some(Line { offset_ns, age_ns, spread_ns })) => {
                let unsettled_ns = if self.is_settled() { 0 } else { self.settings.jitter_ns };
                let error_ns = self.delay.error_ns + self.drifted_ns(age_ns) + spread_ns + unsettled_ns;
                (offset_ns.saturating_sub(self.delay.ns), error_ns)
            }
            (_, None) => (0, u64::MAX / 4),
        }
    }

    /// Largest drift in a time [ns].
    fn drifted_ns(&self, age_ns: u64) -> u64 {
        (age_ns as f64 * self.settings.max_drift_ppm * 1e-6) as u64
    }
}
