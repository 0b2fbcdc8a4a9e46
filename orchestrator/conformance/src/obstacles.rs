//! What a description of obstacles must show: what is there, and nothing else.

use shared_types::{Obstacle, Obstacles, Topic};

use super::case::{Case, LIVE, Level, Trouble, Verdict, failed, require};
use super::drive::Course;
use super::message::Message;
use super::suite::{Setup, Suite};
use super::test_bench::{Received, TestBench};

/// The box of the default drive: centre, length and width [m].
const BOX_M: [f64; 4] = [5.0, 0.0, 0.1, 0.4];
/// How much of the box the ellipse may leave out on each side: three standard deviations of a range [m].
const LEFT_OUT_M: f64 = 0.03;
/// Scans of a case.
const SCANS: usize = 12;
/// A description may take some scans to believe in what it sees.
const FIRST_SIGHTINGS: usize = 4;

/// The cases of descriptions alone.
pub(crate) const CASES: [Case; 6] = [
    Case {
        name: "sees-a-box",
        level: Level::Required,
        requirement: "A box of 0.1 m x 0.4 m, 1 m to 2.5 m ahead, lies within an ellipse from the fifth scan on that shows \
                      it.",
        why: "The controller keeps the robot out of ellipses, not out of boxes.",
        tries: LIVE,
        play: sees_a_box,
    },
    Case {
        name: "no-phantoms",
        level: Level::Required,
        requirement: "Where nothing stands it describes nothing.",
        why: "The robot would stop in front of it, or drive around it into something real.",
        tries: LIVE,
        play: no_phantoms,
    },
    Case {
        name: "blind-scan",
        level: Level::Required,
        requirement: "A sweep without a single return is answered as any other.",
        why: "A scanner that looks into the open sees nothing, and the loop must go on.",
        tries: LIVE,
        play: blind_scan,
    },
    Case {
        name: "nearest-first",
        level: Level::Recommended,
        requirement: "Of two boxes ahead the nearer one stands first.",
        why: "A reader that looks at some ellipses only looks at those.",
        tries: LIVE,
        play: nearest_first,
    },
    Case {
        name: "keeps-identity",
        level: Level::Recommended,
        requirement: "The ellipse of a box keeps its number from scan to scan.",
        why: "The controller remembers by it on which side it passes.",
        tries: LIVE,
        play: keeps_identity,
    },
    Case {
        name: "remembers",
        level: Level::Recommended,
        requirement: "A box that was seen is still described in a sweep without a return.",
        why: "Beams get lost, and what is beside the robot is out of view; it is still there.",
        tries: LIVE,
        play: remembers,
    },
];

fn sees_a_box(suite: &Suite) -> Verdict {
    let first_scan = suite.drive(Course::Corridor)?.scan_at(BOX_M[0] - 2.5);
    let mut bench = suite.started(Setup { first_scan, ..Setup::default() })?;
    for received in bench.rounds(SCANS)?.iter().skip(FIRST_SIGHTINGS) {
        let obstacles = description(&received.message)?;
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
        let count = description(&received.message)?.count;
        require(count == 0, || {
            format!("scan {}: {count} ellipses where nothing stands", received.message.scan_id())
        })?;
    }
    Ok(format!("{} scans of an empty track", 2 * SCANS))
}

fn blind_scan(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { first_scan: 20, ..Setup::default() })?;
    bench.rounds(3)?;
    for _ in 0..3 {
        let answer = blind_round(&mut bench)?;
        if let Err(fault) = answer.message.check() {
            return failed(format!("the answer to a sweep without returns: {fault}"));
        }
    }
    bench.rounds(2)?;
    Ok("3 sweeps without a return".to_owned())
}

/// One scan whose beams all got lost.
fn blind_round(bench: &mut TestBench<'_>) -> Result<Received, Trouble> {
    let scan_id = bench.scan_id;
    bench.wait_until_due(scan_id)?;
    for mut message in bench.inputs(scan_id)? {
        if let Message::Scan(scan) = &mut message {
            scan.ranges_mm.fill(0);
        }
        bench.publish(&mut message)?;
    }
    bench.scan_id += 1;
    bench.answer(scan_id)
}

fn nearest_first(suite: &Suite) -> Verdict {
    let first_scan = suite.drive(Course::Two)?.scan_at(1.5);
    let mut bench = suite.started(Setup { course: Course::Two, first_scan, ..Setup::default() })?;
    let received = bench.rounds(2 * SCANS)?;
    let mut both = 0;
    for received in received.iter().skip(FIRST_SIGHTINGS) {
        let obstacles = description(&received.message)?;
        let at = |x_m: f64, y_m: f64| {
            obstacles.list().iter().position(|item| (item.x_m - x_m).hypot(item.y_m - y_m) < 0.6)
        };
        if let (Some(near), Some(far)) = (at(4.5, 0.9), at(6.0, -0.9)) {
            both += 1;
            require(near < far, || {
                format!("scan {}: the farther box stands first", obstacles.header.scan_id)
            })?;
        }
    }
    require(both > 0, || "it never described both boxes".to_owned())?;
    Ok(format!("{both} scans with both boxes"))
}

fn keeps_identity(suite: &Suite) -> Verdict {
    let first_scan = suite.drive(Course::Corridor)?.scan_at(BOX_M[0] - 2.5);
    let mut bench = suite.started(Setup { first_scan, ..Setup::default() })?;
    let mut ids = Vec::new();
    for received in bench.rounds(SCANS)?.iter().skip(FIRST_SIGHTINGS) {
        let obstacles = description(&received.message)?;
        ids.extend(obstacles.list().iter().find(|item| covers_the_box(item)).map(|item| item.id));
    }
    let scans = ids.len();
    ids.dedup();
    require(ids.len() == 1, || format!("{} numbers in {scans} scans: {ids:?}", ids.len()))?;
    Ok(format!("number {} in {scans} scans", ids[0]))
}

fn remembers(suite: &Suite) -> Verdict {
    let first_scan = suite.drive(Course::Corridor)?.scan_at(BOX_M[0] - 2.5);
    let mut bench = suite.started(Setup { first_scan, ..Setup::default() })?;
    bench.rounds(SCANS)?;
    for _ in 0..2 {
        let obstacles = description(&blind_round(&mut bench)?.message)?;
        let known = obstacles.list().iter().any(covers_the_box);
        require(known, || format!("scan {}: the box is forgotten", obstacles.header.scan_id))?;
    }
    Ok("still described in two sweeps without a return".to_owned())
}

fn description(message: &Message) -> Result<Obstacles, Trouble> {
    match message {
        Message::Obstacles(obstacles) => Ok(**obstacles),
        other => failed(format!("{} where {} was expected", other.topic(), Topic::Obstacles)),
    }
}
