//! From states and sweeps, each with a stamp of the server, to samples: ranges, and the motion at the front beam.
//!
//! Stamps of the server are mapped to CLOCK_MONOTONIC by the states of the base, which are small and come first. A sweep
//! waits for the state of its time; without one it is published with the newest state, moved on by its velocities.

use shared_types::YOUNG_NS;

use crate::beams::SweepRanges;
use crate::clock::ServerClock;
use crate::event::RobotSettings;
use crate::join::Motions;
use crate::motion::{BaseState, Motion};

/// A sweep waits for the state of its time for this share of a period.
const WAIT_SHARE: u64 = 4;
/// A sweep whose front beam is older is dropped: it is late, or its stamp is wrong. With another age it would be placed
/// where the robot was at another time.
const MAX_AGE_PERIODS: u64 = 2;
/// A state is moved on by at most this many periods: the base is silent, or the connection is lost.
const MAX_AHEAD_PERIODS: u64 = 2;
/// Sweeps that are closer together than this share of a period are one too many.
const MIN_SPACING_SHARE: u64 = 4;

/// A sweep with its motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredSweep {
    /// Ranges by beam of a scan [mm].
    pub ranges_mm: SweepRanges,
    /// The ranges were damaged on the way, and are all zero.
    pub is_missing: bool,
    /// The motion at the time of the front beam.
    pub motion: Motion,
}

/// A sweep that waits.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    ranges_mm: SweepRanges,
    is_missing: bool,
    front_ns: u64,
    until_ns: u64,
}

/// The newest data.
#[derive(Debug)]
pub struct Sensing {
    robot: RobotSettings,
    period_ns: u64,
    clock: ServerClock,
    motions: Motions,
    waiting: Option<Waiting>,
    /// Time of the newest front beam [ns].
    front_ns: u64,
    /// Sweeps that were not used: too old, too close to the one before, or replaced before there was a state; and states
    /// that were overtaken by others.
    dropped: u64,
}

impl Sensing {
    /// Knows nothing yet.
    pub fn new(robot: &RobotSettings, period_ns: u64) -> Self {
        Self {
            robot: *robot,
            period_ns,
            clock: ServerClock::new(robot.delay_s),
            motions: Motions::default(),
            waiting: None,
            front_ns: 0,
            dropped: 0,
        }
    }

    /// Forgets what a server reported: the connection is new.
    pub fn restart(&mut self) {
        self.clock = ServerClock::new(self.robot.delay_s);
        self.motions.clear();
        self.waiting = None;
    }

    /// Takes a state of the base, unless newer ones have overtaken it; false when a number in it is not finite.
    pub fn state(&mut self, state: &BaseState, time_s: f64, arrived_ns: u64) -> bool {
        let Some(time_ns) = self.clock.arrival(time_s, arrived_ns) else {
            self.dropped += 1;
            return true;
        };
        let motion = Motion::of(&self.robot.convention, state, time_ns);
        motion.inspect(|motion| self.motions.add(*motion)).is_some()
    }

    /// Takes a sweep of the server.
    pub fn sweep(&mut self, ranges_mm: SweepRanges, time_s: f64, arrived_ns: u64) {
        let stamped_ns = self.clock.map(time_s, arrived_ns).unwrap_or(arrived_ns);
        let offset_ns = (self.robot.stamp_offset_s * 1e9) as i64;
        self.sweep_at((ranges_mm, false), stamped_ns.saturating_add_signed(-offset_ns), arrived_ns);
    }

    /// Takes a sweep of any scanner, whose front beam was measured at `front_ns` of CLOCK_MONOTONIC: its ranges, and
    /// whether they were damaged on the way.
    pub fn sweep_at(&mut self, (ranges_mm, is_missing): (SweepRanges, bool), front_ns: u64, arrived_ns: u64) {
        let oldest_ns = arrived_ns.saturating_sub((MAX_AGE_PERIODS * self.period_ns).max(YOUNG_NS));
        let newest_ns =
            self.waiting.map_or(self.front_ns + self.period_ns / MIN_SPACING_SHARE, |it| it.front_ns);
        let front_ns = front_ns.min(arrived_ns);
        let is_used = front_ns >= oldest_ns.max(newest_ns);
        if !is_used || self.waiting.is_some() {
            self.dropped += 1;
        }
        if is_used {
            let until_ns = arrived_ns + self.period_ns / WAIT_SHARE;
            self.waiting = Some(Waiting { ranges_mm, is_missing, front_ns, until_ns });
        }
    }

    /// The sweep that waits, if its motion is known or it has waited long enough.
    pub fn next(&mut self, now_ns: u64) -> Option<MeasuredSweep> {
        let Waiting { ranges_mm, is_missing, front_ns, until_ns } = self.waiting?;
        let ahead_ns = (self.robot.ahead_s * 1e9) as u64;
        if !self.motions.covers(front_ns, ahead_ns) && now_ns < until_ns {
            return None;
        }
        self.waiting = None;
        let is_known =
            |newest: &Motion| newest.time_ns.saturating_add(MAX_AHEAD_PERIODS * self.period_ns) >= front_ns;
        if !self.motions.newest().is_some_and(is_known) {
            self.dropped += 1;
            return None;
        }
        self.front_ns = front_ns;
        self.motions.at(front_ns).map(|motion| MeasuredSweep { ranges_mm, is_missing, motion })
    }

    /// When [`Self::next`] gives a sweep at the latest [ns].
    pub fn due_ns(&self) -> Option<u64> {
        self.waiting.map(|waiting| waiting.until_ns)
    }

    /// The newest motion.
    pub fn newest(&self) -> Option<&Motion> {
        self.motions.newest()
    }

    /// Sweeps and states that were not used.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

#[cfg(test)]
mod tests {
    use shared_types::MAX_BEAMS;

    use super::*;
    use crate::motion::{Convention, Turn};

    const T_NS: u64 = 100_000_000;
    const MS: u64 = 1_000_000;

    fn robot() -> RobotSettings {
        let convention = Convention::usual(Turn::Steering, 0.185);
        RobotSettings {
            convention,
            delay_s: 0.0,
            ahead_s: 0.005,
            stamp_offset_s: 0.0,
            sweep_s: 0.0,
            has_scanner: false,
        }
    }

    fn state(x_m: f64) -> BaseState {
        BaseState { pose: [x_m, 0.0, 0.0], velocity: [1.0, 0.0, 0.0], stalled: false }
    }

    /// A server whose clock shows 3.8 s at 1000 ms here, and whose states arrive after 2 ms.
    fn running() -> Sensing {
        let mut sensing = Sensing::new(&robot(), T_NS);
        for step in 0..20_u64 {
            let arrived_ns = (1000 + 100 * step) * MS + 2 * MS;
            assert!(sensing.state(&state(0.1 * step as f64), 3.8 + 0.1 * step as f64, arrived_ns));
        }
        sensing
    }

    #[test]
    fn a_sweep_gets_the_state_with_its_stamp_however_late_it_arrives() {
        let mut sensing = running();
        sensing.sweep([700; MAX_BEAMS], 3.8 + 1.9, 2942 * MS);
        let measured = sensing.next(2942 * MS).unwrap();
        assert!((measured.motion.pose[0] - 1.9).abs() < 1e-4, "{:?}", measured.motion);
        let age_ms = (2942 * MS - measured.motion.time_ns) / MS;
        assert!((39..=41).contains(&age_ms), "{age_ms}");
        assert_eq!(sensing.next(2943 * MS), None);
    }

    #[test]
    fn a_sweep_waits_for_its_state_but_not_for_long() {
        let mut sensing = running();
        sensing.sweep([700; MAX_BEAMS], 3.8 + 1.95, 2955 * MS);
        assert_eq!((sensing.next(2956 * MS), sensing.due_ns()), (None, Some(2980 * MS)));
        let moved_on = sensing.next(2980 * MS).unwrap();
        assert!((moved_on.motion.pose[0] - 1.95).abs() < 1e-3);
        sensing.sweep([700; MAX_BEAMS], 3.8 + 2.09, 3095 * MS);
        assert!(sensing.state(&state(2.2), 3.8 + 2.1, 3102 * MS));
        let between = sensing.next(3102 * MS).unwrap();
        // Interpolation places it there, the velocity of 1 m/s at 2.09 m.
        let expected = 1.9 + 0.3 * 0.19 / 0.2;
        assert!((between.motion.pose[0] - expected).abs() < 1e-3, "{between:?}");
    }

    #[test]
    fn a_scan_without_a_recent_state_is_dropped_and_nothing_waits_for_it() {
        let mut sensing = running();
        sensing.sweep_at(([700; MAX_BEAMS], false), 3000 * MS, 3000 * MS);
        assert!(sensing.next(3100 * MS).is_some(), "two periods at most");
        sensing.sweep_at(([700; MAX_BEAMS], false), 3210 * MS, 3210 * MS);
        assert_eq!((sensing.next(3300 * MS), sensing.due_ns(), sensing.dropped()), (None, None, 1));
        sensing.restart();
        sensing.sweep_at(([700; MAX_BEAMS], false), 3400 * MS, 3400 * MS);
        assert_eq!((sensing.next(3500 * MS), sensing.due_ns()), (None, None));
    }

    #[test]
    fn sweeps_in_a_burst_and_stamps_of_another_clock_do_no_harm() {
        let mut sensing = running();
        sensing.sweep([700; MAX_BEAMS], 3.8 + 1.9, 2942 * MS);
        assert!(sensing.next(2942 * MS).is_some());
        sensing.sweep([700; MAX_BEAMS], 3.8 + 1.905, 2943 * MS);
        assert_eq!((sensing.next(2990 * MS), sensing.dropped()), (None, 1));
        for stamp_s in [1e9, -1e9, f64::NAN, f64::INFINITY, 0.0] {
            sensing.sweep([700; MAX_BEAMS], stamp_s, 3200 * MS);
        }
        assert!(sensing.state(&state(2.2), 3.8 + 2.15, 3152 * MS));
        let front_ns = sensing.next(3300 * MS).unwrap().motion.time_ns;
        assert!((3100 * MS..=3200 * MS).contains(&front_ns), "{front_ns}");
    }

    #[test]
    fn data_that_were_overtaken_are_dropped_and_counted_and_move_nothing() {
        let mut sensing = running();
        assert!(sensing.state(&state(1.7), 3.8 + 1.7, 2950 * MS));
        assert!((sensing.newest().unwrap().pose[0] - 1.9).abs() < 1e-9 && sensing.dropped() == 1);
        // Of two sweeps that wait, the newer one stays.
        sensing.sweep([700; MAX_BEAMS], 3.8 + 1.97, 2990 * MS);
        sensing.sweep([800; MAX_BEAMS], 3.8 + 1.95, 2991 * MS);
        let measured = sensing.next(3020 * MS).unwrap();
        assert_eq!((measured.ranges_mm, sensing.dropped()), ([700; MAX_BEAMS], 2));
        assert!((measured.motion.pose[0] - 1.97).abs() < 1e-3, "{measured:?}");
    }

    #[test]
    fn after_the_clock_of_the_server_stood_still_no_scan_gets_a_time_that_it_does_not_have() {
        for stall_ms in [60, 150, 400, 1500] {
            let mut sensing = running();
            let (mut scans, mut last_ns) = (Vec::new(), 0);
            for step in 20..140_u64 {
                // The robot drives on at 1 m/s; stamps are 60 ms and more behind.
                let arrived_ns = (1002 + 100 * step + stall_ms) * MS;
                let time_s = 3.8 + 0.1 * step as f64;
                assert!(sensing.state(&state(0.1 * step as f64), time_s, arrived_ns));
                sensing.sweep([700; MAX_BEAMS], time_s, arrived_ns);
                let Some(measured) = sensing.next(arrived_ns + 30 * MS) else { continue };
                assert!(measured.motion.time_ns > last_ns);
                last_ns = measured.motion.time_ns;
                // The pose is the one with the stamp of the scan.
                assert!(
                    (measured.motion.pose[0] - 0.1 * step as f64).abs() < 1e-3,
                    "{stall_ms}: {measured:?}"
                );
                scans.push(step);
            }
            // After five seconds it is known that its clock, and not the line, is late.
            assert!(
                scans.contains(&139) && (scans.contains(&21) == (stall_ms < 200)),
                "{stall_ms}: {scans:?}"
            );
        }
    }

    #[test]
    fn a_state_that_is_no_number_is_not_used() {
        let mut sensing = running();
        assert!(!sensing.state(&state(f64::NAN), 5.8, 3002 * MS));
        assert!((sensing.newest().unwrap().pose[0] - 1.9).abs() < 1e-9);
    }
}
