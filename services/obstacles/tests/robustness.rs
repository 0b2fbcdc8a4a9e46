//! Any input gives a usable description.

mod scene;

use obstacles::{ObstacleDetector, ObstaclesConfig, ObstaclesState};
use proptest::prelude::*;
use scene::{Robot, Scene, block, detector};
use shared_types::{BEAMS, Header, Obstacles, Pose, Sample, Scan, ScanGeometry};

fn checked(mut obstacles: Obstacles) -> Obstacles {
    obstacles.header.layout = Obstacles::LAYOUT;
    assert_eq!(obstacles.check(), Ok(()));
    assert!(obstacles.list().iter().all(|item| item.id != 0 && item.body != 0));
    obstacles
}

/// Any number, the worst ones more often than chance would have it.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -3.0..3.0,
        1 => -1e4..1e4,
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
        1 => any::<f64>(),
    ]
}

fn pose() -> impl Strategy<Value = Pose> {
    [number(), number(), number(), number(), number(), number()].prop_map(|[x, y, yaw, speed, slip, rate]| {
        Pose {
            x_m: x,
            y_m: y,
            yaw_rad: yaw,
            speed_mps: speed,
            sideslip_rad: slip,
            yaw_rate_radps: rate,
            ..Pose::default()
        }
    })
}

/// Plausible ranges in pieces, so that clusters of all sizes occur.
fn ranges() -> impl Strategy<Value = Vec<u32>> {
    let piece = prop_oneof![
        3 => (20..5600_u32, 1..60_usize, 0..80_u32)
            .prop_map(|(range, count, step)| (0..count).map(|at| range.saturating_add(step * at as u32)).collect()),
        1 => proptest::collection::vec(any::<u32>(), 1..40),
        1 => (1..30_usize).prop_map(|count| vec![0; count]),
    ];
    proptest::collection::vec(piece, 1..60).prop_map(|pieces: Vec<Vec<u32>>| pieces.concat())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]
    #[test]
    fn any_scans_and_poses_give_usable_descriptions(
        walls: bool,
        steps in proptest::collection::vec((ranges(), pose(), any::<u32>(), any::<bool>()), 1..12),
    ) {
        let mut detector = ObstacleDetector::new(ObstaclesConfig { walls, ..ObstaclesConfig::default() }).unwrap();
        let mut now = 1_000_000_000_u64;
        for (ranges, mut pose, gap, tame) in steps {
            now = now.wrapping_add(if tame { 100_000_000 } else { u64::from(gap) });
            let header = Header { acquired_ns: now, ..Header::default() };
            let mut scan = Scan { header, sweep_ns: 66_000_000, period_ns: 100_000_000, ..Scan::of(ScanGeometry::URG_04LX) };
            for beam in 0..BEAMS {
                scan.ranges_mm[beam] = ranges[beam % ranges.len()];
            }
            if tame {
                (pose.x_m, pose.y_m, pose.yaw_rad) = (1.0, 0.0, 0.1);
            }
            checked(detector.step(&scan, &pose));
        }
        let mut next = detector.clone();
        next.resume(&detector.state()).unwrap();
        let (one, two) = (next.state(), detector.state());
        prop_assert_eq!(bytemuck::bytes_of(&one), bytemuck::bytes_of(&two));
    }

    #[test]
    fn a_state_of_any_bytes_is_refused_or_usable(seed: u64, count in 0..20_u32) {
        let mut scene = Scene::of(&[block(3.0, 0.0, 0.4, 0.4, 0.3)]).noisy(seed);
        let mut bytes = vec![0_u8; size_of::<ObstaclesState>()];
        bytes.iter_mut().for_each(|byte| *byte = (scene.uniform() * 256.0) as u8);
        let mut state: ObstaclesState = bytemuck::pod_read_unaligned(&bytes);
        state.count = count;
        let mut detector = detector();
        let _ = detector.resume(&state);
        let (scan, pose) = scene.scan(&Robot::default());
        checked(detector.step(&scan, &pose));
    }
}

#[test]
fn a_pose_that_is_not_finite_keeps_what_is_known() {
    let mut scene = Scene::of(&[block(3.0, 0.0, 0.4, 0.4, 0.0)]);
    let mut detector = detector();
    scene::run(&mut detector, &mut scene, &mut Robot::default(), 3);
    let (scan, pose) = scene.scan(&Robot::default());
    let blind = checked(detector.step(&scan, &Pose { yaw_rad: f64::NAN, ..pose }));
    assert_eq!(blind.count, 1);
    assert!((blind.items[0].unseen_s - 0.1).abs() < 1e-9);
    let (scan, pose) = scene.scan(&Robot::default());
    let seen = checked(detector.step(&scan, &pose));
    assert_eq!((seen.count, seen.items[0].unseen_s, seen.items[0].id), (1, 0.0, blind.items[0].id));
}

#[test]
fn speckle_is_no_obstacle() {
    let mut scene = Scene::of(&[]);
    let mut detector = detector();
    for _ in 0..200 {
        let (mut scan, pose) = scene.scan(&Robot::default());
        for range in scan.ranges_mut() {
            // One beam in 200 returns from nowhere.
            if scene.uniform() < 0.005 {
                *range = (300.0 + 5000.0 * scene.uniform()) as u32;
            }
        }
        assert_eq!(checked(detector.step(&scan, &pose)).count, 0);
    }
}
