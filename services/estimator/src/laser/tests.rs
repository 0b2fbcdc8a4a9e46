//! Scans of places that are drawn by hand.

use nalgebra::{Matrix3, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shared_types::{BEAMS, Scan, ScanGeometry};
use vehicle::frame::heading;
use vehicle::{Description, Surroundings, Track};

use super::align::align;
use super::known::{Stated, given, surfaces, within};
use super::pieces::{Piece, Pieces, SweepMotion};
use super::search::has_turned;
use super::surface::{SurfaceLine, SurfaceMap};
use super::{LaserMode, LaserState, Matcher};
use crate::dead_reckoning::{DeadReckoning, DriftSources, OdometryStep};

/// What a beam hits.
#[derive(Clone, Copy)]
enum Body {
    /// From one corner to another.
    Wall([f64; 2], [f64; 2]),
    /// Middle and radius.
    Post([f64; 2], f64),
}

impl Body {
    /// Distance along a beam.
    fn range(&self, from: Vector2<f64>, direction: Vector2<f64>) -> f64 {
        match *self {
            Self::Wall(one, other) => {
                let (one, other) = (Vector2::from(one) - from, Vector2::from(other) - from);
                let along = other - one;
                let cross = direction.perp(&along);
                let (range, share) = (one.perp(&along) / cross, one.perp(&direction) / cross);
                if range > 0.0 && (0.0..=1.0).contains(&share) { range } else { f64::INFINITY }
            }
            Self::Post(middle, radius) => {
                let middle = Vector2::from(middle) - from;
                let ahead = middle.dot(&direction);
                let inside = radius * radius - (middle.norm_squared() - ahead * ahead);
                if ahead > 0.0 && inside > 0.0 { ahead - inside.sqrt() } else { f64::INFINITY }
            }
        }
    }
}

/// A normal number, by twelve even ones.
fn normal(generator: &mut Pcg64) -> f64 {
    (0..12).map(|_| generator.random::<f64>()).sum::<f64>() - 6.0
}

/// A box of this length and width.
fn boxed([x, y]: [f64; 2], [length, width]: [f64; 2]) -> [Body; 4] {
    let corner = |along: f64, across: f64| [x + along * length / 2.0, y + across * width / 2.0];
    let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    [0, 1, 2, 3].map(|side| Body::Wall(corners[side], corners[(side + 1) % 4]))
}

/// A scan from a pose (yaw, x, y), with noise of 10 mm that differs from scan to scan.
fn scan(number: u64, [yaw, x, y]: [f64; 3], bodies: &[Body]) -> Scan {
    let mut scan = Scan { sweep_ns: 66_666_667, ..Scan::of(ScanGeometry::URG_04LX) };
    scan.header.acquired_ns = number * 100_000_000;
    let mut generator = Pcg64::seed_from_u64(number);
    for beam in 0..BEAMS {
        let direction = heading(yaw + ScanGeometry::URG_04LX.yaw_rad(beam));
        let ranges = bodies.iter().map(|body| body.range(Vector2::new(x, y), direction));
        let range_m = ranges.fold(f64::INFINITY, f64::min);
        let noise_m = 0.01 * normal(&mut generator);
        if range_m < 5.6 {
            scan.ranges_mm[beam] = (1e3 * (range_m + noise_m)) as u32;
        }
    }
    scan
}

fn pieces(bodies: &[Body]) -> Pieces {
    let mut pieces = Pieces::default();
    pieces.find(&scan(1, [0.0; 3], bodies), &Description::default(), &SweepMotion::default(), 0.0);
    pieces
}

/// A room of 8 m by 6 m, with a box in it.
fn room() -> Vec<Body> {
    [boxed([1.0, 0.0], [8.0, 6.0]), boxed([3.0, 1.0], [0.5, 0.8])].concat()
}

/// Walls at 1.5 m on both sides, without an end.
const CORRIDOR: [Body; 2] = [Body::Wall([-50.0, 1.5], [50.0, 1.5]), Body::Wall([-50.0, -1.5], [50.0, -1.5])];

#[test]
fn a_wall_is_one_piece_on_its_line() {
    let pieces = pieces(&[Body::Wall([2.0, -1.5], [2.0, 1.5])]);
    let [piece] = pieces.all() else { panic!("{:?}", pieces.all()) };
    assert!((piece.mean.x - 2.0).abs() < 0.003 && piece.normal.x < -0.999, "{piece:?}");
    assert!((0.007..0.013).contains(&pieces.noise_m), "{}", pieces.noise_m);
    // The edges are half a beam beyond the last returns: 6 mm at 2.5 m.
    let (middle, sigma_m) = piece.middle.unwrap();
    assert!(middle.y.abs() < 3.0 * sigma_m && sigma_m < 0.01, "{middle} {sigma_m}");
}

#[test]
fn two_sides_of_a_box_are_two_pieces_a_small_round_body_is_one_and_a_large_one_none() {
    let corner = pieces(&boxed([2.0, 1.0], [1.0, 1.0]));
    let normals: Vec<_> = corner.all().iter().map(|piece| piece.normal).collect();
    assert_eq!(normals.len(), 2, "{normals:?}");
    assert!(normals[0].dot(&normals[1]).abs() < 0.05, "{normals:?}");
    for radius in [0.15, 0.2, 0.4] {
        let round = pieces(&[Body::Post([2.5 + radius, 0.3], radius)]);
        let [Piece { round: Some(circle), .. }] = round.all() else { panic!("{radius}: {:?}", round.all()) };
        let off_m = (circle.middle - Vector2::new(2.5 + radius, 0.3)).norm();
        assert!(off_m < 0.03 && (circle.radius_m - radius).abs() < 0.03, "{radius}: {circle:?}");
    }
    let large = pieces(&[Body::Post([3.5, 0.3], 1.0)]);
    assert!(large.all().is_empty(), "{:?}", large.all());
}

#[test]
fn what_is_partly_hidden_has_no_middle() {
    // A post in front of the wall's left end.
    let pieces = pieces(&[Body::Wall([3.0, -1.0], [3.0, 1.0]), Body::Post([1.5, 0.5], 0.1)]);
    let right = pieces.all().iter().max_by(|one, other| one.ends[1].y.total_cmp(&other.ends[1].y)).unwrap();
    assert!(right.ends[1].y < 0.8 && right.middle.is_none(), "{right:?}");
}

#[test]
fn the_sweep_of_a_robot_that_drives_and_turns_is_made_straight() {
    let motion = SweepMotion { speed_mps: 1.0, yaw_rate_radps: 0.3 };
    let wall = [Body::Wall([-3.0, 2.0], [6.0, 2.0])];
    let mut swept = scan(1, [0.0; 3], &[]);
    for beam in 0..BEAMS {
        let time_s = swept.beam_time_s(beam);
        let yaw = motion.yaw_rate_radps * time_s;
        let place = heading(yaw / 2.0) * (motion.speed_mps * time_s);
        swept.ranges_mm[beam] = scan(1, [yaw, place.x, place.y], &wall).ranges_mm[beam];
    }
    let mut pieces = Pieces::default();
    let mut off_rad = |motion: &SweepMotion| {
        pieces.find(&swept, &Description::default(), motion, 0.0);
        pieces.all().iter().map(|piece| piece.normal.x.abs()).fold(0.0, f64::max)
    };
    let (straight, bent) = (off_rad(&motion), off_rad(&SweepMotion::default()));
    assert!(straight < 0.01 && bent > 2.0 * straight, "{straight} {bent}");
}

/// Lines of a room, as if they had been seen before.
fn lines() -> Vec<SurfaceLine> {
    let side = |normal: [f64; 2], middle: [f64; 2], half_m: f64| SurfaceLine {
        normal: Vector2::from(normal),
        middle: Vector2::from(middle),
        extent_m: [-half_m, half_m],
        closed_m: [-half_m, half_m],
        is_long: half_m > 0.75,
        covariance: Matrix3::zeros(),
        seen_from: Vector2::zeros(),
        off_m: 0.0,
        center: None,
        radius_m: 0.0,
        index: None,
        counts: true,
    };
    vec![
        side([-1.0, 0.0], [5.0, 0.0], 3.0),
        side([0.0, -1.0], [1.0, 3.0], 4.0),
        side([0.0, 1.0], [1.0, -3.0], 4.0),
        side([-1.0, 0.0], [2.75, 1.0], 0.4),
    ]
}

fn known(pose: [f64; 3], deviations: [f64; 3]) -> DeadReckoning {
    let covariance =
        Matrix3::from_diagonal(&Vector3::from(deviations.map(|deviation| deviation * deviation)));
    DeadReckoning::begin(pose, &covariance, &DriftSources::default())
}

#[test]
fn the_pose_in_a_room_is_found_to_millimetres_from_a_wrong_guess() {
    let truth = [0.05, 0.1, -0.2];
    let mut pieces = Pieces::default();
    pieces.find(&scan(1, truth, &room()), &Description::default(), &SweepMotion::default(), 0.0);
    for guess in [[0.05, 0.1, -0.2], [0.0, 0.0, -0.1], [0.1, 0.2, -0.3]] {
        let mut reckoning = known(guess, [0.1, 0.2, 0.2]);
        let found = align(&pieces, &lines(), &reckoning).unwrap();
        assert!(reckoning.correct(&found.sighting));
        let [yaw, x, y] = reckoning.pose;
        assert!((yaw - truth[0]).abs() < 0.003, "{yaw}");
        assert!((x - truth[1]).abs() < 0.008 && (y - truth[2]).abs() < 0.008, "{x} {y}");
        assert!(reckoning.of_pose().diagonal().max() < 0.03_f64.powi(2), "{}", reckoning.of_pose());
    }
}

#[test]
fn walls_along_the_way_show_no_way() {
    let mut pieces = Pieces::default();
    pieces.find(&scan(1, [0.02, 0.0, 0.1], &CORRIDOR), &Description::default(), &SweepMotion::default(), 0.0);
    let track = Track { y_m: [-1.5, 1.5], x_m: [-50.0, 50.0], walls: true, ..Track::default() };
    let mut lines = Vec::new();
    surfaces(&track, Vector2::zeros(), 5.6, &mut |line| lines.push(line));
    let mut reckoning = known([0.0, 0.3, 0.0], [0.05, 0.2, 0.2]);
    let found = align(&pieces, &lines, &reckoning).unwrap();
    assert!(reckoning.correct(&found.sighting));
    let [yaw, x, y] = reckoning.pose;
    assert!((yaw - 0.02).abs() < 0.003 && (y - 0.1).abs() < 0.006, "{yaw} {y}");
    let left = reckoning.of_pose();
    assert!((x - 0.3).abs() < 0.01 && left[(1, 1)] > 0.19_f64.powi(2) && left[(2, 2)] < 0.01_f64.powi(2));
}

#[test]
fn a_track_states_its_walls_or_the_hall_around_it() {
    let count = |track: &Track, x: f64| {
        let mut lines = Vec::new();
        surfaces(track, Vector2::new(x, 0.0), 5.6, &mut |line| lines.push(line));
        lines
    };
    let hall = Track::default();
    let seen = count(&hall, 10.0);
    assert!(seen.iter().any(|line| line.normal == -Vector2::y() && line.middle.y == 3.5));
    // A pillar at 10 m: its face 0.3 m before the wall.
    assert!(seen.iter().any(|line| line.middle == Vector2::new(10.0, 3.2) && line.center.is_some()));
    assert!(seen.iter().all(|line| line.normal.x == 0.0 || (line.middle.x - 10.0).abs() < 5.8));
    assert_eq!(count(&Track { walls: true, ..hall }, 10.0).len(), 2);
    assert!(count(&Track { surroundings: Surroundings::Open, ..hall }, 10.0).is_empty());
}

/// Surfaces that count after scans at rest, and the pose.
fn after(scans: u64, bodies: impl Fn(u64) -> Vec<Body>) -> (SurfaceMap, DeadReckoning) {
    let track = Track { surroundings: Surroundings::Open, ..Track::default() };
    let mut matcher = Matcher::new(LaserMode::Match, track, &Description::default());
    let (mut state, mut reckoning) = (LaserState::default(), known([0.0; 3], [1e-4; 3]));
    for number in 1..=scans {
        matcher.see(
            &scan(number, [0.0; 3], &bodies(number)),
            &SweepMotion::default(),
            &mut state,
            &mut reckoning,
        );
    }
    (state.map, reckoning)
}

#[test]
fn what_stands_still_counts_and_what_moves_does_not() {
    let counting = |map: &SurfaceMap| map.lines(Vector2::zeros()).filter(|line| line.counts).count();
    let (at_rest, reckoning) = after(15, |_| room());
    assert!(counting(&at_rest) >= 4, "{}", counting(&at_rest));
    assert!(reckoning.pose.iter().all(|number| number.abs() < 1e-3), "{:?}", reckoning.pose);
    for [ahead_mps, left_mps] in [[-0.3, 0.0], [0.0, 0.3], [0.1, 0.1]] {
        let moving = |number: u64| {
            let time_s = number as f64 * 0.1;
            boxed([3.0 + ahead_mps * time_s, -0.5 + left_mps * time_s], [0.5, 0.6]).to_vec()
        };
        let (map, reckoning) = after(15, moving);
        assert_eq!(counting(&map), 0, "{ahead_mps} {left_mps}");
        assert_eq!(reckoning.pose, [0.0; 3]);
    }
    // A side of which only the near edge is in the range of the scanner, and which moves along itself.
    let leaving = |number: u64| boxed([4.5, 2.8 + 0.05 * number as f64], [0.6, 1.0]).to_vec();
    let (map, _) = after(12, leaving);
    assert_eq!(counting(&map), 0);
}

#[test]
fn what_is_seen_in_passing_makes_no_room_forgotten() {
    // 120 boxes, each in two scans, where the room was seen before.
    let passing = |number: u64| {
        let angle = 1.7 * (number / 2) as f64;
        boxed([1.5 * angle.cos(), 1.5 * angle.sin()], [0.3, 0.3]).to_vec()
    };
    let (map, _) = after(255, |number| if number <= 15 { room() } else { passing(number) });
    let walls = map.lines(Vector2::zeros()).filter(|line| line.counts && line.is_long).count();
    assert!(walls >= 3, "{walls}");
}

/// A robot that drives 15 m ahead between what it does not know, with an odometer that turns by 2 mrad in each second: whether it was
/// ever in doubt, what it remembers, and the pose.
fn driven(bodies: &[Body]) -> (bool, SurfaceMap, DeadReckoning) {
    let sources = DriftSources { slip_m: 0.005, unknown: [0.002, 0.006, 0.0], ..DriftSources::default() };
    let mut matcher = Matcher::new(LaserMode::Match, OPEN, &Description::default());
    let mut reckoning = DeadReckoning::begin([0.0; 3], &Matrix3::zeros(), &sources);
    let (mut state, mut doubts) = (LaserState::default(), false);
    for number in 1..=150 {
        let x_m = 0.1 * number as f64;
        let [yaw_rad, ..] = reckoning.pose;
        let [dx_m, dy_m] = reckoning.advance(0.2e-3, 0.1, 0.0, 0.1);
        let step =
            OdometryStep { seconds: 0.1, distance_m: 0.1, dx_m, dy_m, yaw_rad, ..OdometryStep::default() };
        reckoning.grow(&sources, &step);
        let scan = scan(number, [0.0, x_m, 0.0], bodies);
        matcher.see(&scan, &SweepMotion::default(), &mut state, &mut reckoning);
        doubts |= state.search.doubts > 0;
    }
    (doubts, state.map, reckoning)
}

/// The long lines beside the way that count.
fn beside(map: &SurfaceMap, reckoning: &DeadReckoning, y_m: f64) -> usize {
    let [_, x, y] = reckoning.pose;
    let lines = map.lines(Vector2::new(x, y));
    lines.filter(|line| line.counts && line.is_long && (line.middle.y.abs() - y_m).abs() < 0.1).count()
}

#[test]
fn unknown_walls_that_continue_beyond_the_range_keep_the_direction_and_show_no_way() {
    let (doubts, map, reckoning) = driven(&CORRIDOR);
    assert_eq!((doubts, beside(&map, &reckoning, 1.5)), (false, 2));
    let [yaw, x, y] = reckoning.pose;
    // By the odometer alone it would be 30 mrad and 0.22 m.
    assert!(yaw.abs() < 2e-3 && y.abs() < 0.02, "{yaw} {y}");
    // Slip of 5 mm with the root of 15 m, and 0.6 % of these.
    let left = reckoning.of_pose()[(1, 1)].sqrt();
    assert!((x - 15.0).abs() < 0.03 && left > 0.07, "{x} {left}");
}

#[test]
fn a_wall_with_doors_is_one_line_that_nothing_contradicts() {
    let mut bodies = vec![Body::Wall([-9.0, 3.5], [30.0, 3.5]), Body::Wall([-9.0, -3.5], [30.0, -3.5])];
    for room in 0..12 {
        let (left, right) = (3.2 * f64::from(room) - 9.0, 3.2 * f64::from(room) - 7.5);
        bodies.push(Body::Wall([left, 1.5], [left + 2.0, 1.5]));
        bodies.push(Body::Wall([right, -1.5], [right + 2.0, -1.5]));
    }
    let (doubts, map, reckoning) = driven(&bodies);
    // Twelve walls on each side.
    let lines = beside(&map, &reckoning, 1.5);
    assert!(!doubts && (2..=4).contains(&lines), "{doubts} {lines}");
    let [yaw, _, y] = reckoning.pose;
    assert!(yaw.abs() < 3e-3 && y.abs() < 0.03, "{yaw} {y}");
}

#[test]
fn noise_splits_no_wall_into_surfaces_with_edges() {
    for number in 1..=40 {
        let mut pieces = Pieces::default();
        let scan = scan(number, [0.0; 3], &CORRIDOR);
        pieces.find(&scan, &Description::default(), &SweepMotion::default(), 0.0);
        // Where the view ends, 0.87 m behind, is an edge of what was split off there.
        let inner = pieces.all().iter().filter(|piece| piece.ends.iter().all(|end| end.x > -0.8));
        assert!(inner.clone().all(|piece| piece.middle.is_none()), "{number}: {:?}", pieces.all());
    }
}

/// What becomes of a robot at rest at a place of the room, scan by scan, whose ranges are too long by so much.
fn at_rest(
    track: Track,
    scans: u64,
    place: impl Fn(u64) -> [f64; 3],
    longer_m: impl Fn(u64) -> f64,
) -> (LaserState, DeadReckoning) {
    let mut matcher = Matcher::new(LaserMode::Match, track, &Description::default());
    let (mut state, mut reckoning) = (LaserState::default(), known([0.0; 3], [1e-4; 3]));
    for number in 1..=scans {
        let mut scan = scan(number, place(number), &room());
        for range_mm in scan.ranges_mm.iter_mut().filter(|range_mm| **range_mm > 0) {
            *range_mm += (1e3 * longer_m(number)) as u32;
        }
        matcher.see(&scan, &SweepMotion::default(), &mut state, &mut reckoning);
    }
    (state, reckoning)
}

const OPEN: Track =
    Track { x_m: [0.0, 20.0], y_m: [-1.5, 1.5], walls: false, surroundings: Surroundings::Open };

#[test]
fn ranges_that_are_all_too_long_are_found_and_move_no_pose() {
    for longer_m in [0.05, 0.1, 0.2] {
        let (state, reckoning) =
            at_rest(OPEN, 30, |_| [0.0; 3], |number| if number > 15 { longer_m } else { 0.0 });
        // One of 5 cm is not found in each scan.
        let is_found = (state.offset.offset_m - longer_m).abs() < 0.01;
        assert!(is_found || longer_m < 0.1, "{longer_m}: {:?}", state.offset);
        let [yaw, x, y] = reckoning.pose;
        assert!(yaw.abs() < 0.003 && x.hypot(y) < 0.01, "{longer_m}: {:?}", reckoning.pose);
    }
    // A robot that was moved has ranges that are longer on one side and shorter on the other.
    let (state, _) =
        at_rest(OPEN, 30, |number| if number > 15 { [0.0, 0.0, 0.15] } else { [0.0; 3] }, |_| 0.0);
    assert_eq!(state.offset.found, 0, "{:?}", state.offset);
}

#[test]
fn a_hall_that_is_not_there_is_not_used() {
    // The track states a hall whose walls are 3.5 m to each side, with pillars; the room is narrower.
    let (state, reckoning) = at_rest(Track::default(), 15, |_| [0.0; 3], |_| 0.0);
    assert_eq!((state.search.found, state.search.lost), (0, 0));
    assert!(reckoning.pose.iter().all(|number| number.abs() < 0.01), "{:?}", reckoning.pose);
    let mut stated = Stated::default();
    stated.note(false, 0, 6);
    assert!(stated.is_there(false) && stated.is_there(true));
    stated.note(false, 0, 1);
    assert!(!stated.is_there(false) && stated.is_there(true));
    stated.note(false, 3, 0);
    assert!(stated.is_there(false), "seen after all");
}

#[test]
fn a_robot_that_is_searched_for_twice_in_twenty_seconds_was_not_lifted() {
    let lifted = |again: u64| {
        let place = move |number: u64| match number {
            0..=15 => [0.0; 3],
            _ if number < again => [0.0, -0.4, 0.5],
            _ => [0.0, 0.3, -0.5],
        };
        at_rest(OPEN, 60, place, |_| 0.0).0.search
    };
    let (once, twice) = (lifted(100), lifted(40));
    assert_eq!((once.found + once.lost, once.again), (1, 0), "{once:?}");
    assert_eq!(twice.again, 1, "{twice:?}");
}

#[test]
fn a_place_is_the_same_from_the_front_beam_on_and_at_the_time_of_its_own() {
    let motion = SweepMotion { speed_mps: 3.0, yaw_rate_radps: 1.5 };
    let place = Vector2::new(2.0, 1.0);
    // In 20 ms the robot drives 6 cm and turns by 30 mrad: of what is 1 m to its left, 3 cm lie further ahead.
    let later = motion.at_time(place, 0.02);
    assert!((later - Vector2::new(1.97, 0.939)).norm() < 2e-3, "{later}");
    assert!((motion.at_front(later, 0.02) - place).norm() < 1e-12);
}

#[test]
fn a_robot_that_seems_to_have_turned_where_its_scanner_stands_was_not_lifted() {
    let turned = |found: [f64; 3], scanner_x_m: f64| {
        has_turned(&found, 0.1, &Description { scanner_x_m, ..Description::default() })
    };
    assert!(turned([0.3, 0.0, 0.0], 0.0) && turned([-0.06, 0.1, 0.1], 0.0));
    assert!(!turned([0.3, 0.2, 0.0], 0.0), "put down elsewhere");
    assert!(!turned([0.0, 0.1, 0.0], 0.0), "not turned");
    // About a scanner 0.6 m ahead, a turn moves the robot by 0.18 m.
    assert!(!turned([0.3, 0.0, 0.0], 0.6) && turned([0.3, 0.1, -0.2], 0.6));
}

#[test]
fn a_map_that_is_off_leaves_the_pose_as_unsure_however_often_it_is_seen() {
    let off_m = 0.03;
    let walls = [[5.0, 3.0, 5.0, -3.0], [-3.0, 3.0, 5.0, 3.0], [5.0, -3.0, -3.0, -3.0]];
    let walls = walls.map(|[x, y, to_x, to_y]| [x + off_m, y, to_x + off_m, to_y]);
    let track = Track { surroundings: Surroundings::Open, ..Track::default() };
    let mut matcher =
        Matcher::new(LaserMode::Match, track, &Description::default()).with_map(given(&walls, 0.03, 0.015));
    let (mut state, mut reckoning) = (LaserState::default(), known([0.0; 3], [0.01, 0.1, 0.1]));
    for number in 1..=100 {
        matcher.see(&scan(number, [0.0; 3], &room()), &SweepMotion::default(), &mut state, &mut reckoning);
    }
    let [yaw, x, y] = reckoning.pose;
    assert!((x - off_m).abs() < 0.01 && y.abs() < 0.01 && yaw.abs() < 0.003, "{:?}", reckoning.pose);
    let [sigma_rad, sigma_x, sigma_y] = reckoning.of_pose().diagonal().map(f64::sqrt).into();
    for sigma_m in [sigma_x, sigma_y] {
        assert!((0.027..0.04).contains(&sigma_m), "{sigma_m}");
    }
    assert!((0.003..0.01).contains(&sigma_rad), "{sigma_rad}");
}

#[test]
fn of_a_map_the_nearest_surfaces_that_face_the_robot_are_taken() {
    let at = |x: f64| [x, 1.0, x, -1.0];
    let lines = given(&[at(4.0), at(1.0), at(3.0), [2.0, -1.0, 2.0, 1.0], at(9.0), at(2.0)], 0.015, 0.015);
    let taken = |most: usize| {
        let (mut near, mut found) = (Vec::with_capacity(lines.len()), Vec::new());
        within(&lines, Vector2::zeros(), (5.0, most), &mut near, &mut |line| found.push(line.middle.x));
        found.sort_by(f64::total_cmp);
        found
    };
    assert_eq!(taken(9), [1.0, 2.0, 3.0, 4.0]);
    assert_eq!(taken(2), [1.0, 2.0]);
}

/// Chairs and a shelf in a room: few straight surfaces.
fn clutter() -> Vec<Body> {
    let legs = (0..24).map(|leg| {
        let (row, column) = (f64::from(leg % 4), f64::from(leg / 4));
        Body::Post([1.0 + 0.9 * column + 0.13 * row, 2.2 - 1.4 * row + 0.07 * column], 0.05 + 0.01 * row)
    });
    let shelf = (0..8).flat_map(|part| {
        let (x, depth) = (-1.0 + 0.3 * f64::from(part), 0.1 * f64::from(part % 3));
        boxed([x, 2.5 - depth / 2.0], [0.3, depth + 0.2])
    });
    legs.chain(shelf).chain(boxed([2.0, 0.0], [12.0, 6.0])).collect()
}

/// Drives two metres through clutter with wheels that spin for 30 % of the way; poses by dead reckoning, and where it was, after
/// each scan. `again` tells whether each scan gets a matcher of its own, with the state of the one before.
fn through_clutter(slip_m: f64, again: bool) -> (Vec<[f64; 3]>, DeadReckoning, LaserState) {
    let sources = DriftSources { slip_m, yaw_rad: 0.02, ..DriftSources::default() };
    let vehicle =
        Description { scanner_x_m: 0.0, scanner_y_m: 0.0, scanner_yaw_rad: 0.0, ..Description::default() };
    let track = Track { surroundings: Surroundings::Open, ..Track::default() };
    let new = || Matcher::new(LaserMode::Match, track, &vehicle).with_odometer(&sources);
    let (mut matcher, mut state) = (new(), LaserState::default());
    let mut reckoning = DeadReckoning::begin([0.0; 3], &Matrix3::zeros(), &sources);
    let mut poses = Vec::new();
    for number in 1..=40 {
        let (way_m, turn_rad) = if number > 1 { (0.05, 0.01) } else { (0.0, 0.0) };
        if number > 1 {
            let before = reckoning.pose;
            let [dx_m, dy_m] = reckoning.advance(turn_rad * 1.2, way_m * 1.3, 0.0, 0.1);
            let step = OdometryStep {
                seconds: 0.1,
                distance_m: way_m * 1.3,
                dx_m,
                dy_m,
                turn_rad,
                yaw_rad: before[0],
                ..OdometryStep::default()
            };
            reckoning.grow(&sources, &step);
        }
        let turned = 0.01 * (number - 1) as f64;
        // A circle of 5 m.
        let truth = [turned, 5.0 * turned.sin(), 5.0 * (1.0 - turned.cos())];
        if again {
            matcher = new();
        }
        matcher.see(&scan(number, truth, &clutter()), &SweepMotion::default(), &mut state, &mut reckoning);
        poses.push(reckoning.pose);
    }
    (poses, reckoning, state)
}

#[test]
fn in_clutter_a_robot_whose_wheels_slip_is_where_its_scans_show_it() {
    let end = Vector3::new(0.39, 5.0 * 0.39_f64.sin(), 5.0 * (1.0 - 0.39_f64.cos()));
    let (_, reckoning, state) = through_clutter(0.1, false);
    let off = Vector3::from(reckoning.pose) - end;
    assert!(off.yz().norm() < 0.05 && off[0].abs() < 0.02 && state.matched >= 38, "{off} {}", state.matched);
    // It knows how well: errors add up from key scan to key scan.
    let share = off.dot(&(reckoning.of_pose().try_inverse().unwrap() * off));
    assert!(share < 14.0, "{share}: not within 99.7 %");
    // With an odometer that is said to be good its wheels are believed.
    let (_, believed, _) = through_clutter(0.005, false);
    assert!((Vector3::from(believed.pose) - end).yz().norm() > 0.3, "{:?}", believed.pose);
}

#[test]
fn a_key_scan_continues_from_its_state_to_the_bit() {
    assert_eq!(through_clutter(0.1, true).0, through_clutter(0.1, false).0);
}
