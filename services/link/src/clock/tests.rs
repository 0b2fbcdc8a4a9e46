//! The clock against simulated hosts.

use super::*;

const DAY_NS: f64 = 86_400e9;

/// Two hosts whose clocks differ by an offset and a rate, and a way between them.
struct Hosts {
    offset_ns: f64,
    rate: f64,
    random: u64,
}

impl Hosts {
    fn truth(&self, now_ns: u64) -> f64 {
        self.offset_ns + self.rate * now_ns as f64
    }

    fn uniform(&mut self) -> f64 {
        self.random =
            self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.random >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A way of `least_ns` and an exponential delay of this mean.
    fn way_ns(&mut self, least_ns: f64, mean_ns: f64) -> f64 {
        least_ns - mean_ns * (1.0 - self.uniform()).ln()
    }

    fn probe(&mut self, now_ns: u64, least_ns: f64, mean_ns: f64) -> Probe {
        let arrived_ns = now_ns + self.way_ns(least_ns, mean_ns) as u64;
        let left_ns = arrived_ns + 20_000;
        let returned_ns = left_ns + self.way_ns(least_ns, mean_ns) as u64;
        let there = |at_ns: u64| (at_ns as f64 + self.truth(at_ns)) as u64;
        Probe { sent_ns: now_ns, received_ns: there(arrived_ns), answered_ns: there(left_ns), returned_ns }
    }
}

/// The largest error beyond its bound and the largest bound over a time, ten probes a second [ns].
fn follow(hosts: &mut Hosts, clock: &mut HostClock, from_s: u64, until_s: u64, mean_ns: f64) -> (f64, u64) {
    let (mut beyond_ns, mut largest_ns) = (f64::MIN, 0);
    for tenth in from_s * 10..until_s * 10 {
        let now_ns = 1_000_000_000 + tenth * 100_000_000;
        clock.probe(hosts.probe(now_ns, 100e3, mean_ns));
        for later_ns in [10_000_000, 60_000_000, 100_000_000] {
            let Some(known) = clock.offset(now_ns + later_ns) else { continue };
            let error_ns = (known.offset_ns as f64 - hosts.truth(now_ns + later_ns)).abs();
            beyond_ns = beyond_ns.max(error_ns - known.bound_ns as f64);
            largest_ns = largest_ns.max(known.bound_ns);
        }
    }
    (beyond_ns, largest_ns)
}

#[test]
fn an_probe_with_equal_ways_gives_the_offset_exactly() {
    let mut clock = HostClock::new();
    for count in 0..8u64 {
        assert_eq!(clock.offset(1_000), None, "not locked");
        let sent_ns = count * 10_000;
        clock.probe(Probe {
            sent_ns,
            received_ns: sent_ns + 5_000_000 + 300,
            answered_ns: sent_ns + 5_000_000 + 400,
            returned_ns: sent_ns + 700,
        });
    }
    let known = clock.offset(70_700).unwrap();
    assert_eq!((known.offset_ns, known.bound_ns, clock.round_trip_ns()), (5_000_000, 314, Some(600)));
}

#[test]
fn an_hour_with_clocks_a_day_apart_that_drift_by_100_ppm_stays_within_the_bound() {
    for (rate, mean_ns, allowed_ns) in
        [(100e-6, 50e3, 1_200_000), (-100e-6, 2e6, 4_000_000), (0.0, 5e6, 6_000_000)]
    {
        let mut hosts = Hosts { offset_ns: -DAY_NS, rate, random: 7 };
        hosts.offset_ns = if rate < 0.0 { DAY_NS } else { 2.0 * DAY_NS };
        let mut clock = HostClock::new();
        let (beyond_ns, largest_ns) = follow(&mut hosts, &mut clock, 0, 3600, mean_ns);
        assert!(beyond_ns <= 0.0, "{rate}: beyond its bound by {beyond_ns} ns");
        assert!(largest_ns < allowed_ns, "{rate}: bound of {largest_ns} ns");
        assert_eq!(clock.lost(), 0);
    }
}

#[test]
fn the_offset_is_slewed_and_mapped_time_never_goes_back() {
    let mut hosts = Hosts { offset_ns: DAY_NS, rate: 100e-6, random: 3 };
    let mut clock = HostClock::new();
    follow(&mut hosts, &mut clock, 0, 60, 3e6);
    let (mut before, mut pending) = (0.0, Vec::new());
    for step in 0..6_000u64 {
        let now_ns = 61_000_000_000 + step * 10_000_000;
        if step % 10 == 0 {
            pending.push(hosts.probe(now_ns, 100e3, 3e6));
        }
        // Each counts when it has returned.
        pending.extract_if(.., |probe| probe.returned_ns <= now_ns).for_each(|probe| clock.probe(probe));
        let mapped_ns = now_ns as f64 + clock.offset(now_ns).unwrap().offset_ns as f64;
        let step_ns = mapped_ns - before;
        assert!(before == 0.0 || (step_ns - 10e6).abs() < 10e6 * 2.0 * (SLEW + MAX_RATE), "{step_ns}");
        before = mapped_ns;
    }
}

#[test]
fn a_clock_that_stood_still_is_lost_and_locked_anew() {
    let mut hosts = Hosts { offset_ns: 0.0, rate: 0.0, random: 5 };
    let mut clock = HostClock::new();
    follow(&mut hosts, &mut clock, 0, 30, 100e3);
    hosts.offset_ns = 4e9;
    for count in 0..3 {
        assert!(clock.offset(31_000_000_000).is_some(), "{count}");
        clock.probe(hosts.probe(31_000_000_000 + count * 100_000_000, 100e3, 100e3));
    }
    assert_eq!((clock.offset(32_000_000_000), clock.lost()), (None, 1));
    let (beyond_ns, _) = follow(&mut hosts, &mut clock, 31, 60, 100e3);
    assert!(beyond_ns <= 0.0 && clock.offset(60_000_000_000).is_some());
}

#[test]
fn without_probes_the_bound_grows() {
    let mut hosts = Hosts { offset_ns: 0.0, rate: 0.0, random: 9 };
    let mut clock = HostClock::new();
    follow(&mut hosts, &mut clock, 0, 60, 10e3);
    let [soon, late] = [61, 161].map(|at_s: u64| clock.offset(at_s * 1_000_000_000).unwrap().bound_ns);
    assert!((late - soon).abs_diff(5_000_000) < 1_000_000, "{soon} {late}");
}

#[test]
fn stamps_that_contradict_each_other_are_ignored() {
    let mut clock = HostClock::new();
    let good = Probe { sent_ns: 100, received_ns: 200, answered_ns: 210, returned_ns: 150 };
    for bad in [
        Probe { returned_ns: 90, ..good },
        Probe { answered_ns: 190, ..good },
        Probe { answered_ns: 400, ..good },
    ] {
        clock.probe(bad);
    }
    assert_eq!(clock.round_trip_ns(), None);
}
