//! What a list of obstacles must contain: all that is there, and nothing else.

pub(crate) mod scanner;

use shared_types::{Obstacle, Obstacles};

use super::case::{Play, Trouble, Verdict, observed, require};
use super::drive::Course;
use super::suite::{Setup, Suite};
use super::test_bench::TestBench;

/// The box of the default drive: centre, length and width [m].
const BOX_M: [f64; 4] = [5.0, 0.0, 0.1, 0.4];
/// How much of the box the ellipse may leave out on each side: three standard deviations of a range [m].
const LEFT_OUT_M: f64 = 0.03;
/// Scans of a case.
const SCANS: usize = 12;
/// An obstacle may need some scans before it is reported.
const FIRST_SIGHTINGS: usize = 4;

/// The cases of obstacle detectors alone.
pub(crate) const CASES: [(&str, Play); 4] = [
    ("sees-a-box", sees_a_box),
    ("no-phantoms", no_phantoms),
    ("nearest-first", nearest_first),
    ("keeps-identity", keeps_identity),
];

fn sees_a_box(suite: &Suite) -> Verdict {
    for received in before_the_box(suite)?.rounds(SCANS)?.iter().skip(FIRST_SIGHTINGS) {
        let obstacles = received.message.sample::<Obstacles>()?;
        require(obstacles.list().iter().any(covers_the_box), || {
            let near = obstacles.list().iter().map(|item| {
                format!("({:.2}, {:.2}) with {:.2} m x {:.2} m", item.x_m, item.y_m, item.a_m, item.b_m)
            });
            format!(
                "scan {}: no ellipse around the box at (5, 0); there are: {}",
                obstacles.header.scan_id,
                near.collect::<Vec<_>>().join("; ")
            )
        })?;
    }
    Ok(format!("{} scans, the box lies within an ellipse", SCANS - FIRST_SIGHTINGS))
}

/// A test bench whose next scans have the box 2.5 m ahead and nearer.
fn before_the_box(suite: &Suite) -> Result<TestBench<'_>, Trouble> {
    suite.started_at(suite.drive(Course::Corridor)?.scan_at(BOX_M[0] - 2.5))
}

/// Whether the front of the box lies within the ellipse.
fn covers_the_box(item: &Obstacle) -> bool {
    let [x, y, length, width] = BOX_M;
    [-1.0, 1.0].iter().all(|side| {
        let corner = [x - length / 2.0 + LEFT_OUT_M, y + side * (width / 2.0 - LEFT_OUT_M)];
        ((corner[0] - item.x_m) / item.a_m).powi(2) + ((corner[1] - item.y_m) / item.b_m).powi(2) <= 1.0
    })
}

fn no_phantoms(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { course: Course::Free, ..Setup::default() })?;
    for received in bench.rounds(2 * SCANS)? {
        let Obstacles { header, count, .. } = received.message.sample()?;
        require(*count == 0, || format!("scan {}: {count} ellipses on an empty track", header.scan_id))?;
    }
    drop(bench);
    let with_a_box = before_the_box(suite)?.rounds(SCANS)?;
    let last = with_a_box[SCANS - 1].message.sample::<Obstacles>()?;
    observed(last.count > 0, || "it reports no obstacle where there is one either".to_owned())?;
    Ok(format!("{} scans of an empty track", 2 * SCANS))
}

fn nearest_first(suite: &Suite) -> Verdict {
    let first_scan = suite.drive(Course::Two)?.scan_at(1.5);
    let mut bench = suite.started(Setup { course: Course::Two, first_scan, ..Setup::default() })?;
    let mut both = 0;
    for received in bench.rounds(2 * SCANS)?.iter().skip(FIRST_SIGHTINGS) {
        let obstacles = received.message.sample::<Obstacles>()?;
        let at = |x_m: f64, y_m: f64| {
            obstacles.list().iter().position(|item| (item.x_m - x_m).hypot(item.y_m - y_m) < 0.6)
        };
        if let (Some(near), Some(far)) = (at(4.5, 0.9), at(6.0, -0.9)) {
            both += 1;
            let scan_id = obstacles.header.scan_id;
            require(near < far, || format!("scan {scan_id}: the farther box is listed first"))?;
        }
    }
    observed(both > 0, || "it never reported both boxes".to_owned())?;
    Ok(format!("{both} scans with both boxes"))
}

fn keeps_identity(suite: &Suite) -> Verdict {
    let mut ids = Vec::new();
    for received in before_the_box(suite)?.rounds(SCANS)?.iter().skip(FIRST_SIGHTINGS) {
        let obstacles = received.message.sample::<Obstacles>()?;
        ids.extend(obstacles.list().iter().find(|item| covers_the_box(item)).map(|item| item.id));
    }
    let scans = ids.len();
    observed(scans > 1, || format!("it reported the box in {scans} scans"))?;
    ids.dedup();
    require(ids.len() == 1, || format!("{} numbers in {scans} scans: {ids:?}", ids.len()))?;
    Ok(format!("number {} in {scans} scans", ids[0]))
}
