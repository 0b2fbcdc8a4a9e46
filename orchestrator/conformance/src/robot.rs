//! What a robot must measure and obey, whether it is emulated or a driver of a real one.
//!
//! Its motion is judged by its own odometry and its own stamps, so nothing depends on when the test bench polls.

use shared_types::{Actuation, Odometry, Phase, Topic};

use super::answers::{own_stamps, same_twice};
use super::case::{Case, Trouble, Verdict, failed, passed_if, require};
use super::ranges::valid;
use super::suite::{Setup, Suite};
use super::test_bench::{ANSWER_NS, FOREIGN, Order, TestBench};

/// Scans of a case.
const SCANS: usize = 15;
/// Below this speed the robot is at rest [m/s].
const STANDSTILL_MPS: f64 = 1e-3;
/// Blocked wheels are at rest after this time: 1 m/s at a deceleration of 5 m/s^2 takes 0.2 s [ns].
const STOPPING_NS: u64 = 500_000_000;
/// Straight on.
const FORWARD: Order = Order::Drive(0.7, 0.0);

/// The cases of robots.
pub(crate) const CASES: [Case; 14] = [
    Case::required("scans", scans)
        .demands("Per period it publishes one scan and one odometry of the same id and time, ids from 1.")
        .because("They drive the loop."),
    Case::required("header", header)
        .demands(
            "Scan and odometry carry the time of the front beam, not after their publication and not more \
             than two periods before it, their own four stamps in order, and no others.",
        )
        .because("Age and latency of a command are computed from nothing else."),
    Case::required("valid-values", valid_values)
        .demands("All numbers are finite and within the range of their field.")
        .because("Every subscriber drops a sample with a bad number, so the scan is lost."),
    Case::required("increments", increments)
        .demands("The odometry increments are the differences of the reported poses and times.")
        .because("A reader may use either."),
    Case::required("drives", drives)
        .demands("Told to drive and steer to the left it moves forward and turns to the left.")
        .because("Signs in a driver are easily mixed up."),
    Case::required("blocks", blocks)
        .demands("Told to block its wheels it decelerates, and is at rest half a second later.")
        .because("Every stop depends on it."),
    Case::required("dead-man", dead_man)
        .demands("Without an actuation for two periods it blocks its wheels by itself.")
        .because("It is the last link of the stop chain, and needs none of the others."),
    Case::required("authority", authority)
        .demands("Actuations of an incarnation that the directive does not name do not move it.")
        .because("An actuator that was replaced may still publish."),
    Case::required("nonsense", nonsense)
        .demands(
            "Actuations that are not finite, of unknown kind or beyond limits neither move it nor keep it \
             moving.",
        )
        .because("One broken process must not break the next."),
    Case::required("repeated", repeated)
        .demands(
            "Repeated actuations, or of a scan older than three periods, neither move it nor keep it \
             moving.",
        )
        .because("They were computed for where the robot was."),
    Case::required("stopping", stopping)
        .demands("In the phase `stopping` it publishes no more scans.")
        .because("A run ends when all published scans are answered."),
    Case::recommended("truth", truth)
        .demands("It publishes the true state of each scan.")
        .because("Collisions, clearance and the outcome of a run are judged by it; a real robot has none."),
    Case::recommended("grants", grants)
        .in_lockstep()
        .demands("In lock-step it waits with a scan until it is granted and the scan before was answered.")
        .because("Otherwise samples are lost, and a drive cannot be repeated."),
    Case::recommended("repeatable", repeatable)
        .in_lockstep()
        .demands("In lock-step the same actuations give the same scans and odometry to the last bit.")
        .because("Otherwise a drive cannot be repeated to look for a mistake."),
];

fn scans(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    let odometry = bench.rounds(SCANS)?;
    bench.receive_for(0.5)?;
    let (scans, odometries) = (ids(&bench, Topic::Scan), ids(&bench, Topic::Odometry));
    require(scans == odometries, || format!("scans {scans:?}, but odometry {odometries:?}"))?;
    require(scans.first() == Some(&1) && scans.is_sorted_by(|one, next| one < next), || {
        format!("ids {scans:?}")
    })?;
    let (first, last) = (odometry[0].message.header(), odometry[SCANS - 1].message.header());
    let periods = (last.acquired_ns - first.acquired_ns) as f64 / suite.period_ns as f64;
    let expected = (last.scan_id - first.scan_id) as f64;
    passed_if(
        (periods - expected).abs() <= 0.2 * expected,
        format!("ids {} to {} within {periods:.2} periods", first.scan_id, last.scan_id),
    )
}

/// Scan ids of the samples of a topic.
fn ids(bench: &TestBench<'_>, topic: Topic) -> Vec<u64> {
    let of_topic = bench.received.iter().filter(|received| received.message.topic() == topic);
    of_topic.map(|received| received.message.scan_id()).collect()
}

fn header(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    bench.rounds(SCANS)?;
    let mut max_age_ms = 0.0_f64;
    for received in bench.received.iter().filter(|received| received.message.topic() != Topic::Truth) {
        let header = received.message.header();
        require(header.incarnation == bench.incarnation, || format!("incarnation {}", header.incarnation))?;
        own_stamps(suite.role, header, header.acquired_ns)?;
        let later = header.chain.iter().skip(1).any(|stamps| stamps.published_ns != 0);
        require(!later, || format!("scan {} carries stamps of stages behind it", header.scan_id))?;
        let age_ns = header.scan_published_ns() - header.acquired_ns;
        let age_ms = age_ns as f64 * 1e-6;
        max_age_ms = max_age_ms.max(age_ms);
        require(header.acquired_ns > 0 && age_ns <= 2 * suite.period_ns, || {
            format!("scan {} was {age_ms:.1} ms old when it was published", header.scan_id)
        })?;
    }
    Ok(format!("at most {max_age_ms:.1} ms old"))
}

fn valid_values(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    bench.rounds(SCANS)?;
    valid(&bench.received)
}

fn increments(suite: &Suite) -> Verdict {
    let all = odometry(&mut suite.started(Setup::default())?, SCANS)?;
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
    let all = odometry(&mut bench, 2 * SCANS)?;
    let (first, last) = (&all[0], &all[all.len() - 1]);
    let (x_m, yaw_rad) = (last.x_m - first.x_m, last.yaw_rad - first.yaw_rad);
    passed_if(
        last.speed_mps > 0.1 && x_m > 0.0 && yaw_rad > 0.0,
        format!("{:.2} m/s, {x_m:.2} m forward, {yaw_rad:.3} rad to the left", last.speed_mps),
    )
}

fn blocks(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    bench.order = Order::Block;
    let speeds = speeds_for(&mut bench, STOPPING_NS, next)?;
    let rising = speeds.windows(2).any(|pair| pair[1] > pair[0] + STANDSTILL_MPS);
    require(!rising, || format!("its speed rises with blocked wheels: {speeds:?}"))?;
    is_at_rest(&speeds, "after blocking the wheels")
}

fn dead_man(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    stops_without_orders(&mut bench, "after two periods without an actuation", next)
}

fn authority(suite: &Suite) -> Verdict {
    let mut bench = standing(suite)?;
    for _ in 0..8 {
        publish_changed(&mut bench, |actuation| actuation.header.incarnation = FOREIGN)?;
    }
    has_not_moved(&mut bench, "an actuation without authority")?;
    moves_when_told(&mut bench)
}

fn nonsense(suite: &Suite) -> Verdict {
    let mut bench = standing(suite)?;
    let kinds: [fn(&mut Actuation); 5] = [
        |actuation| actuation.sent_velocity_mps = f64::NAN,
        |actuation| actuation.sent_velocity_mps = 50.0,
        |actuation| actuation.sent_velocity_mps = -1.0,
        |actuation| actuation.sent_steering_rad = 3.0,
        |actuation| actuation.kind = 77,
    ];
    for kind in kinds {
        publish_changed(&mut bench, kind)?;
        publish_changed(&mut bench, kind)?;
    }
    has_not_moved(&mut bench, "nonsense")?;
    moves_when_told(&mut bench)?;
    let mut kinds = kinds.iter().cycle();
    stops_without_orders(&mut bench, "with nothing but nonsense for two periods", |bench| {
        kinds.next().map_or_else(|| failed("no nonsense"), |kind| publish_changed(bench, kind))
    })
}

fn repeated(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    let again = bench.last_actuation.clone();
    stops_without_orders(&mut bench, "with nothing but the same actuation for two periods", |bench| {
        let odometry = next(bench)?;
        again.iter().try_for_each(|again| bench.publish_exactly(again))?;
        Ok(odometry)
    })?;
    let old_ns = 5 * suite.period_ns;
    for _ in 0..5 {
        publish_changed(&mut bench, |actuation| actuation.header.acquired_ns -= old_ns)?;
    }
    has_not_moved(&mut bench, "an actuation five periods old")?;
    moves_when_told(&mut bench)
}

fn stopping(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    bench.announce(Phase::Stopping)?;
    bench.receive_for(1.5)?;
    bench.received.clear();
    bench.receive_for(4.0)?;
    let scans = ids(&bench, Topic::Scan).len();
    require(scans == 0, || format!("{scans} scans in the phase `stopping`"))?;
    Ok("no scan in four periods".to_owned())
}

fn truth(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup::default())?;
    for received in bench.rounds(SCANS)? {
        let scan_id = received.message.scan_id();
        if !bench.until(ANSWER_NS / 5, |bench| ids(bench, Topic::Truth).contains(&scan_id))? {
            return failed(format!("no truth of scan {scan_id}"));
        }
    }
    Ok(format!("{SCANS} truths"))
}

fn grants(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { lockstep: true, ..Setup::default() })?;
    let newest = |bench: &TestBench<'_>| ids(bench, Topic::Scan).into_iter().max().unwrap_or(0);
    bench.receive_for(2.0)?;
    require(newest(&bench) == 0, || "a scan that was not granted".to_owned())?;
    bench.round()?;
    bench.receive_for(2.0)?;
    require(newest(&bench) == 1, || format!("scan {} after scan 1 alone was granted", newest(&bench)))?;
    // The second scan is granted, and its answer is withheld.
    bench.order = Order::Silence;
    bench.round()?;
    bench.direct(|directive| directive.granted_scan = 10)?;
    bench.receive_for(2.0)?;
    require(newest(&bench) == 2, || format!("scan {} before scan 2 was answered", newest(&bench)))?;
    Ok("2 scans granted, 2 published".to_owned())
}

fn repeatable(suite: &Suite) -> Verdict {
    same_twice(suite, |bench| {
        let last = bench.rounds(2 * SCANS)?.len() as u64;
        let mut received = std::mem::take(&mut bench.received);
        received.retain(|received| {
            received.message.topic() != Topic::Truth && received.message.scan_id() <= last
        });
        received.sort_by_key(|received| (received.message.scan_id(), received.message.topic().name()));
        Ok(received)
    })?;
    Ok(format!("{} scans twice, same bits", 2 * SCANS))
}

/// A robot that drives.
fn driving(suite: &Suite) -> Result<TestBench<'_>, Trouble> {
    let mut bench = suite.started(Setup::default())?;
    moves_when_told(&mut bench)?;
    Ok(bench)
}

/// A robot that has not received any actuation yet.
fn standing(suite: &Suite) -> Result<TestBench<'_>, Trouble> {
    let mut bench = suite.started(Setup::default())?;
    bench.order = Order::Silence;
    bench.round()?;
    Ok(bench)
}

/// Passes when the robot drives as it is told to.
fn moves_when_told(bench: &mut TestBench<'_>) -> Verdict {
    bench.order = FORWARD;
    let speed = odometry(bench, 8)?[7].speed_mps;
    require(speed > 0.1, || format!("{speed:.3} m/s after eight actuations to drive"))?;
    Ok(format!("{speed:.2} m/s"))
}

/// Requires that the robot has not moved.
fn has_not_moved(bench: &mut TestBench<'_>, what: &str) -> Result<(), Trouble> {
    bench.order = Order::Silence;
    let speed = odometry(bench, 2)?[1].speed_mps;
    require(speed.abs() <= STANDSTILL_MPS, || format!("{speed:.3} m/s after {what}"))
}

/// Passes when the robot, without an actuation that counts, blocks its wheels after two periods.
fn stops_without_orders(
    bench: &mut TestBench<'_>,
    when: &str,
    round: impl FnMut(&mut TestBench<'_>) -> Result<Odometry, Trouble>,
) -> Verdict {
    bench.order = Order::Silence;
    let after_ns = 2 * bench.suite.period_ns + STOPPING_NS;
    is_at_rest(&speeds_for(bench, after_ns, round)?, when)
}

/// Speeds of rounds until `duration_ns` after the next scan [m/s].
fn speeds_for(
    bench: &mut TestBench<'_>,
    duration_ns: u64,
    mut round: impl FnMut(&mut TestBench<'_>) -> Result<Odometry, Trouble>,
) -> Result<Vec<f64>, Trouble> {
    let until_ns = bench.round()?.at_ns + duration_ns;
    let mut speeds = Vec::new();
    loop {
        let odometry = round(bench)?;
        speeds.push(odometry.speed_mps);
        if odometry.header.acquired_ns > until_ns {
            return Ok(speeds);
        }
    }
}

/// Passes when the last of the speeds is standstill.
fn is_at_rest(speeds: &[f64], when: &str) -> Verdict {
    let (first, last) = (speeds[0], speeds[speeds.len() - 1]);
    passed_if(last.abs() <= STANDSTILL_MPS, format!("{last:.3} m/s {when}, {first:.2} m/s before"))
}

/// One scan, answered by a changed actuation to drive.
fn publish_changed(bench: &mut TestBench<'_>, change: impl Fn(&mut Actuation)) -> Result<Odometry, Trouble> {
    bench.order = Order::Silence;
    let received = bench.round()?;
    if let Some(mut message) = bench.actuation(&received.message, FORWARD) {
        message.change(change);
        bench.publish(&mut message)?;
    }
    received.message.sample().copied()
}

/// The odometry of the next round.
fn next(bench: &mut TestBench<'_>) -> Result<Odometry, Trouble> {
    bench.round()?.message.sample().copied()
}

/// The odometry of some rounds.
fn odometry(bench: &mut TestBench<'_>, count: usize) -> Result<Vec<Odometry>, Trouble> {
    (0..count).map(|_| next(bench)).collect()
}
