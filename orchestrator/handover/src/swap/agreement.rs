//! The summaries of samples that are compared, and how far two processes of one role may differ.
//!
//! Differences within the bounds do not affect the rest of the loop. The bounds are meant for another build or another
//! implementation of the same task; a factor widens them for one that drives differently on purpose.

use std::fmt;

use shared_types::{
    Actuation, ActuationKind, Command, CommandKind, MIN_RANGE_MM, Obstacles, Odometry, Pose, Role, Scan,
    Truth,
};
use vehicle::frame::wrap_angle;

use super::Meant;

/// Half of the allowed error of the estimate: the obstacle distance kept in reserve is twenty times as much [m].
pub const POSITION_M: f64 = 0.05;
/// At the end of the horizon of 2.5 m this is 0.05 m again [rad].
pub const YAW_RAD: f64 = 0.02;
/// A body's box and the same box half a scan later or without one of its corners; two bodies are further apart [m].
pub const BODY_M: f64 = 0.3;
/// Scans after which a body counts as seen: the other process may see one that enters the view a scan later.
pub const SIGHTINGS: u64 = 3;
/// A tenth of the highest velocity, about the change of the cruising velocity in a scan [m/s].
pub const VELOCITY_MPS: f64 = 0.1;
/// Least bound of the steering angle, a twentieth of its limit: two solvers that stop at different iterates [rad].
pub const STEERING_RAD: f64 = 0.003;
/// Beyond that, this share of the angle.
pub const STEERING_SHARE: f64 = 0.15;
/// Two robots that receive the same actuations stay at one place; an estimate does not show a step of a centimetre [m].
pub const TRUE_POSITION_M: f64 = 0.01;
/// A turn by this angle moves the far end of the laser's reach by 0.03 m [rad].
pub const TRUE_YAW_RAD: f64 = 0.005;
/// Ranges of one beam that are further apart are not of one surface: ten standard deviations of the noise [m].
pub const RANGE_M: f64 = 0.1;
/// This share of the beams may pass an edge on the other side, or be lost.
pub const BEAM_SHARE: f64 = 0.05;
/// Limits of what is sent are twice those of what is desired, (7.41), and so are the bounds.
pub const SENT_SCALE: f64 = 2.0;

/// The part of a sample that is compared.
#[derive(Debug, Clone, PartialEq)]
pub enum OutputSummary {
    /// Of a pose: yaw, x, y.
    Pose([f64; 3]),
    /// Of obstacles: the centres of all bodies, and whether this scan shows each.
    Obstacles(Vec<Body>),
    /// Of a command: kind, velocity, steering angle.
    Command(u32, f64, f64),
    /// Of an actuation: kind, sent velocity, sent steering angle.
    Actuation(u32, f64, f64),
    /// Of a robot: its measurements.
    Sensed(Box<Sensed>),
}

/// The measurements of a robot for one scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensed {
    /// Reported yaw, x, y [rad, m, m].
    pub reported: [f64; 3],
    /// True yaw, x, y; a real robot has none [rad, m, m].
    pub truth: Option<[f64; 3]>,
    /// Range per beam, below 20 an error code [mm].
    pub ranges_mm: Vec<u32>,
}

impl Sensed {
    /// From the samples of one scan.
    pub fn new(scan: &Scan, odometry: &Odometry, truth: Option<&Truth>) -> Self {
        Self {
            reported: [odometry.yaw_rad, odometry.x_m, odometry.y_m],
            truth: truth.map(|truth| [truth.yaw_rad, truth.x_m, truth.y_m]),
            ranges_mm: scan.ranges().to_vec(),
        }
    }

    /// How many beams show another surface than those of `other`, more than `limit_m` apart.
    fn other_beams(&self, other: &Self, limit_m: f64) -> usize {
        let is_other = |(one, other): &(&u32, &u32)| {
            let have_range = [one, other].map(|range| **range >= MIN_RANGE_MM);
            let apart_m = f64::from(one.abs_diff(**other)) * 1e-3;
            have_range[0] != have_range[1] || have_range[0] && apart_m > limit_m
        };
        let more = self.ranges_mm.len().abs_diff(other.ranges_mm.len());
        self.ranges_mm.iter().zip(&other.ranges_mm).filter(is_other).count() + more
    }
}

/// One body of a description.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Centre of its box [m].
    pub centre_m: [f64; 2],
    /// Whether this scan and enough scans before show it.
    pub seen: bool,
}

/// How much the new one differs from the old one, and what was allowed.
#[derive(Debug, Clone, PartialEq)]
pub enum Disagreement {
    /// A number is further off than allowed.
    Beyond {
        /// What it is.
        what: &'static str,
        /// How far it is off.
        difference: f64,
        /// How far it may be off.
        bound: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// One wants to drive and the other does not, or for another reason.
    Kind(String, String),
    /// A body is there for one only; its centre [m].
    Body(&'static str, [f64; 2]),
    /// The samples are of different types.
    Type,
}

impl fmt::Display for Disagreement {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Beyond { what, difference, bound, unit } => {
                write!(formatter, "{what} differs by {difference:.4} {unit}, allowed are {bound:.4} {unit}")
            }
            Self::Kind(old, new) => {
                write!(formatter, "kind differs: {old} by the old process, {new} by the new one")
            }
            Self::Body(side, [x_m, y_m]) => {
                write!(
                    formatter,
                    "only the {side} one has a body within {BODY_M} m of ({x_m:.2}, {y_m:.2}) m"
                )
            }
            Self::Type => write!(formatter, "the samples are of different types"),
        }
    }
}

impl From<&Pose> for OutputSummary {
    fn from(pose: &Pose) -> Self {
        Self::Pose([pose.yaw_rad, pose.x_m, pose.y_m])
    }
}

impl From<&Obstacles> for OutputSummary {
    fn from(obstacles: &Obstacles) -> Self {
        let mut known = Vec::new();
        let mut bodies = Vec::new();
        for item in obstacles.list() {
            if !known.contains(&item.body) {
                known.push(item.body);
                let seen = item.unseen_s <= 0.0 && item.sightings >= SIGHTINGS;
                bodies.push(Body { centre_m: [item.box_x_m, item.box_y_m], seen });
            }
        }
        Self::Obstacles(bodies)
    }
}

impl From<&Command> for OutputSummary {
    fn from(command: &Command) -> Self {
        Self::Command(command.kind, command.velocity_mps, command.steering_rad)
    }
}

impl From<&Actuation> for OutputSummary {
    fn from(actuation: &Actuation) -> Self {
        Self::Actuation(actuation.kind, actuation.sent_velocity_mps, actuation.sent_steering_rad)
    }
}

/// The first difference beyond the bounds, which `tolerance` is a factor on, and which [`Meant`] widens; nothing when both
/// agree.
pub fn disagreement(
    old: &OutputSummary,
    new: &OutputSummary,
    tolerance: f64,
    meant: &Meant,
) -> Option<Disagreement> {
    match (old, new) {
        (OutputSummary::Pose(old), OutputSummary::Pose(new)) => {
            placed(["position", "yaw"], old, new, reported_bounds(tolerance, meant))
        }
        (OutputSummary::Sensed(old), OutputSummary::Sensed(new)) => sensed(old, new, tolerance, meant),
        (OutputSummary::Obstacles(old), OutputSummary::Obstacles(new)) => {
            let limit = BODY_M * tolerance + meant.body_m;
            lacking(old, new, limit)
                .map(|centre| Disagreement::Body("old", centre))
                .or_else(|| lacking(new, old, limit).map(|centre| Disagreement::Body("new", centre)))
        }
        (OutputSummary::Command(kind, ..), OutputSummary::Command(other, ..)) if kind != other => {
            Some(Disagreement::Kind(command_name(*kind), command_name(*other)))
        }
        (OutputSummary::Actuation(kind, ..), OutputSummary::Actuation(other, ..)) if kind != other => {
            Some(Disagreement::Kind(actuation_name(*kind), actuation_name(*other)))
        }
        (OutputSummary::Command(kind, v_old, s_old), OutputSummary::Command(_, v_new, s_new)) => {
            let drives = *kind == CommandKind::Drive.wire();
            drives.then(|| control([*v_old, *s_old], [*v_new, *s_new], 1.0, tolerance, meant)).flatten()
        }
        (OutputSummary::Actuation(_, v_old, s_old), OutputSummary::Actuation(_, v_new, s_new)) => {
            control([*v_old, *s_old], [*v_new, *s_new], SENT_SCALE, tolerance, meant)
        }
        _ => Some(Disagreement::Type),
    }
}

/// Two measurements of one robot.
fn sensed(old: &Sensed, new: &Sensed, tolerance: f64, meant: &Meant) -> Option<Disagreement> {
    let truths = old.truth.zip(new.truth);
    let bounds =
        [TRUE_POSITION_M * tolerance + meant.true_position_m, TRUE_YAW_RAD * tolerance + meant.true_yaw_rad];
    let other = new.other_beams(old, RANGE_M * tolerance) as f64 / old.ranges_mm.len() as f64;
    truths
        .and_then(|(old, new)| placed(["true position", "true yaw"], &old, &new, bounds))
        .or_else(|| {
            let bounds = reported_bounds(tolerance, meant);
            placed(["reported position", "reported yaw"], &old.reported, &new.reported, bounds)
        })
        .or_else(|| {
            beyond(
                "the share of beams with another range",
                other,
                BEAM_SHARE * tolerance + meant.beam_share,
                "",
            )
        })
}

/// Bounds of an estimated or reported position and yaw.
fn reported_bounds(tolerance: f64, meant: &Meant) -> [f64; 2] {
    [POSITION_M * tolerance + meant.position_m, YAW_RAD * tolerance + meant.yaw_rad]
}

/// Two places, each as yaw, x, y.
fn placed(what: [&'static str; 2], old: &[f64; 3], new: &[f64; 3], bounds: [f64; 2]) -> Option<Disagreement> {
    let distance = (old[1] - new[1]).hypot(old[2] - new[2]);
    beyond(what[0], distance, bounds[0], "m")
        .or_else(|| beyond(what[1], wrap_angle(old[0] - new[0]).abs(), bounds[1], "rad"))
}

/// What [`differences`] compares for a role: names and units.
pub const fn quantities(role: Role) -> &'static [(&'static str, &'static str)] {
    match role {
        Role::Robot => &[
            ("reported x", "m"),
            ("reported y", "m"),
            ("reported yaw", "rad"),
            ("true position", "m"),
            ("share of other beams", ""),
        ],
        Role::Estimator => &[("x", "m"), ("y", "m"), ("yaw", "rad")],
        Role::Obstacles => &[("distance of bodies", "m"), ("bodies without match", "")],
        Role::Controller => &[("velocity", "m/s"), ("steering angle", "rad")],
        Role::Actuator => &[("sent velocity", "m/s"), ("sent steering angle", "rad")],
    }
}

/// The new one minus the old one for each of [`quantities`], distances without a sign; nothing when one drives and the
/// other does not.
pub fn differences(old: &OutputSummary, new: &OutputSummary) -> Option<Vec<f64>> {
    let places =
        |old: &[f64; 3], new: &[f64; 3]| vec![new[1] - old[1], new[2] - old[2], wrap_angle(new[0] - old[0])];
    Some(match (old, new) {
        (OutputSummary::Pose(old), OutputSummary::Pose(new)) => places(old, new),
        (OutputSummary::Sensed(old), OutputSummary::Sensed(new)) => {
            let truths = old.truth.zip(new.truth);
            let apart = truths.map_or(0.0, |(old, new)| (new[1] - old[1]).hypot(new[2] - old[2]));
            let other = new.other_beams(old, RANGE_M) as f64 / old.ranges_mm.len() as f64;
            [places(&old.reported, &new.reported), vec![apart, other]].concat()
        }
        (OutputSummary::Obstacles(old), OutputSummary::Obstacles(new)) => {
            let distances = old.iter().filter_map(|body| nearest_m(body, new)).filter(|gap| *gap <= BODY_M);
            let matched: Vec<f64> = distances.collect();
            let without = old.iter().filter(|body| is_lacking(body, new, BODY_M)).count()
                + new.iter().filter(|body| is_lacking(body, old, BODY_M)).count();
            vec![matched.iter().sum::<f64>() / matched.len().max(1) as f64, without as f64]
        }
        (OutputSummary::Command(kind, v_old, s_old), OutputSummary::Command(other, v_new, s_new))
        | (OutputSummary::Actuation(kind, v_old, s_old), OutputSummary::Actuation(other, v_new, s_new))
            if kind == other =>
        {
            vec![v_new - v_old, s_new - s_old]
        }
        _ => return None,
    })
}

/// Velocity and steering angle; `scale` is that of the limits of both.
fn control(old: [f64; 2], new: [f64; 2], scale: f64, tolerance: f64, meant: &Meant) -> Option<Disagreement> {
    let velocity = scale * (tolerance * VELOCITY_MPS + meant.velocity_mps);
    let steering =
        tolerance * (STEERING_RAD * scale).max(STEERING_SHARE * old[1].abs()) + scale * meant.steering_rad;
    beyond("velocity", (old[0] - new[0]).abs(), velocity, "m/s")
        .or_else(|| beyond("steering angle", (old[1] - new[1]).abs(), steering, "rad"))
}

fn beyond(what: &'static str, difference: f64, bound: f64, unit: &'static str) -> Option<Disagreement> {
    // NaN is not within: a comparison with it is false.
    let within = difference <= bound;
    (!within).then_some(Disagreement::Beyond { what, difference, bound, unit })
}

/// The first body of `these` that the scan shows and that is not among `those`.
fn lacking(these: &[Body], those: &[Body], limit_m: f64) -> Option<[f64; 2]> {
    these.iter().find(|body| is_lacking(body, those, limit_m)).map(|body| body.centre_m)
}

/// Whether the scan shows a body that is not among `those`.
fn is_lacking(body: &Body, those: &[Body], limit_m: f64) -> bool {
    body.seen && nearest_m(body, those).is_none_or(|distance| distance > limit_m)
}

/// Distance to the nearest of `those` [m].
fn nearest_m(body: &Body, those: &[Body]) -> Option<f64> {
    let [x_m, y_m] = body.centre_m;
    those.iter().map(|other| (x_m - other.centre_m[0]).hypot(y_m - other.centre_m[1])).min_by(f64::total_cmp)
}

fn command_name(kind: u32) -> String {
    CommandKind::try_from(kind).map_or_else(|_| kind.to_string(), |kind| kind.name().to_owned())
}

fn actuation_name(kind: u32) -> String {
    ActuationKind::try_from(kind).map_or_else(|_| kind.to_string(), |kind| kind.name().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::{BEAMS, CommandKind, MAX_BEAMS, Obstacle, ScanGeometry};

    fn command(velocity_mps: f64, steering_rad: f64) -> OutputSummary {
        let kind = CommandKind::Drive.wire();
        OutputSummary::from(&Command { kind, velocity_mps, steering_rad, ..Command::default() })
    }

    fn text_of(old: &OutputSummary, new: &OutputSummary) -> String {
        disagreement(old, new, 1.0, &Meant::default()).map_or_else(String::new, |found| found.to_string())
    }

    #[test]
    fn a_fifth_more_steering_is_too_much_and_a_tenth_is_not() {
        assert_eq!(text_of(&command(1.0, 0.04), &command(1.05, 0.044)), "");
        assert_eq!(
            text_of(&command(1.0, 0.04), &command(1.0, 0.048)),
            "steering angle differs by 0.0080 rad, allowed are 0.0060 rad"
        );
        assert_eq!(text_of(&command(1.0, 0.0), &command(1.0, 0.0029)), "", "close to straight on");
        assert!(
            text_of(&command(1.0, 0.0), &command(0.89, 0.0)).starts_with("velocity differs by 0.1100 m/s")
        );
        assert!(
            text_of(&command(0.5, 0.0), &command(0.61, 0.0)).starts_with("velocity differs by 0.1100 m/s")
        );
        // To the right as to the left.
        assert_eq!(text_of(&command(1.0, -0.04), &command(1.0, -0.045)), "");
        assert_eq!(
            text_of(&command(1.0, -0.04), &command(1.0, -0.032)),
            "steering angle differs by 0.0080 rad, allowed are 0.0060 rad"
        );
        assert!(disagreement(&command(1.0, 0.04), &command(1.0, 0.048), 2.0, &Meant::default()).is_none());
    }

    #[test]
    fn what_a_setting_is_meant_to_change_may_differ_as_much_more_and_nothing_else() {
        let meant = Meant { velocity_mps: 0.2, ..Meant::default() };
        let of = |new: OutputSummary| {
            disagreement(&command(1.0, 0.0), &new, 1.0, &meant).map(|found| found.to_string())
        };
        assert_eq!(of(command(0.71, 0.0)), None);
        let beyond = "velocity differs by 0.3100 m/s, allowed are 0.3000 m/s";
        assert_eq!(of(command(0.69, 0.0)).as_deref(), Some(beyond));
        let steering = "steering angle differs by 0.0040 rad, allowed are 0.0030 rad";
        assert_eq!(of(command(1.0, 0.004)).as_deref(), Some(steering));
        let stop = OutputSummary::from(&Command::default());
        assert!(of(stop).is_some_and(|text| text.starts_with("kind differs")));
        assert!(of(command(f64::NAN, 0.0)).is_some());
    }

    #[test]
    fn a_drive_and_a_stop_disagree() {
        let stop = OutputSummary::from(&Command::default());
        assert_eq!(
            text_of(&command(0.5, 0.0), &stop),
            "kind differs: drive by the old process, stop by the new one"
        );
        let turned = OutputSummary::from(&Command { steering_rad: 0.06, ..Command::default() });
        assert_eq!(text_of(&stop, &turned), "", "the angle of a stop is not driven");
    }

    #[test]
    fn poses_are_compared_across_the_turn_of_the_angle() {
        let pose = |yaw_rad, x_m| OutputSummary::from(&Pose { yaw_rad, x_m, ..Pose::default() });
        assert_eq!(text_of(&pose(3.135, 1.0), &pose(-3.135, 1.04)), "");
        assert_eq!(
            text_of(&pose(0.0, 1.0), &pose(0.0, 1.06)),
            "position differs by 0.0600 m, allowed are 0.0500 m"
        );
        assert!(text_of(&pose(0.0, 1.0), &pose(0.021, 1.0)).starts_with("yaw differs by 0.0210 rad"));
        assert!(text_of(&pose(0.0, 1.0), &pose(f64::NAN, 1.0)).starts_with("yaw differs by NaN rad"));
    }

    /// A robot with all ranges 2 m.
    fn robot() -> Sensed {
        let scan = Scan { ranges_mm: [2000; MAX_BEAMS], ..Scan::of(ScanGeometry::URG_04LX) };
        Sensed::new(&scan, &Odometry::default(), Some(&Truth::default()))
    }

    fn text_of_robots(change: impl FnOnce(&mut Sensed)) -> String {
        let mut new = robot();
        change(&mut new);
        text_of(&OutputSummary::Sensed(Box::new(robot())), &OutputSummary::Sensed(Box::new(new)))
    }

    #[test]
    fn robots_are_compared_by_their_places_and_by_the_share_of_their_beams() {
        assert_eq!(text_of_robots(|_| {}), "");
        let truth = text_of_robots(|new| new.truth = Some([0.0, 0.0, -0.011]));
        assert_eq!(truth, "true position differs by 0.0110 m, allowed are 0.0100 m");
        let truth = text_of_robots(|new| new.truth = Some([0.006, 0.0, 0.0]));
        assert_eq!(truth, "true yaw differs by 0.0060 rad, allowed are 0.0050 rad");
        let reported = text_of_robots(|new| new.reported[1] = 0.06);
        assert_eq!(reported, "reported position differs by 0.0600 m, allowed are 0.0500 m");
        assert_eq!(text_of_robots(|new| (new.truth, new.reported[1]) = (None, 0.049)), "", "a real robot");
        // 34 of 682 beams are 4.99 %; lost ones count, and those within a tenth of a metre do not.
        assert_eq!(text_of_robots(|new| new.ranges_mm[..34].fill(2101)), "");
        let beams = "the share of beams with another range differs by 0.0513 , allowed are 0.0500 ";
        assert_eq!(text_of_robots(|new| new.ranges_mm[..35].fill(1899)), beams);
        assert_eq!(text_of_robots(|new| new.ranges_mm[..35].fill(MIN_RANGE_MM - 1)), beams);
        assert_eq!(text_of_robots(|new| new.ranges_mm.fill(2100)), "");
        // Beams that one of them has not show another surface too.
        assert_eq!(text_of_robots(|new| new.ranges_mm.truncate(BEAMS - 34)), "");
        assert_eq!(text_of_robots(|new| new.ranges_mm.truncate(BEAMS - 35)), beams);
        let mut lost = robot();
        lost.ranges_mm.fill(0);
        assert_eq!(lost.other_beams(&Sensed { ranges_mm: vec![19; BEAMS], ..lost.clone() }, 0.001), 0);
        assert_eq!(robot().other_beams(&Sensed { ranges_mm: vec![MIN_RANGE_MM; BEAMS], ..robot() }, 1.98), 0);
    }

    #[test]
    fn each_bound_grows_with_the_tolerance_and_by_what_a_setting_is_meant_to_change() {
        let meant = Meant {
            steering_rad: 0.001,
            position_m: 0.02,
            yaw_rad: 0.03,
            true_position_m: 0.04,
            true_yaw_rad: 0.05,
            beam_share: 0.06,
            ..Meant::default()
        };
        let bound = |old: &OutputSummary, new: &OutputSummary| match disagreement(old, new, 2.0, &meant) {
            Some(Disagreement::Beyond { difference, bound, .. }) => {
                [difference, bound].map(|number| (number * 1e6).round() / 1e6)
            }
            other => panic!("{other:?}"),
        };
        let of = |change: fn(&mut Sensed)| {
            let mut old = robot();
            (old.reported, old.truth) = ([0.5, 1.0, 2.0], Some([0.5, 1.0, 2.0]));
            let mut new = old.clone();
            change(&mut new);
            bound(&OutputSummary::Sensed(Box::new(old)), &OutputSummary::Sensed(Box::new(new)))
        };
        assert_eq!(of(|new| new.truth = Some([0.5, 4.0, 6.0])), [5.0, 0.06]);
        assert_eq!(of(|new| new.truth = Some([1.0, 1.0, 2.0])), [0.5, 0.06]);
        assert_eq!(of(|new| new.reported = [0.5, 4.0, 6.0]), [5.0, 0.12]);
        assert_eq!(of(|new| new.reported[0] = 1.0), [0.5, 0.07]);
        // A beam counts when its range differs by more than twice a tenth of a metre.
        assert_eq!(
            of(|new| {
                new.ranges_mm[..341].fill(1799);
                new.ranges_mm[341..].fill(2200);
            }),
            [0.5, 0.16]
        );
        assert_eq!(bound(&command(1.0, -0.1), &command(1.0, 0.1)), [0.2, 0.031]);
        let moved = |x_m, y_m| OutputSummary::from(&Pose { x_m, y_m, ..Pose::default() });
        assert_eq!(bound(&moved(1.0, 2.0), &moved(4.0, 6.0)), [5.0, 0.12]);
    }

    #[test]
    fn truths_are_compared_by_their_distance_and_two_bodies_at_the_bound_are_one() {
        let sensed = |truth| OutputSummary::Sensed(Box::new(Sensed { truth, ..robot() }));
        let of = |old, new| differences(&sensed(Some(old)), &sensed(Some(new))).unwrap()[3];
        assert_eq!(of([0.0, 1.0, 2.0], [0.0, 4.0, 6.0]), 5.0);
        let body = |x_m| Body { centre_m: [x_m, 3.0], seen: true };
        assert!(!is_lacking(&body(1.0), &[body(1.25)], 0.25) && is_lacking(&body(1.0), &[body(1.25)], 0.24));
    }

    #[test]
    fn what_is_sent_may_differ_twice_as_much_as_what_is_desired() {
        let sent = |kind: ActuationKind, sent_velocity_mps, sent_steering_rad| {
            let kind = kind.wire();
            let actuation = Actuation { kind, sent_velocity_mps, sent_steering_rad, ..Actuation::default() };
            OutputSummary::from(&actuation)
        };
        let old = sent(ActuationKind::Drive, 1.0, 0.0);
        assert_eq!(text_of(&old, &sent(ActuationKind::Drive, 1.19, 0.0059)), "");
        let text = text_of(&old, &sent(ActuationKind::Drive, 0.79, 0.0));
        assert_eq!(text, "velocity differs by 0.2100 m/s, allowed are 0.2000 m/s");
        let text = text_of(&old, &sent(ActuationKind::Drive, 1.0, -0.0061));
        assert_eq!(text, "steering angle differs by 0.0061 rad, allowed are 0.0060 rad");
        let text = text_of(&old, &sent(ActuationKind::Block, 1.0, 0.0));
        assert_eq!(text, "kind differs: drive by the old process, block by the new one");
        assert_eq!(text_of(&old, &command(1.0, 0.0)), "the samples are of different types");
        let unknown = OutputSummary::Command(77, 0.0, 0.0);
        assert!(text_of(&command(1.0, 0.0), &unknown).ends_with("77 by the new one"));
        let unknown = OutputSummary::Actuation(77, 0.0, 0.0);
        assert!(text_of(&old, &unknown).ends_with("77 by the new one"));
    }

    #[test]
    fn differences_are_those_of_the_new_one() {
        let pose = |yaw_rad, x_m, y_m| OutputSummary::from(&Pose { yaw_rad, x_m, y_m, ..Pose::default() });
        assert_eq!(differences(&pose(0.5, 1.0, 4.0), &pose(0.25, 3.0, 3.0)), Some(vec![2.0, -1.0, -0.25]));
        let mut other = robot();
        (other.reported, other.truth) = ([0.25, 1.0, 2.0], Some([0.0, 3.0, 4.0]));
        other.ranges_mm[..341].fill(1000);
        let robots = [robot(), other].map(|sensed| OutputSummary::Sensed(Box::new(sensed)));
        assert_eq!(differences(&robots[0], &robots[1]), Some(vec![1.0, 2.0, 0.25, 5.0, 0.5]));
        assert_eq!(differences(&command(1.0, 0.5), &command(0.5, 0.75)), Some(vec![-0.5, 0.25]));
        assert_eq!(differences(&command(1.0, 0.5), &OutputSummary::from(&Command::default())), None);
        let at = |places: &[(f64, bool)]| {
            let bodies = places.iter().map(|(x, seen)| Body { centre_m: [*x, 0.0], seen: *seen });
            OutputSummary::Obstacles(bodies.collect())
        };
        // 0.125 and 0.25 m apart, one lacks here and two there, of which the scan shows one.
        let old = at(&[(1.0, true), (2.0, true), (5.0, true)]);
        let new = at(&[(1.125, true), (2.25, true), (7.0, true), (9.0, false)]);
        assert_eq!(differences(&old, &new), Some(vec![0.1875, 2.0]));
        for role in Role::ALL {
            assert!((2..=5).contains(&quantities(*role).len()), "{role}");
        }
        assert_eq!(quantities(Role::Robot).len(), differences(&robots[0], &robots[1]).unwrap().len());
    }

    #[test]
    fn bodies_are_matched_by_place_whatever_their_numbers() {
        let described = |bodies: &[(u32, f64, u64)]| {
            let mut obstacles = Obstacles { count: bodies.len() as u32, ..Obstacles::default() };
            for (item, (body, box_x_m, sightings)) in obstacles.items.iter_mut().zip(bodies) {
                *item =
                    Obstacle { body: *body, box_x_m: *box_x_m, sightings: *sightings, ..Obstacle::default() };
            }
            OutputSummary::from(&obstacles)
        };
        // Two ellipses of one body count once, and the numbers of bodies may differ.
        let old = described(&[(1, 5.0, 9), (1, 5.0, 9), (2, 8.0, 9)]);
        assert_eq!(text_of(&old, &described(&[(7, 7.8, 9), (4, 5.2, 9)])), "");
        assert_eq!(
            text_of(&old, &described(&[(1, 5.0, 9)])),
            "only the old one has a body within 0.3 m of (8.00, 0.00) m"
        );
        assert!(text_of(&described(&[(1, 5.0, 9)]), &old).starts_with("only the new one"));
        assert_eq!(
            text_of(&old, &described(&[(1, 5.0, 9), (2, 8.0, 9), (3, 9.5, 1)])),
            "",
            "just come into view"
        );
        let meant = Meant { body_m: 0.1, ..Meant::default() };
        let apart = |x_m| disagreement(&old, &described(&[(1, 5.0, 9), (2, x_m, 9)]), 2.0, &meant);
        assert_eq!(apart(8.69), None, "twice 0.3 m and 0.1 m");
        assert_eq!(apart(8.71), Some(Disagreement::Body("old", [8.0, 0.0])));
    }
}
