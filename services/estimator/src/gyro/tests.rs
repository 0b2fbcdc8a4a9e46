use super::*;

const LIMIT_RADPS: f64 = 1.0;

fn sample(scan_id: u64, yaw_rate_radps: f64) -> GyroSample {
    GyroSample { scan_id, yaw_rate_radps, dt_s: 0.1 }
}

/// A robot that drives one metre per scan; the odometry reports a yaw that is wrong by a share of the turn.
struct Drive {
    gyro: GyroState,
    scan_id: u64,
    reported_rad: f64,
    place: [f64; 2],
    pose: Planar,
}

impl Drive {
    fn begin() -> Self {
        let mut gyro = GyroState::default();
        gyro.note(GyroSample { scan_id: 1, ..GyroSample::default() });
        gyro.begin(1, Planar::default());
        Self { gyro, scan_id: 1, reported_rad: 0.0, place: [0.0; 2], pose: Planar::default() }
    }

    /// The next scan, with the rates of scans whose samples come before it.
    fn scan(&mut self, reported_radps: f64, distance_m: f64, samples: &[GyroSample]) {
        self.scan_id += 1;
        samples.iter().for_each(|sample| self.gyro.note(*sample));
        let middle_rad = self.reported_rad + 0.05 * reported_radps;
        self.reported_rad += 0.1 * reported_radps;
        self.place[0] += distance_m * middle_rad.cos();
        self.place[1] += distance_m * middle_rad.sin();
        let reported = Planar { yaw: wrap_angle(self.reported_rad), x: self.place[0], y: self.place[1] };
        let is_blocked = distance_m == 0.0;
        let interval = Interval {
            scan_id: self.scan_id,
            dt_s: 0.1,
            limit_radps: LIMIT_RADPS + MAX_BIAS_RADPS,
            is_blocked,
        };
        self.pose = self.gyro.replace(reported, &interval);
    }

    /// [`Self::scan`] with the sample of that scan.
    fn measured(&mut self, reported_radps: f64, distance_m: f64, rate_radps: f64) {
        self.scan(reported_radps, distance_m, &[sample(self.scan_id + 1, rate_radps)]);
    }

    fn kept(&self, fault: GyroFault) -> u64 {
        self.gyro.kept[fault as usize]
    }

    fn yaw_is(&self, yaw_rad: f64) -> bool {
        wrap_angle(self.pose.yaw - yaw_rad).abs() < 1e-12
    }
}

#[test]
fn without_a_gyro_reports_stay_as_they_are_to_the_bit() {
    let mut gyro = GyroState::default();
    gyro.begin(1, Planar::default());
    let reported = Planar { yaw: 0.3, x: -0.0, y: 0.1 };
    let interval = Interval { scan_id: 2, dt_s: 0.1, limit_radps: 1.0, is_blocked: false };
    let bits = |pose: Planar| [pose.yaw, pose.x, pose.y].map(f64::to_bits);
    assert_eq!(bits(gyro.replace(reported, &interval)), bits(reported));
    assert_eq!(gyro.kept, [0; 4]);
}

#[test]
fn yaw_and_way_follow_the_gyro() {
    // The odometry reports that it drives straight; the robot turns by 0.5 rad/s, a metre per scan.
    let mut drive = Drive::begin();
    let (mut x, mut y) = (0.0, 0.0);
    for scan in 0..10 {
        let middle_rad = 0.05 * f64::from(scan) + 0.025;
        (x, y) = (x + middle_rad.cos(), y + middle_rad.sin());
        drive.measured(0.0, 1.0, 0.5 + f64::from(scan % 2) * 1e-9);
    }
    assert!((drive.pose.yaw - 0.5).abs() < 1e-8, "{:?}", drive.pose);
    assert!((drive.pose.x - x).abs() < 1e-7 && (drive.pose.y - y).abs() < 1e-7, "{:?}", drive.pose);
    assert_eq!((drive.gyro.replaced, drive.gyro.kept), (10, [0; 4]));
}

#[test]
fn a_late_sample_replaces_its_turn_afterwards_and_one_that_never_comes_is_missing() {
    let mut drive = Drive::begin();
    drive.scan(0.2, 1.0, &[]);
    assert!(drive.yaw_is(0.02));
    drive.scan(0.2, 1.0, &[sample(2, 0.5), sample(3, 0.6)]);
    assert!(drive.yaw_is(0.11), "{:?}", drive.pose);
    (0..5).for_each(|_| drive.scan(0.2, 1.0, &[]));
    assert!(drive.yaw_is(0.21) && drive.kept(GyroFault::Missing) == 1);
    // Too late: nothing waits for it any more.
    drive.scan(0.2, 1.0, &[sample(4, 0.9)]);
    assert!(drive.yaw_is(0.23) && drive.kept(GyroFault::Missing) == 2 && drive.gyro.sample_count == 0);
}

#[test]
fn a_turn_over_lost_scans_takes_the_samples_of_all_of_them() {
    let mut drive = Drive::begin();
    drive.gyro.note(sample(2, 0.5));
    drive.gyro.note(sample(3, 0.7));
    let interval = Interval { scan_id: 3, dt_s: 0.2, limit_radps: LIMIT_RADPS, is_blocked: false };
    let pose = drive.gyro.replace(Planar { yaw: 0.0, x: 2.0, y: 0.0 }, &interval);
    assert!((pose.yaw - 0.12).abs() < 1e-12 && drive.gyro.kept == [0; 4], "{pose:?}");
}

#[test]
fn a_sample_that_cannot_be_true_leaves_the_turn_of_the_odometry() {
    for (rate_radps, dt_s, fault) in [
        (f64::NAN, 0.1, GyroFault::TooFast),
        (f64::INFINITY, 0.1, GyroFault::TooFast),
        (1.2, 0.1, GyroFault::TooFast),
        (-1.2, 0.1, GyroFault::TooFast),
        (0.5, -0.1, GyroFault::Interval),
        (0.5, 10.0, GyroFault::Interval),
        (0.5, f64::NAN, GyroFault::Interval),
    ] {
        let mut drive = Drive::begin();
        drive.scan(0.2, 1.0, &[GyroSample { scan_id: 2, yaw_rate_radps: rate_radps, dt_s }]);
        assert!(drive.yaw_is(0.02), "{rate_radps} {dt_s} {:?}", drive.pose);
        assert_eq!((drive.kept(fault), drive.gyro.replaced), (1, 0), "{rate_radps} {dt_s}");
        drive.measured(0.2, 1.0, 0.5);
        assert!(drive.yaw_is(0.07) && drive.gyro.check().is_ok(), "{rate_radps} {dt_s}");
    }
}

#[test]
fn a_gyro_that_sticks_is_found_and_what_was_believed_is_taken_back() {
    let mut drive = Drive::begin();
    drive.measured(0.0, 1.0, 0.001);
    // It sticks at 0.001 rad/s while the robot begins to turn by 0.5 rad/s.
    (0..10).for_each(|_| drive.measured(0.5, 1.0, 0.001));
    assert!(drive.yaw_is(0.0001 + 0.5), "{:?}", drive.pose);
    assert_eq!(drive.kept(GyroFault::Stuck), 10);
    drive.measured(0.5, 1.0, 0.4);
    assert!(drive.yaw_is(0.0001 + 0.5 + 0.04) && drive.kept(GyroFault::Stuck) == 10);
    // One that repeats its rate while the odometry agrees is not stuck.
    (0..10).for_each(|_| drive.measured(0.4, 1.0, 0.4));
    assert_eq!(drive.kept(GyroFault::Stuck), 10);
}

#[test]
fn the_bias_is_learned_at_rest_and_a_robot_that_rests_does_not_turn() {
    let mut drive = Drive::begin();
    let rest = |drive: &mut Drive, scans: u32| {
        (0..scans).for_each(|scan| drive.measured(0.0, 0.0, if scan % 2 == 0 { 0.029 } else { 0.031 }));
    };
    rest(&mut drive, 20);
    // Before it has stood for long enough to be at rest, it may still turn.
    let turned_rad = drive.pose.yaw;
    assert!(turned_rad < 0.03 * 0.1 * 5.0 && drive.gyro.rest_s < MIN_REST_S, "{turned_rad}");
    drive.measured(0.0, 1.0, 0.03);
    assert!(drive.yaw_is(turned_rad + 0.003), "not yet: {:?}", drive.pose);
    rest(&mut drive, 30);
    let turned_rad = drive.pose.yaw;
    rest(&mut drive, 100);
    assert!(drive.yaw_is(turned_rad), "{:?}", drive.pose);
    assert!((drive.gyro.bias_radps - 0.03).abs() < 1e-4, "{}", drive.gyro.bias_radps);
    for rate in [0.23, 0.2300001, 0.2299999] {
        drive.measured(0.0, 1.0, rate);
    }
    assert!(wrap_angle(drive.pose.yaw - turned_rad - 0.06).abs() < 1e-4, "{:?}", drive.pose);
    assert_eq!(drive.gyro.kept, [0; 4]);
}

#[test]
fn a_state_with_a_number_that_is_not_finite_or_a_count_too_large_is_refused() {
    let state = GyroState::default();
    assert!(state.check().is_ok());
    assert!(GyroState { bias_radps: f64::NAN, ..state }.check().is_err());
    assert!(GyroState { added: [0.0, f64::INFINITY, 0.0], ..state }.check().is_err());
    assert!(GyroState { sample_count: 9, ..state }.check().is_err());
    assert!(GyroState { turn_count: 5, ..state }.check().is_err());
}
