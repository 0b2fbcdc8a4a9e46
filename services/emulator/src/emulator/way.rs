//! The way of an actuation to the robot: how long it travels, whether it arrives, and what is on its way.
//!
//! Time and loss are drawn from the seed and the answered scan, or the time of sending of a repetition. One that was
//! sent later never arrives earlier.

use shared_types::{Actuation, Fault, Flag, finite, plain_state};

use crate::noise::{NoiseStream, Purpose};
use crate::scenario::{Scenario, Values};

/// How many actuations can be on their way: those that a description may mean, and the repetitions of a busy actuator.
const CAPACITY: usize = vehicle::MAX_ON_THE_WAY + 8;

plain_state! {
    /// An actuation on its way.
    pub struct Travelling {
        /// When it arrives, since the start of the run [ns]
        pub arrives_ns: u64,
        /// Velocity sent [m/s]
        pub velocity_mps: f64,
        /// Steering angle sent [rad]
        pub steering_rad: f64,
        /// Scan that it answers
        pub answered_scan: u64,
        /// 1 when it blocks the wheels
        pub blocks: Flag,
        /// 1 when it answers a scan
        pub answers: Flag,
    }
}

plain_state! {
    /// The actuations on their way, in the order in which they arrive.
    pub struct Travellings {
        /// How many of `items` are used
        pub count: u64,
        /// First the one that arrives next
        pub items: [Travelling; CAPACITY],
    }
}

impl Travellings {
    /// Those on their way.
    pub fn list(&self) -> &[Travelling] {
        &self.items[..(self.count as usize).min(CAPACITY)]
    }

    /// When the next one arrives [ns].
    pub fn next_ns(&self) -> Option<u64> {
        self.list().first().map(|next| next.arrives_ns)
    }

    /// Appends one. It arrives after those before it; when there is no room, it takes the place of the last one.
    pub fn push(&mut self, new: Travelling) {
        let last_ns = self.list().last().map_or(0, |last| last.arrives_ns);
        let index = self.list().len().min(CAPACITY - 1);
        self.items[index] = Travelling { arrives_ns: new.arrives_ns.max(last_ns), ..new };
        self.count = index as u64 + 1;
    }

    /// Passes when all numbers are finite and the arrivals in order.
    pub(super) fn check(&self) -> Result<(), Fault> {
        if self.count > CAPACITY as u64 || !self.list().is_sorted_by_key(|item| item.arrives_ns) {
            return Err(Fault::OutOfRange { field: "travelling", value: self.count as f64 });
        }
        self.list().iter().try_for_each(|item| finite("travelling", &[item.velocity_mps, item.steering_rad]))
    }

    /// Takes the next one if it has arrived by `now_ns`.
    pub fn take_due(&mut self, now_ns: u64) -> Option<Travelling> {
        let next = *self.list().first().filter(|next| next.arrives_ns <= now_ns)?;
        self.items.rotate_left(1);
        self.items[CAPACITY - 1] = Travelling::default();
        self.count -= 1;
        Some(next)
    }
}

/// Delays and loses actuations.
#[derive(Debug, Clone, Copy)]
pub(super) struct Way {
    seed: u64,
    values: Values,
}

impl Way {
    pub(super) fn new(scenario: &Scenario) -> Self {
        Self { seed: scenario.seed, values: scenario.robot_values() }
    }

    /// When an actuation that is sent at `now_ns` arrives; `None` when it is lost.
    pub(super) fn arrives_ns(&self, actuation: &Actuation, now_ns: u64) -> Option<u64> {
        let Values { command_delay_s, command_jitter_s, command_loss, .. } = self.values;
        // Scan numbers never get as large as the other half of the numbers.
        let number = if actuation.answers == 1 { actuation.header.scan_id } else { now_ns | 1 << 63 };
        let mut stream = NoiseStream::new(self.seed, Purpose::Command, number);
        let is_lost = stream.chance(command_loss);
        let travel_s = command_delay_s + command_jitter_s * stream.exponential();
        (!is_lost).then(|| now_ns.saturating_add((travel_s * 1e9).round() as u64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Robot;

    fn way(delay_s: f64, jitter_s: f64, loss: f64) -> Way {
        let robot = Robot {
            command_delay_s: Some(delay_s),
            command_jitter_s: Some(jitter_s),
            command_loss: Some(loss),
            ..Robot::default()
        };
        Way::new(&Scenario { robot, ..Scenario::default() })
    }

    fn answer(scan_id: u64) -> Actuation {
        let mut actuation = Actuation { answers: 1, ..Actuation::default() };
        actuation.header.scan_id = scan_id;
        actuation
    }

    fn arriving(arrives_ns: u64) -> Travelling {
        Travelling { arrives_ns, velocity_mps: arrives_ns as f64, ..Travelling::default() }
    }

    #[test]
    fn the_time_is_the_delay_and_an_exponential_share_with_the_mean_asked_for() {
        let way = way(0.02, 0.002, 0.0);
        let times: Vec<f64> = (1..=20_000)
            .map(|scan| (way.arrives_ns(&answer(scan), 1000).unwrap() - 1000) as f64 * 1e-9)
            .collect();
        let mean = times.iter().sum::<f64>() / 2e4;
        let above = times.iter().filter(|time| **time > 0.02 + 2.0 * 0.002).count();
        assert!(times.iter().all(|time| *time >= 0.02));
        // The standard error of the mean is 14 us; exp(-2) of all exceed twice the mean, 2707 with a deviation of 48.
        assert!((mean - 0.022).abs() < 6e-5, "{mean}");
        assert!((2500..2900).contains(&above), "{above}");
    }

    #[test]
    fn the_same_answer_takes_the_same_time_and_a_repetition_another() {
        let way = way(0.02, 0.002, 0.0);
        let time = |actuation: &Actuation, now_ns| way.arrives_ns(actuation, now_ns).unwrap() - now_ns;
        assert_eq!(time(&answer(7), 100), time(&answer(7), 999));
        assert_ne!(time(&answer(7), 100), time(&answer(8), 100));
        assert_ne!(time(&Actuation::default(), 100), time(&Actuation::default(), 101));
    }

    #[test]
    fn as_many_are_lost_as_asked_for() {
        let lost = |loss| {
            let way = way(0.0, 0.0, loss);
            (1..=10_000).filter(|scan| way.arrives_ns(&answer(*scan), 0).is_none()).count()
        };
        assert_eq!((lost(0.0), lost(1.0)), (0, 10_000));
        // 1000 with a deviation of 30.
        assert!((870..1130).contains(&lost(0.1)));
    }

    #[test]
    fn one_sent_later_never_arrives_earlier_and_the_newest_is_never_dropped() {
        let mut queue = Travellings::default();
        queue.push(arriving(50));
        queue.push(Travelling { velocity_mps: 2.0, ..arriving(30) });
        assert_eq!(queue.next_ns(), Some(50));
        assert_eq!(queue.take_due(49), None);
        assert_eq!(queue.take_due(50).map(|next| next.velocity_mps), Some(50.0));
        assert_eq!(queue.take_due(50).map(|next| (next.velocity_mps, next.arrives_ns)), Some((2.0, 50)));
        assert_eq!(queue, Travellings::default());
        (1..=CAPACITY as u64 + 5).for_each(|ns| queue.push(arriving(ns)));
        let arrivals: Vec<u64> = queue.list().iter().map(|item| item.arrives_ns).collect();
        let kept = (1..CAPACITY as u64).chain([CAPACITY as u64 + 5]);
        assert_eq!(arrivals, kept.collect::<Vec<_>>());
    }
}
