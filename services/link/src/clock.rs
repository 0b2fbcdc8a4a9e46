//! The clock of another host: its offset to ours, from probes of four stamps.
//!
//! A probe leaves here at `sent_ns`, reaches the other host at `received_ns` of its clock, leaves it at
//! `answered_ns` and is back at `returned_ns` of ours. If both ways took equally long, the offset is the mean of the two
//! differences; it is wrong by half of the round trip at most. Of the last [`PROBES`] the one with the shortest round
//! trip counts. Its bound grows by [`DRIFT`] with its age, because two clocks drift apart.
//!
//! The offset in use never steps: it is slewed by [`SLEW`] at most, and the distance that is still to go counts in the
//! bound. A measured rate difference is compensated. A clock that stood still (a suspended machine) does not fit the
//! bound any more: then the clock is lost, and is locked anew.
//!
//! Where this fails: a way that always takes longer than the other one is not seen, and lies within the bound.

/// Probes of which the shortest counts.
pub(crate) const PROBES: usize = 32;
/// Probes after which the clock is locked.
const LOCKED_AFTER: usize = 8;
/// Drift of two clocks whose rate difference is compensated, which the bound allows for.
const DRIFT: f64 = 50e-6;
/// Drift that the bound allows for until the rate difference is known: each clock may be wrong by 100 ppm.
const UNKNOWN_DRIFT: f64 = 200e-6;
/// Largest rate at which the offset is moved to the measured one.
const SLEW: f64 = 500e-6;
/// Time over which the rate difference is measured [ns].
const RATE_NS: u64 = 20_000_000_000;
/// Largest rate difference that is believed.
const MAX_RATE: f64 = 300e-6;
/// Probes in a row that do not fit the bound, after which the clock is lost.
const MISFITS: u32 = 3;

/// The four stamps of a probe [ns].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Probe {
    /// When it left, by our clock.
    pub(crate) sent_ns: u64,
    /// When it reached the other host, by the other clock.
    pub(crate) received_ns: u64,
    /// When the answer left there, by the other clock.
    pub(crate) answered_ns: u64,
    /// When the answer was here, by our clock.
    pub(crate) returned_ns: u64,
}

/// One probe as measured.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Measured {
    at_ns: u64,
    offset_ns: f64,
    round_trip_ns: f64,
}

/// Our belief about the clock of another host.
#[derive(Debug, Clone, Default)]
pub(crate) struct HostClock {
    recent: Vec<Measured>,
    next: usize,
    /// The offset in use at `moved_ns`: what is to be added to our time.
    offset_ns: f64,
    moved_ns: u64,
    rate: Option<f64>,
    /// Where the measurement of the rate began.
    anchor: Option<Measured>,
    misfits: u32,
    is_locked: bool,
    lost: u64,
}

/// The offset at one time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Offset {
    /// What is to be added to our time to get the other one [ns].
    pub(crate) offset_ns: i64,
    /// How wrong it may be [ns].
    pub(crate) bound_ns: u64,
}

impl HostClock {
    /// A clock of which nothing is known.
    pub(crate) fn new() -> Self {
        Self { recent: Vec::with_capacity(PROBES), ..Self::default() }
    }

    /// Takes in a probe. One whose stamps contradict each other is ignored.
    pub(crate) fn probe(&mut self, stamps: Probe) {
        let Some(measured) = measure(stamps) else { return };
        if self.is_locked && !self.fits(&measured) {
            self.misfits += 1;
            if self.misfits >= MISFITS {
                *self = Self { lost: self.lost + 1, ..Self::new() };
            }
            return;
        }
        self.misfits = 0;
        // Before the probe counts: until now the offset went to where the others point.
        self.move_to(measured.at_ns);
        match self.recent.len() {
            PROBES => self.recent[self.next] = measured,
            _ => self.recent.push(measured),
        }
        self.next = (self.next + 1) % PROBES;
        self.measure_rate();
        if !self.is_locked && self.recent.len() >= LOCKED_AFTER {
            (self.offset_ns, self.moved_ns) = (self.target(measured.at_ns).unwrap_or(0.0), measured.at_ns);
            self.is_locked = true;
        }
    }

    /// The offset now; `None` while the clock is not locked.
    pub(crate) fn offset(&self, now_ns: u64) -> Option<Offset> {
        if !self.is_locked {
            return None;
        }
        let (offset_ns, best) = (self.offset_at(now_ns), self.best()?);
        let drift = if self.rate.is_some() { DRIFT } else { UNKNOWN_DRIFT };
        let to_go_ns = (self.target(now_ns)? - offset_ns).abs();
        let bound_ns = 0.5 * best.round_trip_ns + drift * elapsed_ns(best.at_ns, now_ns) + to_go_ns;
        Some(Offset { offset_ns: offset_ns.round() as i64, bound_ns: bound_ns.ceil() as u64 })
    }

    /// The shortest round trip of the probes in use [ns].
    pub(crate) fn round_trip_ns(&self) -> Option<u64> {
        self.best().map(|best| best.round_trip_ns as u64)
    }

    /// How often the other clock, or ours, did not fit its bound and was lost.
    pub(crate) fn lost(&self) -> u64 {
        self.lost
    }

    fn best(&self) -> Option<&Measured> {
        self.recent.iter().min_by(|one, other| one.round_trip_ns.total_cmp(&other.round_trip_ns))
    }

    /// The offset that the best probe gives now.
    fn target(&self, now_ns: u64) -> Option<f64> {
        let best = self.best()?;
        Some(best.offset_ns + self.rate.unwrap_or(0.0) * elapsed_ns(best.at_ns, now_ns))
    }

    /// The offset in use now.
    fn offset_at(&self, now_ns: u64) -> f64 {
        // A question about a moment before the last move: nothing was slewed since.
        let elapsed_ns = elapsed_ns(self.moved_ns, now_ns).max(0.0);
        let carried_ns = self.offset_ns + self.rate.unwrap_or(0.0) * elapsed_ns;
        let to_go_ns = self.target(now_ns).unwrap_or(carried_ns) - carried_ns;
        carried_ns + to_go_ns.clamp(-SLEW * elapsed_ns, SLEW * elapsed_ns)
    }

    fn move_to(&mut self, now_ns: u64) {
        self.offset_ns = self.offset_at(now_ns);
        self.moved_ns = now_ns;
    }

    /// Compares the best probe with one of long before.
    fn measure_rate(&mut self) {
        let Some(best) = self.best().copied() else { return };
        let Some(anchor) = self.anchor else {
            self.anchor = (self.recent.len() == PROBES).then_some(best);
            return;
        };
        let elapsed_ns = elapsed_ns(anchor.at_ns, best.at_ns);
        if elapsed_ns >= RATE_NS as f64 {
            let rate = ((best.offset_ns - anchor.offset_ns) / elapsed_ns).clamp(-MAX_RATE, MAX_RATE);
            // Half of what is new: two short round trips may differ in their ways.
            self.rate = Some(self.rate.map_or(rate, |before| 0.5 * (before + rate)));
            self.anchor = Some(best);
        }
    }

    fn fits(&self, measured: &Measured) -> bool {
        let Some(known) = self.offset(measured.at_ns) else { return true };
        let distance_ns = (measured.offset_ns - known.offset_ns as f64).abs();
        distance_ns <= 0.5 * measured.round_trip_ns + known.bound_ns as f64 + 1e6
    }
}

fn measure(stamps: Probe) -> Option<Measured> {
    let Probe { sent_ns, received_ns, answered_ns, returned_ns } = stamps;
    let away_ns = returned_ns.checked_sub(sent_ns)?;
    let there_ns = answered_ns.checked_sub(received_ns)?;
    // A clock that runs faster there may make a very short round trip negative.
    let round_trip_ns = away_ns as f64 - there_ns as f64;
    let forth_ns = received_ns.wrapping_sub(sent_ns).cast_signed() as f64;
    let back_ns = answered_ns.wrapping_sub(returned_ns).cast_signed() as f64;
    let offset_ns = 0.5 * (forth_ns + back_ns);
    (round_trip_ns >= 0.0).then_some(Measured { at_ns: returned_ns, offset_ns, round_trip_ns })
}

fn elapsed_ns(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.wrapping_sub(from_ns).cast_signed() as f64
}

#[cfg(test)]
mod tests {
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
            Probe {
                sent_ns: now_ns,
                received_ns: there(arrived_ns),
                answered_ns: there(left_ns),
                returned_ns,
            }
        }
    }

    /// The largest error beyond its bound and the largest bound over a time, ten probes a second [ns].
    fn follow(
        hosts: &mut Hosts,
        clock: &mut HostClock,
        from_s: u64,
        until_s: u64,
        mean_ns: f64,
    ) -> (f64, u64) {
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
}
