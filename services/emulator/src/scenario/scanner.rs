//! Faults of the scanner: what it measures wrongly, and which scans come late, irregularly, or without ranges.

use std::f64::consts::PI;

use toml::Table;
use vehicle::{Invalid, KeyRule, set_range, settings};

/// Longest time by which a scan can be late [s]: the emulator keeps the poses of this time.
const MAX_LATE_S: f64 = 10.0;

/// Largest range that the scanner reports [m].
pub const MAX_RANGE_M: f64 = 5.6;

settings! {
    /// Faults of the scanner; without a key there is none, and obstacles that are marked as black are hard to see.
    /// A scan has a fault when its front beam is taken from `from_s` on and before `to_s`.
    pub struct Scanner {
        /// All keys of this table act from this time on [s].
        pub from_s: f64 = 0.0, 0.0..=1e6;
        /// All keys of this table act until this time; without the key to the end of the run [s].
        pub to_s: Option<f64> = None, (0.0..=1e6, "above `from_s`");
        /// Sectors in which nothing comes back, as angles from the scanner's front beam, counter-clockwise [rad].
        pub dead_rad: Vec<[f64; 2]> = Vec::new(), Sectors;
        /// The first scan from this time on is repeated, with the same ranges, instead of all later ones [s].
        pub stuck_s: Option<f64> = None, 0.0..=1e6;
        /// Probability that a beam gives no return, from each of these times on, in addition to `noise.dropout`.
        pub dropout_steps: Vec<[f64; 2]> = Vec::new(), Steps;
        /// Reported range divided by the true one.
        pub range_factor: f64 = 1.0, 0.1..=10.0;
        /// Length that is added to each range, after `range_factor` [m].
        pub range_offset_m: f64 = 0.0, -MAX_RANGE_M..=MAX_RANGE_M;
        /// Mounting error that the vehicle description does not know: the scanner is turned by this angle,
        /// counter-clockwise, in addition to `robot.scanner_yaw_rad` [rad].
        pub yaw_rad: f64 = 0.0, -PI..=PI;
        /// Share of the beams that report a random range from 0.02 to 5.6 m.
        pub salt: f64 = 0.0, 0.0..=1.0;
        /// Share of the beams that report a random range from 0.02 to 1 m.
        pub dust: f64 = 0.0, 0.0..=1.0;
        /// Obstacles with `black = true` give no return from farther away than this [m].
        pub black_range_m: f64 = 1.5, 0.0..=MAX_RANGE_M;
        /// Standard deviation of the error of a scan's time stamp; the larger of `robot.scan_stamp_jitter_s` and this
        /// acts [s].
        pub stamp_jitter_s: f64 = 0.0, 0.0..=1.0;
        /// Scans, with their odometry, are published this much later, in their order [s].
        pub late_s: f64 = 0.0, 0.0..=MAX_LATE_S;
        /// Shortest and longest time between two scans; without the key scans are regular. Each scan is delayed against the
        /// regular time, and follows the one before after the shortest time at the earliest. Nine of ten delays are
        /// uniform up to a quarter of the longest time minus the scan period, one of ten is up to all of it. So a long
        /// time is followed by short ones, and the scan period is the mean [s].
        pub period_s: Option<[f64; 2]> = None, Periods;
        /// One scan in this many is missing, at random: it is published without ranges; 0 for none. Of
        /// `robot.scan_missing_every` and this, the one that loses more scans acts.
        pub missing_every: u64 = 0, 0.0..=1e9;
    }
}

impl Scanner {
    /// Passes when the times are in order.
    pub(super) fn validate(&self) -> Result<(), Invalid> {
        match self.to_s {
            Some(to_s) if to_s <= self.from_s => {
                Err(Invalid::new("to_s", to_s, format!("above {}, the time from_s", self.from_s)))
            }
            _ => Ok(()),
        }
    }

    /// Whether the faults act at a time, in nanoseconds since the start of the run.
    pub fn acts_at(&self, time_ns: u64) -> bool {
        time_ns >= nanoseconds(self.from_s) && time_ns < self.end_ns()
    }

    /// Until when the faults act [ns].
    pub fn end_ns(&self) -> u64 {
        self.to_s.map_or(u64::MAX, nanoseconds)
    }

    /// Shortest and longest time between two scans, where they are irregular [ns].
    pub fn periods_ns(&self) -> Option<[u64; 2]> {
        self.period_s.map(|periods| periods.map(nanoseconds))
    }

    /// Passes when the scan period, which is the mean, lies between the shortest and the longest time.
    ///
    /// # Errors
    /// [`Invalid`] with the key, the value and the period.
    pub fn validate_mean(&self, mean_ns: u64) -> Result<(), Invalid> {
        match (self.period_s, self.periods_ns()) {
            (Some([from, to]), Some([shortest, longest])) if shortest >= mean_ns || mean_ns >= longest => {
                let allowed = format!("one above and one below {}, the scan period", mean_ns as f64 * 1e-9);
                Err(Invalid::new("period_s", format!("[{from}, {to}]"), allowed).within("scanner"))
            }
            _ => Ok(()),
        }
    }

    /// Whether ranges are repeated at a time [ns].
    pub fn is_stuck_at(&self, time_ns: u64) -> bool {
        self.acts_at(time_ns) && self.stuck_s.is_some_and(|stuck_s| time_ns >= nanoseconds(stuck_s))
    }

    /// Probability of a dropout at a time [ns]: that of the last step.
    pub fn dropout_at(&self, time_ns: u64) -> f64 {
        let begun = self.dropout_steps.iter().take_while(|[begins_s, _]| time_ns >= nanoseconds(*begins_s));
        begun.last().map_or(0.0, |[_, share]| *share)
    }
}

fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// Two times in ascending order.
struct Periods;

impl KeyRule<Option<[f64; 2]>> for Periods {
    fn text(&self) -> String {
        format!("`[shortest, longest]` from 0.001 to {MAX_LATE_S}; the scan period lies between them")
    }

    fn require(&self, key: &str, periods: &Option<[f64; 2]>) -> Result<(), Invalid> {
        match periods {
            Some([from, to]) if !(*from >= 0.001 && from <= to && *to <= MAX_LATE_S) => {
                Err(Invalid::new(key, format!("[{from}, {to}]"), self.text()))
            }
            _ => Ok(()),
        }
    }

    fn constrain(&self, schema: &mut Table) {
        set_range(schema, 0.001, MAX_LATE_S);
    }
}

/// Pairs of angles in ascending order.
struct Sectors;

impl KeyRule<Vec<[f64; 2]>> for Sectors {
    fn text(&self) -> String {
        "pairs `[from, to]` from -pi to pi, the smaller one first".to_owned()
    }

    fn require(&self, key: &str, sectors: &Vec<[f64; 2]>) -> Result<(), Invalid> {
        require_pairs(self, key, sectors, |_, [from, to]| from >= -PI && to <= PI && from < to)
    }

    fn constrain(&self, schema: &mut Table) {
        set_range(schema, -PI, PI);
    }
}

/// Pairs of time and share, in the order of time.
struct Steps;

impl KeyRule<Vec<[f64; 2]>> for Steps {
    fn text(&self) -> String {
        "pairs `[time, share]`: times from 0 to 1e6 s in ascending order, shares from 0 to 1".to_owned()
    }

    fn require(&self, key: &str, steps: &Vec<[f64; 2]>) -> Result<(), Invalid> {
        require_pairs(self, key, steps, |before, [time_s, share]| {
            let is_later = before.is_none_or(|[before_s, _]| time_s > before_s);
            (0.0..=1e6).contains(&time_s) && is_later && (0.0..=1.0).contains(&share)
        })
    }
}

/// Passes when each pair is allowed after the one before; the first that is not is named with its index.
fn require_pairs(
    rule: &impl KeyRule<Vec<[f64; 2]>>,
    key: &str,
    pairs: &[[f64; 2]],
    is_allowed: impl Fn(Option<[f64; 2]>, [f64; 2]) -> bool,
) -> Result<(), Invalid> {
    for (index, pair) in pairs.iter().enumerate() {
        let before = index.checked_sub(1).map(|before| pairs[before]);
        if !is_allowed(before, *pair) {
            let [first, second] = pair;
            return Err(Invalid::new(
                &format!("{key}[{index}]"),
                format!("[{first}, {second}]"),
                rule.text(),
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scenario;

    fn scanner(keys: &str) -> Scanner {
        Scenario::parse(&format!("[scanner]\n{keys}"), "test").unwrap().scanner
    }

    #[test]
    fn messages_name_key_value_and_what_is_allowed() {
        let sectors = "pairs `[from, to]` from -pi to pi, the smaller one first";
        let steps = "pairs `[time, share]`: times from 0 to 1e6 s in ascending order, shares from 0 to 1";
        let periods = "`[shortest, longest]` from 0.001 to 10; the scan period lies between them";
        let cases = [
            ("from_s = 2\nto_s = 2", "to_s = 2 is not allowed: above 2, the time from_s".to_owned()),
            ("to_s = nan", "to_s = NaN is not allowed: 0 to 1000000".to_owned()),
            (
                "dead_rad = [[0, 1], [0.5, 0.5]]",
                format!("dead_rad[1] = [0.5, 0.5] is not allowed: {sectors}"),
            ),
            ("dead_rad = [[-3.2, 1]]", format!("dead_rad[0] = [-3.2, 1] is not allowed: {sectors}")),
            ("dead_rad = [[nan, 1]]", format!("dead_rad[0] = [NaN, 1] is not allowed: {sectors}")),
            ("dead_rad = [[0, 3.2]]", format!("dead_rad[0] = [0, 3.2] is not allowed: {sectors}")),
            (
                "dropout_steps = [[1, 0.5], [1, 0]]",
                format!("dropout_steps[1] = [1, 0] is not allowed: {steps}"),
            ),
            ("dropout_steps = [[1, 1.5]]", format!("dropout_steps[0] = [1, 1.5] is not allowed: {steps}")),
            ("dropout_steps = [[-1, 0.5]]", format!("dropout_steps[0] = [-1, 0.5] is not allowed: {steps}")),
            (
                "dropout_steps = [1]",
                "dropout_steps[0] = 1 is not allowed: an array of two numbers".to_owned(),
            ),
            ("salt = 1.1", "salt = 1.1 is not allowed: 0 to 1".to_owned()),
            ("dust = -0.1", "dust = -0.1 is not allowed: 0 to 1".to_owned()),
            ("range_factor = 0", "range_factor = 0 is not allowed: 0.1 to 10".to_owned()),
            ("range_offset_m = 6", "range_offset_m = 6 is not allowed: -5.6 to 5.6".to_owned()),
            ("black_range_m = 5.7", "black_range_m = 5.7 is not allowed: 0 to 5.6".to_owned()),
            ("late_s = 11", "late_s = 11 is not allowed: 0 to 10".to_owned()),
            ("stuck_s = -1", "stuck_s = -1 is not allowed: 0 to 1000000".to_owned()),
            ("stamp_jitter_s = 2", "stamp_jitter_s = 2 is not allowed: 0 to 1".to_owned()),
            ("period_s = [0.2, 0.1]", format!("period_s = [0.2, 0.1] is not allowed: {periods}")),
            ("period_s = [0, 0.1]", format!("period_s = [0, 0.1] is not allowed: {periods}")),
            ("period_s = [0.1, nan]", format!("period_s = [0.1, NaN] is not allowed: {periods}")),
            ("period_s = 0.1", "period_s = 0.1 is not allowed: an array of two numbers".to_owned()),
        ];
        for (keys, expected) in cases {
            let error = Scenario::parse(&format!("[scanner]\n{keys}"), "my.toml").unwrap_err();
            assert_eq!(error.to_string(), format!("my.toml: scanner.{expected}"));
        }
    }

    #[test]
    fn faults_act_from_one_time_and_before_another() {
        let scanner = scanner("from_s = 1\nto_s = 2\nstuck_s = 1.5\nmissing_every = 1");
        let acts = [999_999_999, 1_000_000_000, 1_999_999_999, 2_000_000_000].map(|ns| scanner.acts_at(ns));
        assert_eq!(acts, [false, true, true, false]);
        let stuck = [1_400_000_000, 1_500_000_000, 2_000_000_000].map(|ns| scanner.is_stuck_at(ns));
        assert_eq!(stuck, [false, true, false]);
        assert!(Scanner::default().acts_at(0) && Scanner::default().acts_at(u64::MAX - 1));
        assert!(!Scanner::default().is_stuck_at(u64::MAX - 1));
    }

    #[test]
    fn the_scan_period_must_lie_between_the_shortest_and_the_longest_time() {
        let irregular = scanner("period_s = [0.005, 0.255]");
        for mean_ns in [5_000_001, 100_000_000, 254_999_999] {
            assert_eq!(irregular.validate_mean(mean_ns), Ok(()));
        }
        assert_eq!(
            irregular.validate_mean(500_000_000).unwrap_err().to_string(),
            "scanner.period_s = [0.005, 0.255] is not allowed: one above and one below 0.5, the scan period"
        );
        // The mean of periods that are never shorter cannot be the shortest.
        assert!(irregular.validate_mean(5_000_000).is_err());
        assert_eq!(scanner("").validate_mean(1), Ok(()));
    }

    #[test]
    fn the_share_of_dropouts_is_that_of_the_last_step() {
        let scanner = scanner("dropout_steps = [[1, 0.5], [2, 0.9], [4, 0]]");
        let shares = [0, 999_999_999, 1_000_000_000, 2_000_000_000, 3_999_999_999, 4_000_000_000]
            .map(|ns| scanner.dropout_at(ns));
        assert_eq!(shares, [0.0, 0.0, 0.5, 0.9, 0.9, 0.0]);
    }

    #[test]
    fn a_table_with_all_keys_and_a_black_obstacle_read_back_identically() {
        let keys = "from_s = 1\nto_s = 9\ndead_rad = [[-0.5, 0.1], [1, 2]]\nstuck_s = 2\n\
                    dropout_steps = [[1, 0.5], [2, 1]]\nrange_factor = 1.1\nrange_offset_m = -0.1\nyaw_rad = 0.05\n\
                    salt = 0.01\ndust = 0.02\nblack_range_m = 1\nstamp_jitter_s = 0.02\nlate_s = 0.05\n\
                    missing_every = 5\nperiod_s = [0.005, 0.255]";
        let post = "[[obstacle]]\nshape = \"circle\"\nx_m = 5\ny_m = 0\nradius_m = 0.1\nblack = true";
        let scenario = Scenario::parse(&format!("[scanner]\n{keys}\n{post}"), "test").unwrap();
        assert!(scenario.obstacles[0].black && scenario.scanner.dead_rad.len() == 2);
        assert_eq!(Scenario::parse(&scenario.to_toml(), "written").unwrap(), scenario);
    }
}
