//! What a robot must measure and obey, whether it is emulated or a driver of a real one.
//!
//! How it moves is judged by its own odometry and its own stamps, so nothing depends on when the stand looks.

use shared_types::{ActuationKind, Odometry, Phase, Topic};

use super::answers::{own_stamps, same};
use super::case::{Case, LIVE, LOCKSTEP, Level, Trouble, Verdict, failed, require};
use super::message::Message;
use super::ranges::valid;
use super::suite::{Setup, Suite};
use super::test_bench::{ANSWER_NS, Order, Received, STRANGER, TestBench};

/// Scans of a case.
const SCANS: usize = 15;
/// Below this speed the robot stands [m/s].
const STANDSTILL_MPS: f64 = 1e-3;
/// Blocked wheels stand after this time: 1 m/s at a deceleration of 5 m/s^2 takes 0.2 s [ns].
const STOPPING_NS: u64 = 500_000_000;

/// The cases of robots.
pub(crate) const CASES: [Case; 14] = [
    Case {
        name: "scans",
        level: Level::Required,
        requirement: "It publishes one scan and one odometry of the same id and time per period, ids rising from 1.",
        why: "The loop is driven by them.",
        tries: LIVE,
        play: scans,
    },
    Case {
        name: "header",
        level: Level::Required,
        requirement: "Scan and odometry carry the time of the front beam, not after their publication and not more than two \
                      periods before it, their own four stamps in order, and no others.",
        why: "Age and latency of a command are computed from nothing else.",
        tries: LIVE,
        play: header,
    },
    Case {
        name: "valid-values",
        level: Level::Required,
        requirement: "All numbers are finite and within what the field can mean.",
        why: "A sample with a bad number is dropped by every reader, so the scan is lost.",
        tries: LIVE,
        play: valid_values,
    },
    Case {
        name: "increments",
        level: Level::Required,
        requirement: "The increments of the odometry are the differences of the reported poses and of their times.",
        why: "A reader may use either.",
        tries: LIVE,
        play: increments,
    },
    Case {
        name: "drives",
        level: Level::Required,
        requirement: "Told to drive and steer to the left it moves forward and turns to the left.",
        why: "Signs of a driver are easily mixed up.",
        tries: LIVE,
        play: drives,
    },
    Case {
        name: "blocks",
        level: Level::Required,
        requirement: "Told to block its wheels it decelerates and stands half a second later.",
        why: "Every stop ends here.",
        tries: LIVE,
        play: blocks,
    },
    Case {
        name: "dead-man",
        level: Level::Required,
        requirement: "Without an actuation for two periods it blocks its wheels by itself.",
        why: "It is the last link of the stop chain, and needs none of the others.",
        tries: LIVE,
        play: dead_man,
    },
    Case {
        name: "authority",
        level: Level::Required,
        requirement: "Actuations of an incarnation that the directive does not name do not move it.",
        why: "An actuator that was replaced may go on publishing.",
        tries: LIVE,
        play: authority,
    },
    Case {
        name: "nonsense",
        level: Level::Required,
        requirement: "Actuations that are not finite, of an unknown kind or beyond the limits of the drive neither move it \
                      nor keep it moving.",
        why: "One broken process must not break the next.",
        tries: LIVE,
        play: nonsense,
    },
    Case {
        name: "repeated",
        level: Level::Required,
        requirement: "Actuations that were seen, or whose scan is older than three periods, neither move it nor keep it moving.",
        why: "They were meant for where the robot was.",
        tries: LIVE,
        play: repeated,
    },
    Case {
        name: "stopping",
        level: Level::Required,
        requirement: "In the phase `stopping` it publishes no more scans.",
        why: "A run ends when all published scans are answered.",
        tries: LIVE,
        play: stopping,
    },
    Case {
        name: "truth",
        level: Level::Recommended,
        requirement: "It publishes the true state of each scan.",
        why: "Collisions, clearance and the outcome of a run are judged by it; a real robot has none.",
        tries: LIVE,
        play: truth,
    },
    Case {
        name: "grants",
        level: Level::Recommended,
        requirement: "In lock-step it publishes a scan when it is granted and the scan before was answered, not before.",
        why: "Otherwise samples are lost, and a drive cannot be repeated.",
        tries: LOCKSTEP,
        play: grants,
    },
    Case {
        name: "repeatable",
        level: Level::Recommended,
        requirement: "In lock-step the same actuations give the same scans and odometry to the last bit.",
        why: "Otherwise a drive cannot be repeated to look for a mistake.",
        tries: LOCKSTEP,
        play: repeatable,
    },
];

fn scans(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    let odometry = bench.rounds(SCANS)?;
    bench.receive_for(0.5)?;
    let ids = |topic: Topic| -> Vec<u64> {
        let of = bench.received.iter().filter(|received| received.message.topic() == topic);
        of.map(|received| received.message.scan_id()).collect()
    };
    let (scans, odometries) = (ids(Topic::Scan), ids(Topic::Odometry));
    require(scans == odometries, || format!("scans {scans:?}, but odometry {odometries:?}"))?;
    require(scans.first() == Some(&1) && scans.is_sorted_by(|one, next| one < next), || {
        format!("ids {scans:?}")
    })?;
    let (first, last) = (odometry[0].message.header(), odometry[SCANS - 1].message.header());
    let periods = (last.acquired_ns - first.acquired_ns) as f64 / suite.period_ns as f64;
    let expected = (last.scan_id - first.scan_id) as f64;
    let text = format!("ids {} to {} within {periods:.2} periods", first.scan_id, last.scan_id);
    if (periods - expected).abs() <= 0.2 * expected { Ok(text) } else { failed(text) }
}

fn header(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    bench.rounds(SCANS)?;
    let mut oldest_ns = 0;
    for received in bench.received.iter().filter(|received| received.message.topic() != Topic::Truth) {
        let header = received.message.header();
        require(header.incarnation == bench.incarnation, || format!("incarnation {}", header.incarnation))?;
        own_stamps(suite.role, header, header.acquired_ns)?;
        let later = header.chain.iter().skip(1).any(|stamps| stamps.published_ns != 0);
        require(!later, || format!("scan {} carries stamps of stages behind it", header.scan_id))?;
        let age_ns = header.scan_published_ns() - header.acquired_ns;
        oldest_ns = oldest_ns.max(age_ns);
        require(header.acquired_ns > 0 && age_ns <= 2 * suite.period_ns, || {
            format!("scan {} was {:.1} ms old when it was published", header.scan_id, age_ns as f64 * 1e-6)
        })?;
    }
    Ok(format!("at most {:.1} ms old", oldest_ns as f64 * 1e-6))
}

fn valid_values(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    bench.rounds(SCANS)?;
    valid(&bench.received)?;
    Ok(format!("{} samples", bench.received.len()))
}

fn increments(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    let all: Vec<Odometry> = bench.rounds(SCANS)?.iter().filter_map(odometry).collect();
    for pair in all.windows(2) {
        let (before, now) = (&pair[0], &pair[1]);
        let dt_s = (now.header.acquired_ns - before.header.acquired_ns) as f64 * 1e-9;
        let off = [now.dx_m - (now.x_m - before.x_m), now.dy_m - (now.y_m - before.y_m), now.dt_s - dt_s];
        require(off.iter().all(|off| off.abs() <= 1e-6), || {
            format!("scan {}: dx, dy and dt are off by {off:?}", now.header.scan_id)
        })?;
    }
    Ok(format!("{} increments", all.len() - 1))
}

fn drives(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    bench.order = Order::Drive(0.7, 0.05);
    let all: Vec<Odometry> = bench.rounds(2 * SCANS)?.iter().filter_map(odometry).collect();
    let (first, last) = (&all[0], &all[all.len() - 1]);
    let text = format!(
        "{:.2} m/s, {:.2} m forward, {:.3} rad to the left",
        last.speed_mps,
        last.x_m - first.x_m,
        last.yaw_rad - first.yaw_rad
    );
    let moved = last.speed_mps > 0.1 && last.x_m > first.x_m && last.yaw_rad > first.yaw_rad;
    if moved { Ok(text) } else { failed(text) }
}

fn blocks(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    bench.order = Order::Block;
    let said = bench.round()?;
    let from_ns = said.at_ns;
    let speeds = coast(&mut bench, from_ns + STOPPING_NS)?;
    let rising = speeds.windows(2).any(|pair| pair[1] > pair[0] + STANDSTILL_MPS);
    require(!rising, || format!("its speed rises with blocked wheels: {speeds:?}"))?;
    stands(&speeds, "after blocking the wheels")
}

fn dead_man(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    bench.order = Order::Silence;
    let from_ns = bench.round()?.at_ns;
    let speeds = coast(&mut bench, from_ns + 2 * suite.period_ns + STOPPING_NS)?;
    stands(&speeds, "after two periods without an actuation")
}

fn authority(suite: &Suite) -> Verdict {
    let mut bench = standing(suite)?;
    for _ in 0..8 {
        publish_changed(&mut bench, |message| message.header_mut().incarnation = STRANGER)?;
    }
    stood(&mut bench, "an actuation without authority")?;
    moves_when_told(&mut bench)
}

fn nonsense(suite: &Suite) -> Verdict {
    let mut bench = standing(suite)?;
    let kinds: [fn(&mut Message); 5] = [
        |message| change(message, |actuation| actuation.sent_velocity_mps = f64::NAN),
        |message| change(message, |actuation| actuation.sent_velocity_mps = 50.0),
        |message| change(message, |actuation| actuation.sent_velocity_mps = -1.0),
        |message| change(message, |actuation| actuation.sent_steering_rad = 3.0),
        |message| change(message, |actuation| actuation.kind = 77),
    ];
    for kind in kinds {
        publish_changed(&mut bench, kind)?;
        publish_changed(&mut bench, kind)?;
    }
    stood(&mut bench, "nonsense")?;
    moves_when_told(&mut bench)?;
    bench.order = Order::Silence;
    let from_ns = bench.round()?.at_ns;
    let mut speeds = Vec::new();
    let until_ns = from_ns + 2 * suite.period_ns + STOPPING_NS;
    for kind in kinds.iter().cycle() {
        let odometry = publish_changed(&mut bench, kind)?;
        speeds.push(odometry.speed_mps);
        if odometry.header.acquired_ns > until_ns {
            break;
        }
    }
    stands(&speeds, "with nothing but nonsense for two periods")
}

fn repeated(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    bench.order = Order::Silence;
    let last = bench.round()?;
    let from_ns = last.at_ns;
    let again = bench.last_actuation.clone();
    let mut speeds = Vec::new();
    loop {
        let Some(odometry) = odometry(&bench.round()?) else { continue };
        speeds.push(odometry.speed_mps);
        if odometry.header.acquired_ns > from_ns + 2 * suite.period_ns + STOPPING_NS {
            break;
        }
        if let Some(again) = &again {
            bench.publish_exactly(again)?;
        }
    }
    stands(&speeds, "with nothing but the same actuation for two periods")?;
    let old_ns = 5 * suite.period_ns;
    for _ in 0..5 {
        publish_changed(&mut bench, |message| message.header_mut().acquired_ns -= old_ns)?;
    }
    stood(&mut bench, "an actuation five periods old")?;
    moves_when_told(&mut bench)
}

fn stopping(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    bench.announce(Phase::Stopping)?;
    bench.receive_for(1.5)?;
    bench.received.clear();
    bench.receive_for(4.0)?;
    let scans = bench.received.iter().filter(|received| received.message.topic() == Topic::Scan).count();
    require(scans == 0, || format!("{scans} scans in the phase `stopping`"))?;
    Ok("no scan in four periods".to_owned())
}

fn truth(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    for received in bench.rounds(SCANS)? {
        let scan_id = received.message.scan_id();
        let of = |bench: &TestBench<'_>| {
            bench.received.iter().any(
                |received| matches!(&received.message, Message::Truth(truth) if truth.header.scan_id == scan_id),
            )
        };
        if !bench.until(ANSWER_NS / 5, of)? {
            return failed(format!("no truth of scan {scan_id}"));
        }
    }
    Ok(format!("{SCANS} truths"))
}

fn grants(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { lockstep: true, ..Setup::default() })?;
    let newest = |bench: &TestBench<'_>| {
        let of = bench.received.iter().filter(|received| received.message.topic() == Topic::Scan);
        of.map(|received| received.message.scan_id()).max().unwrap_or(0)
    };
    bench.receive_for(2.0)?;
    require(newest(&bench) == 0, || "a scan that was not granted".to_owned())?;
    bench.round()?;
    bench.receive_for(2.0)?;
    require(newest(&bench) == 1, || format!("scan {} after scan 1 alone was granted", newest(&bench)))?;
    // The second scan is granted, and its answer is kept back.
    bench.order = Order::Silence;
    bench.round()?;
    bench.direct(|directive| directive.granted_scan = 10)?;
    bench.receive_for(2.0)?;
    require(newest(&bench) == 2, || format!("scan {} before scan 2 was answered", newest(&bench)))?;
    Ok("2 scans granted, 2 published".to_owned())
}

fn repeatable(suite: &Suite) -> Verdict {
    let mut runs = Vec::new();
    for _ in 0..2 {
        let mut bench = suite.started(Setup { lockstep: true, ..Setup::default() })?;
        let last = bench.rounds(2 * SCANS)?.len() as u64;
        let mut received = std::mem::take(&mut bench.received);
        received.retain(|received| {
            received.message.topic() != Topic::Truth && received.message.scan_id() <= last
        });
        received.sort_by_key(|received| (received.message.scan_id(), received.message.topic().name()));
        runs.push(received);
    }
    same(&runs[0], &runs[1])?;
    Ok(format!("{} scans twice, same bits", 2 * SCANS))
}

/// A robot that drives.
fn driving(suite: &Suite) -> Result<TestBench<'_>, Trouble> {
    let mut bench = suite.started(Setup::default())?;
    moves_when_told(&mut bench)?;
    Ok(bench)
}

/// A robot that has not been told anything yet.
fn standing(suite: &Suite) -> Result<TestBench<'_>, Trouble> {
    let mut bench = suite.started(Setup::default())?;
    bench.order = Order::Silence;
    bench.round()?;
    Ok(bench)
}

/// That the robot drives when it is told to.
fn moves_when_told(bench: &mut TestBench<'_>) -> Verdict {
    bench.order = Order::Drive(0.7, 0.0);
    let speed = bench.rounds(8)?.last().and_then(odometry).map_or(0.0, |odometry| odometry.speed_mps);
    require(speed > 0.1, || format!("{speed:.3} m/s after eight actuations to drive"))?;
    Ok(format!("{speed:.2} m/s"))
}

/// That the robot has not moved.
fn stood(bench: &mut TestBench<'_>, what: &str) -> Result<(), Trouble> {
    bench.order = Order::Silence;
    let speed = bench.rounds(2)?.last().and_then(odometry).map_or(0.0, |odometry| odometry.speed_mps);
    require(speed.abs() <= STANDSTILL_MPS, || format!("{speed:.3} m/s after {what}"))
}

/// Speeds until a time on the machine's clock [m/s].
fn coast(bench: &mut TestBench<'_>, until_ns: u64) -> Result<Vec<f64>, Trouble> {
    let mut speeds = Vec::new();
    loop {
        let Some(odometry) = odometry(&bench.round()?) else { continue };
        speeds.push(odometry.speed_mps);
        if odometry.header.acquired_ns > until_ns {
            return Ok(speeds);
        }
    }
}

/// That the last of the speeds is standstill.
fn stands(speeds: &[f64], when: &str) -> Verdict {
    let last = speeds.last().copied().unwrap_or(f64::NAN);
    let text = format!("{last:.3} m/s {when}, {:.2} m/s before", speeds.first().copied().unwrap_or(0.0));
    if last.abs() <= STANDSTILL_MPS { Ok(text) } else { failed(text) }
}

/// One scan, answered by a changed actuation to drive.
fn publish_changed(bench: &mut TestBench<'_>, change: impl Fn(&mut Message)) -> Result<Odometry, Trouble> {
    bench.order = Order::Silence;
    let received = bench.round()?;
    bench.order = Order::Drive(0.7, 0.0);
    let actuation = bench.actuation(&received.message);
    bench.order = Order::Silence;
    if let Some(mut actuation) = actuation {
        change(&mut actuation);
        bench.publish(&mut actuation)?;
    }
    odometry(&received).map_or_else(|| failed("no odometry"), Ok)
}

fn change(message: &mut Message, change: impl Fn(&mut shared_types::Actuation)) {
    if let Message::Actuation(actuation) = message {
        actuation.kind = ActuationKind::Drive.wire();
        change(actuation);
    }
}

fn odometry(received: &Received) -> Option<Odometry> {
    match &received.message {
        Message::Odometry(odometry) => Some(**odometry),
        _ => None,
    }
}
