//! The error bound holds for simulated devices with drift, jitter, gaps, wraps, jumps and restarts.

use device_clock::{ClockEvent, ClockSettings, DeviceClock};
use proptest::prelude::*;

const MS: u64 = 1_000_000;
const SECOND: u64 = 1_000 * MS;
/// When a simulated host is switched on; any time will do [ns].
const START_NS: u64 = 77 * SECOND;

/// A scanner with a drifting counter of milliseconds, and a line with jitter.
struct Device {
    drift: f64,
    delay_ns: u64,
    /// Counter at the start [ms].
    first_ms: u64,
    random: u64,
    jitter: fn(&mut Device) -> u64,
    arrived_ns: u64,
}

impl Device {
    fn new(seed: u64, drift_ppm: f64, first_ms: u64, jitter: fn(&mut Device) -> u64) -> Self {
        let random = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        Self { drift: drift_ppm * 1e-6, delay_ns: 71 * MS, first_ms, random, jitter, arrived_ns: START_NS }
    }

    /// Uniform in [0, 1).
    fn uniform(&mut self) -> f64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// The counter at a time of the host, wrapped.
    fn ticks(&self, time_ns: u64) -> u64 {
        let ran_ns = (time_ns - START_NS) as f64 * (1.0 + self.drift);
        (self.first_ms + (ran_ns * 1e-6) as u64) % (1 << 24)
    }

    /// Asks for the time ten times, as a driver does before it switches the laser on.
    fn synchronise(&mut self, clock: &mut DeviceClock, at_ns: u64) {
        for number in 0..10 {
            let sent_ns = at_ns + number * 20 * MS;
            let there_ns = sent_ns + (self.uniform() * 2e6) as u64;
            let received_ns = there_ns + (self.uniform() * 2e6) as u64;
            assert_eq!(clock.round_trip(self.ticks(there_ns), sent_ns, received_ns), ClockEvent::Regular);
        }
    }

    /// Delivers a scan stamped at `stamped_ns`; arrivals keep their order. Returns the error, its bound and the event.
    fn deliver(&mut self, clock: &mut DeviceClock, stamped_ns: u64) -> (u64, u64, ClockEvent) {
        let jitter = self.jitter;
        let delayed_ns = stamped_ns + self.delay_ns + jitter(self);
        self.arrived_ns = self.arrived_ns.max(delayed_ns);
        let mapped = clock.arrival(self.ticks(stamped_ns), self.arrived_ns);
        assert!(mapped.time_ns <= self.arrived_ns);
        (mapped.time_ns.abs_diff(stamped_ns), mapped.error_ns, mapped.event)
    }
}

/// A quiet machine: below 0.2 ms, one in a hundred up to 20 ms.
fn quiet(device: &mut Device) -> u64 {
    let scale = if device.uniform() < 0.01 { 20e6 } else { 0.2e6 };
    (device.uniform() * scale) as u64
}

/// As recorded on a rover whose program polled its scanner: anywhere in 50 ms, rarely 250 ms.
fn as_recorded(device: &mut Device) -> u64 {
    let scale = if device.uniform() < 0.003 { 250e6 } else { 50e6 };
    (device.uniform() * scale) as u64
}

/// Drives five hours at 10 Hz. With gaps some scans are missing, now and then for minutes.
fn five_hours(mut device: Device, gaps: bool) -> Result<Vec<u64>, TestCaseError> {
    let mut clock = DeviceClock::new(ClockSettings::milliseconds_of_24_bits());
    device.synchronise(&mut clock, START_NS);
    let mut errors = Vec::new();
    let mut stamped_ns = START_NS + SECOND;
    while stamped_ns < START_NS + 5 * 3600 * SECOND {
        let (error_ns, bound_ns, event) = device.deliver(&mut clock, stamped_ns);
        prop_assert!(error_ns <= bound_ns, "{error_ns} > {bound_ns} at {stamped_ns}");
        prop_assert_eq!(event, ClockEvent::Regular);
        errors.push(bound_ns);
        let lost = match device.uniform() {
            // The delay is measured in the first minute.
            _ if !gaps || errors.len() < 600 => 0,
            chance if chance < 0.0001 => 3_000,
            chance if chance < 0.01 => 3,
            _ => 0,
        };
        stamped_ns += (1 + lost) * 98_022_000;
    }
    errors.sort_unstable();
    Ok(errors)
}

/// Simulated hours are long: fewer cases than usual, unless `PROPTEST_CASES` asks for more.
fn cases(few: u32) -> u32 {
    if std::env::var_os("PROPTEST_CASES").is_some() { ProptestConfig::default().cases } else { few }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(12), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_bound_holds_over_five_hours(
        seed in 1_u64..1_000_000, drift_ppm in -150.0..150.0, first_ms in 0_u64..1 << 24, gaps: bool,
    ) {
        let bounds = five_hours(Device::new(seed, drift_ppm, first_ms, quiet), gaps)?;
        // Half of the round trip of 2 ms, 1 ms, and 200 ppm of ten seconds at most.
        prop_assert!(bounds[bounds.len() / 2] < 6 * MS, "{}", bounds[bounds.len() / 2]);
    }

    #[test]
    fn the_bound_holds_with_jitter_as_recorded(
        seed in 1_u64..1_000_000, drift_ppm in -150.0..150.0, first_ms in 0_u64..1 << 24, gaps: bool,
    ) {
        let bounds = five_hours(Device::new(seed, drift_ppm, first_ms, as_recorded), gaps)?;
        prop_assert!(bounds[bounds.len() / 20] < 15 * MS, "{}", bounds[bounds.len() / 20]);
    }

    #[test]
    fn any_stamps_and_times_are_mapped_without_panic(
        samples in prop::collection::vec((any::<u64>(), any::<u64>(), any::<u64>(), any::<bool>()), 1..60),
        wraps: bool,
    ) {
        let kind = if wraps { ClockSettings::milliseconds_of_24_bits() } else { ClockSettings::nanoseconds() };
        let mut clock = DeviceClock::new(kind);
        for (ticks, sent_ns, arrived_ns, asks) in samples {
            if asks {
                clock.round_trip(ticks, sent_ns, arrived_ns);
            }
            let mapped = clock.arrival(ticks, arrived_ns);
            prop_assert!(mapped.time_ns <= arrived_ns);
            clock.map(ticks, sent_ns);
        }
    }
}

/// Delivers scans for `seconds`, and returns the events that are not regular.
fn drive(device: &mut Device, clock: &mut DeviceClock, from_ns: u64, seconds: u64) -> Vec<ClockEvent> {
    let mut events = Vec::new();
    for number in 0..seconds * 10 {
        let (error_ns, bound_ns, event) = device.deliver(clock, from_ns + number * 100 * MS);
        let is_used = event != ClockEvent::Overtaken;
        assert!(!is_used || error_ns <= bound_ns, "{error_ns} > {bound_ns} in scan {number}");
        if event != ClockEvent::Regular {
            events.push(event);
        }
    }
    events
}

fn synchronised() -> (Device, DeviceClock) {
    synchronised_with(ClockSettings::milliseconds_of_24_bits())
}

/// The counter of a Hokuyo scanner on a line on which messages overtake each other.
fn overtaking() -> ClockSettings {
    ClockSettings { max_overtaken_ns: SECOND, ..ClockSettings::milliseconds_of_24_bits() }
}

fn synchronised_with(settings: ClockSettings) -> (Device, DeviceClock) {
    let mut device = Device::new(5, 40.0, 1_000_000, quiet);
    let mut clock = DeviceClock::new(settings);
    device.synchronise(&mut clock, START_NS);
    assert_eq!(drive(&mut device, &mut clock, START_NS + SECOND, 90), []);
    (device, clock)
}

#[test]
fn the_drift_is_estimated() {
    let (_, clock) = synchronised();
    assert!((clock.drift_ppm() + 40.0).abs() < 10.0, "{}", clock.drift_ppm());
    let delay_ns = clock.measured_delay_ns().unwrap();
    assert!((delay_ns - 71 * MS as i64).abs() < 2 * MS as i64, "{delay_ns}");
}

#[test]
fn a_restart_of_the_device_is_seen_at_once() {
    let (mut device, mut clock) = synchronised();
    device.first_ms = 0;
    device.first_ms = (1 << 24) - (device.ticks(START_NS + 91 * SECOND) - 3);
    assert_eq!(drive(&mut device, &mut clock, START_NS + 91 * SECOND, 60), [ClockEvent::Backwards]);
}

/// A line on which messages overtake each other: each takes 20 to 60 ms, whatever the others take.
#[test]
fn messages_that_overtake_each_other_are_told_and_change_nothing() {
    let mut device = Device::new(7, 40.0, 1_000_000, quiet);
    let mut clock = DeviceClock::new(ClockSettings { delay_ns: 20 * MS, ..overtaking() });
    let delayed = |number: u64| START_NS + number * 20 * MS + 20 * MS + (device.uniform() * 40e6) as u64;
    let mut arrivals: Vec<(u64, u64)> = (0..20_000).map(delayed).zip(0..).collect();
    arrivals.sort_unstable();
    let (mut newest, mut overtaken) = (0, 0);
    for (arrived_ns, number) in arrivals {
        let stamped_ns = START_NS + number * 20 * MS;
        let mapped = clock.arrival(device.ticks(stamped_ns), arrived_ns);
        assert_eq!(
            mapped.event == ClockEvent::Overtaken,
            number < newest,
            "{number} after {newest}: {mapped:?}"
        );
        assert!(mapped.time_ns.abs_diff(stamped_ns) <= mapped.error_ns, "{number}: {mapped:?}");
        newest = newest.max(number);
        overtaken += u64::from(mapped.event == ClockEvent::Overtaken);
    }
    assert!(overtaken > 2_000, "{overtaken}");
}

#[test]
fn a_clock_that_is_set_back_is_seen_after_half_a_second() {
    for back_ms in [150, 300, 1_000, 10_000] {
        let (mut device, mut clock) = synchronised_with(overtaking());
        device.first_ms -= back_ms;
        let events = drive(&mut device, &mut clock, START_NS + 91 * SECOND, 60);
        // Until then what came before seems newer, and after that it seems late.
        let (last, dropped) = events.split_last().expect("an event");
        assert_eq!(*last, ClockEvent::Backwards, "{back_ms} ms: {events:?}");
        let is_overtaken = dropped.iter().all(|event| *event == ClockEvent::Overtaken);
        assert!(is_overtaken && (1..=7).contains(&dropped.len()), "{back_ms} ms: {events:?}");
        assert!(clock.is_settled(), "{back_ms} ms: the mapping is one again");
    }
}

#[test]
fn a_jump_ahead_is_seen_at_once() {
    let (mut device, mut clock) = synchronised();
    device.first_ms += 5_000;
    let events = drive(&mut device, &mut clock, START_NS + 91 * SECOND, 60);
    let [ClockEvent::Jumped(by_ns)] = events[..] else { panic!("{events:?}") };
    assert!((by_ns - 5_000_000_000).abs() < 2 * MS as i64, "{by_ns}");
}

#[test]
fn a_small_jump_back_is_seen_after_five_seconds_and_its_bounds_are_wide_until_then() {
    let (mut device, mut clock) = synchronised();
    device.first_ms -= 60;
    let events = drive(&mut device, &mut clock, START_NS + 91 * SECOND, 60);
    let [ClockEvent::Jumped(by_ns)] = events[..] else { panic!("{events:?}") };
    assert!((by_ns + 60_000_000).abs() < 21 * MS as i64, "{by_ns}");
}

#[test]
fn without_round_trips_the_delay_is_a_setting() {
    let mut device = Device::new(9, -80.0, 0, quiet);
    let known = ClockSettings { delay_ns: 71 * MS, ..ClockSettings::milliseconds_of_24_bits() };
    assert_eq!(drive(&mut device, &mut DeviceClock::new(known), START_NS, 600), []);
}

#[test]
fn a_delay_that_differs_from_the_setting_is_found() {
    let mut device = Device::new(9, -80.0, 0, quiet);
    let wrong = ClockSettings { delay_ns: 50 * MS, ..ClockSettings::milliseconds_of_24_bits() };
    let mut clock = DeviceClock::new(wrong);
    let outside = (0..600).filter(|number| {
        let (error_ns, bound_ns, _) = device.deliver(&mut clock, START_NS + number * 100 * MS);
        error_ns > bound_ns
    });
    let count = outside.count();
    assert!(count > 200, "the bound is narrow enough to show a wrong delay: {count} of 600");
}

/// Devices whose fastest samples differ so much that the bound would be too small without that difference.
#[test]
fn the_bound_contains_what_the_fastest_samples_differ_by() {
    for (seed, drift_ppm, gaps) in [
        (693_807, -149.037_514_352_056_15, true),
        (341_287, -139.904_677_014_121_32, false),
        (269_447, -144.076_585_126_603_56, false),
    ] {
        five_hours(Device::new(seed, drift_ppm, 0, as_recorded), gaps).expect("the bound holds");
    }
}
