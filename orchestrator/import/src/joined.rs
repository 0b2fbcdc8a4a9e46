//! Scans joined with the odometry: the motion at each front beam.

use driver::join::Motions;
use driver::motion::Motion;
use driver::odometry::TrackedOdometry;
use plan::Plan;
use shared_types::Scan;

/// A scan further from the odometry is left out, in scan periods, as a driver does.
const MAX_AWAY_PERIODS: u64 = 2;
/// The first scan of a recording is at this time [ns].
const START_NS: u64 = 1_000_000_000;

/// Joins scans with the odometry.
pub(crate) struct Joined<'m> {
    ahead: std::slice::Iter<'m, Motion>,
    known: Motions,
    first_ns: u64,
    /// What is taken from stamps [ns].
    origin_ns: Option<u64>,
    /// The newest front beam, by its stamp [ns].
    pub(crate) newest_ns: u64,
    period_ns: u64,
    /// From the front beam to the last one [ns].
    pub(crate) after_front_ns: u64,
    pub(crate) tracked: TrackedOdometry,
    /// A scan without ranges.
    pub(crate) scan: Scan,
}

impl<'m> Joined<'m> {
    pub(crate) fn new(motions: &'m [Motion], plan: &Plan, period_ns: u64) -> Self {
        let scanner = plan.system.vehicle.scanner;
        let start = plan.scenario.start;
        let scan = Scan { sweep_ns: scanner.sweep_ns(period_ns), period_ns, ..Scan::of(scanner.geometry()) };
        Self {
            ahead: motions.iter(),
            known: Motions::default(),
            first_ns: motions.first().map_or(0, |motion| motion.time_ns),
            origin_ns: None,
            newest_ns: 0,
            period_ns,
            after_front_ns: scanner.after_front_ns(period_ns),
            tracked: TrackedOdometry::new([start.x_m, start.y_m, start.yaw_rad]),
            scan,
        }
    }

    /// The motion at a front beam that is newer than the one before, in the time of the recording; `None` if no odometry is near.
    pub(crate) fn motion(&mut self, front_ns: u64) -> Option<Motion> {
        let away_ns = MAX_AWAY_PERIODS * self.period_ns;
        while !self.known.covers(front_ns, 0)
            && let Some(motion) = self.ahead.next()
        {
            self.known.add(*motion);
        }
        let is_near =
            self.known.covers(front_ns, away_ns) && front_ns.saturating_add(away_ns) >= self.first_ns;
        if !is_near {
            return None;
        }
        self.newest_ns = front_ns;
        let origin_ns = *self.origin_ns.get_or_insert(front_ns);
        let motion = self.known.at(front_ns)?;
        Some(Motion { time_ns: front_ns - origin_ns + START_NS, ..motion })
    }
}
