//! One frame of the page: the newest samples of the loop as JSON.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use report::latency::{Attribution, STAGES, attribute, data_age_ns, reaction_ns};
use serde_json::{Value, json};
use shared_types::{
    Actuation, ActuationKind, BlockReason, Command, CommandKind, DrivenBy, Header, Obstacle, Obstacles, Pose,
    Role, Scan, ScannerState, StopReason, Truth,
};

use crate::history::{Row, Stored};

/// Clearances from here on mean that nothing is near [m].
const NOTHING_NEAR_M: f64 = 1e6;

/// The newest sample of each topic that the page shows.
#[derive(Debug, Clone, Default)]
pub(crate) struct Samples {
    pub(crate) scan: Option<Box<Scan>>,
    pub(crate) pose: Option<Box<Pose>>,
    pub(crate) obstacles: Option<Box<Obstacles>>,
    pub(crate) command: Option<Box<Command>>,
    pub(crate) actuation: Option<Actuation>,
    /// Longest reaction since the frame before [ns].
    pub(crate) reaction_ns: Option<u64>,
    pub(crate) truth: Option<Truth>,
    /// All goals, once one has changed.
    pub(crate) goals: Option<Value>,
    /// In lock-step the stamps are simulated, so they say nothing about time.
    pub(crate) simulated: bool,
    /// Nothing drives the robot, as in an imported recording: the description of the obstacles is what comes last.
    pub(crate) is_undriven: bool,
}

impl Samples {
    /// Takes an actuation, and keeps the longest reaction.
    pub(crate) fn act(&mut self, actuation: &Actuation) {
        let reaction = reaction_ns(&actuation.header).filter(|_| actuation.answers == 1 && !self.simulated);
        self.reaction_ns = self.reaction_ns.max(reaction);
        self.actuation = Some(*actuation);
    }

    /// The newest scan that any of the samples belongs to.
    pub(crate) fn newest_scan(&self) -> u64 {
        let headers: [Option<&Header>; 3] = [
            self.scan.as_ref().map(|scan| &scan.header),
            self.command.as_ref().map(|command| &command.header),
            self.actuation.as_ref().map(|actuation| &actuation.header),
        ];
        headers.into_iter().flatten().map(|header| header.scan_id).max().unwrap_or(0)
    }

    /// Whether the newest scan is answered, so that all samples belong together.
    pub(crate) fn is_whole(&self) -> bool {
        let answered = match self.is_undriven {
            true => self.obstacles.as_ref().map(|obstacles| obstacles.header.scan_id),
            false => self.actuation.as_ref().map(|actuation| actuation.header.scan_id),
        };
        self.scan
            .as_ref()
            .is_some_and(|scan| answered.is_some_and(|answered| answered >= scan.header.scan_id))
    }

    /// The frame of a row.
    pub(crate) fn frame(&self, row: Row) -> Stored {
        Stored { row, text: self.json(&row).to_string().into() }
    }

    /// The frame of a row as JSON.
    pub(crate) fn json(&self, row: &Row) -> Value {
        json!({
            "row": row,
            "time_s": self.truth.map(|truth| round(truth.time_s)),
            "scan": self.scan.as_deref().map(scan),
            "pose": self.pose.as_deref().map(pose),
            "truth": self.truth.as_ref().map(truth),
            "obstacles": self.obstacles.as_deref().map(|all| all.list().iter().map(obstacle).collect::<Vec<_>>()),
            "scanner": self.obstacles.as_deref().map(scanner),
            "goals": self.goals,
            "command": self.command.as_deref().map(command),
            "actuation": self.actuation.as_ref().map(actuation),
            "latency_us": self.actuation.as_ref().filter(|_| !self.simulated).and_then(|actuation| latency(&actuation.header)),
        })
    }

    /// The figures of the frame of that number at that time.
    pub(crate) fn row(&self, number: u64, time_s: f64) -> Row {
        let actuation = self.actuation.as_ref();
        let pose = self.pose.as_ref();
        let clearance =
            self.truth.map(|truth| truth.clearance_m).filter(|clearance| *clearance < NOTHING_NEAR_M);
        let or_unknown = |value: Option<f64>| round(value.unwrap_or(f64::NAN));
        Row {
            number,
            time_s: round(time_s),
            scan_id: self.newest_scan(),
            x_m: or_unknown(pose.map(|pose| pose.x_m)),
            y_m: or_unknown(pose.map(|pose| pose.y_m)),
            yaw_rad: or_unknown(pose.map(|pose| pose.yaw_rad)),
            true_x_m: or_unknown(self.truth.map(|truth| truth.x_m)),
            true_y_m: or_unknown(self.truth.map(|truth| truth.y_m)),
            speed_mps: or_unknown(pose.map(|pose| pose.speed_mps)),
            desired_velocity_mps: or_unknown(actuation.map(|actuation| actuation.desired_velocity_mps)),
            desired_steering_rad: or_unknown(actuation.map(|actuation| actuation.desired_steering_rad)),
            clearance_m: or_unknown(clearance),
            margin_m: or_unknown(self.command.as_ref().map(|command| command.margin.sum())),
            reaction_us: or_unknown(self.reaction_ns.map(micros)),
            blocked: actuation.map_or(2, blocked),
        }
    }
}

/// How [`Row::blocked`] counts an actuation.
fn blocked(actuation: &Actuation) -> u32 {
    match BlockReason::try_from(actuation.reason) {
        _ if actuation.kind == ActuationKind::Drive.wire() => 0,
        Ok(
            BlockReason::Start
            | BlockReason::Landed
            | BlockReason::StopRequested
            | BlockReason::Paused
            | BlockReason::Released,
        ) => 2,
        _ => 1,
    }
}

/// To a tenth of a millimetre: more digits only lengthen the text.
fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

fn micros(ns: u64) -> f64 {
    ns as f64 * 1e-3
}

fn scan(scan: &Scan) -> Value {
    // Two bytes each: further than 65 m no pixel tells.
    let short = |range: &u32| u16::try_from(*range).unwrap_or(u16::MAX);
    let bytes: Vec<u8> = scan.ranges().iter().flat_map(|range| short(range).to_le_bytes()).collect();
    json!({
        "scan_id": scan.header.scan_id,
        "ranges_mm_base64": STANDARD.encode(bytes),
        "first_beam_yaw_rad": scan.first_rad,
        "pitch_rad": scan.increment_rad,
        "period_s": scan.period_ns as f64 * 1e-9,
        "missing": scan.missing.is_set(),
    })
}

fn pose(pose: &Pose) -> Value {
    let [_, _, _, _, xx, xy, _, _, yy] = pose.covariance;
    json!({
        "scan_id": pose.header.scan_id,
        "x_m": round(pose.x_m),
        "y_m": round(pose.y_m),
        "yaw_rad": round(pose.yaw_rad),
        "speed_mps": round(pose.speed_mps),
        "covariance_m2": [xx, xy, yy],
    })
}

fn truth(truth: &Truth) -> Value {
    json!({
        "x_m": round(truth.x_m),
        "y_m": round(truth.y_m),
        "yaw_rad": round(truth.yaw_rad),
        "clearance_m": Some(round(truth.clearance_m)).filter(|clearance| *clearance < NOTHING_NEAR_M),
        "goal_distance_m": round(truth.goal_distance_m),
        "collided": truth.collided == 1,
    })
}

fn obstacle(item: &Obstacle) -> Value {
    let sizes = [item.box_x_m, item.box_y_m, item.box_length_m, item.box_width_m, item.box_yaw_rad];
    json!({
        "id": item.id,
        "body": item.body,
        "x_m": round(item.x_m),
        "y_m": round(item.y_m),
        "a_m": round(item.a_m),
        "b_m": round(item.b_m),
        "velocity_x_mps": round(item.velocity_x_mps),
        "velocity_y_mps": round(item.velocity_y_mps),
        "box": sizes.map(round),
        "unseen_s": round(item.unseen_s),
    })
}

fn scanner(obstacles: &Obstacles) -> Value {
    let health = &obstacles.scanner;
    json!({
        "state": ScannerState::try_from(health.state).map_or("unknown", ScannerState::name),
        "unseen_sectors": (0..shared_types::SECTORS).filter(|sector| health.unseen_sectors >> sector & 1 == 1)
            .collect::<Vec<_>>(),
        "valid_share": round(health.valid_share),
        "returned_share": round(health.returned_share),
        "seen_ahead_m": round(health.seen_ahead_m),
        "blind_s": round(health.blind_s),
    })
}

fn command(command: &Command) -> Value {
    let margin = &command.margin;
    let nodes =
        command.nodes().iter().map(|node| [node.x_m, node.y_m, node.yaw_rad, node.velocity_mps].map(round));
    let blocking = command.stopped_for().map(|blocking| blocking.to_string());
    json!({
        "scan_id": command.header.scan_id,
        "kind": CommandKind::try_from(command.kind).map_or("unknown", CommandKind::name),
        "reason": StopReason::try_from(command.reason).map_or("unknown", StopReason::name),
        "blocking": blocking,
        "speed_limit_mps": round(command.speed_limit_mps),
        "margin_m": {
            "base": round(margin.base_m), "pose": round(margin.pose_m), "latency": round(margin.latency_m),
            "model": round(margin.model_m), "perception": round(margin.perception_m),
        },
        "iterations": command.iterations,
        "side": command.side,
        "plan": nodes.collect::<Vec<_>>(),
    })
}

fn actuation(actuation: &Actuation) -> Value {
    json!({
        "scan_id": actuation.header.scan_id,
        "kind": ActuationKind::try_from(actuation.kind).map_or("unknown", ActuationKind::name),
        "reason": BlockReason::try_from(actuation.reason).map_or("unknown", BlockReason::name),
        "driven_by": DrivenBy::try_from(actuation.driven_by).map_or("unknown", DrivenBy::name),
        "stop_reason": StopReason::try_from(actuation.stop_reason).map_or("unknown", StopReason::name),
        "desired_velocity_mps": round(actuation.desired_velocity_mps),
        "desired_steering_rad": round(actuation.desired_steering_rad),
    })
}

/// Where the time of a scan went, by the header of its answer; `None` when its chain has a hole.
pub(crate) fn latency(answer: &Header) -> Option<Value> {
    let Attribution { reaction_ns, stages, .. } = attribute(answer).ok()?;
    let stage = |(role, times): (Role, &report::latency::StageTimes)| {
        json!({
            "role": role.name(),
            "hop": micros(times.hop_ns),
            "compute": micros(times.compute_ns),
            "publish": micros(times.publish_ns),
        })
    };
    Some(json!({
        "scan_to_actuation": micros(reaction_ns),
        "data_age": data_age_ns(answer).map(micros),
        "stages": STAGES.into_iter().zip(&stages).map(stage).collect::<Vec<_>>(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::ScanGeometry;

    #[test]
    fn a_frame_without_samples_has_no_figures() {
        let samples = Samples::default();
        let stored = samples.frame(samples.row(7, 1.25));
        let frame: Value = serde_json::from_str(&stored.text).unwrap();
        assert_eq!((&frame["row"]["number"], &frame["row"]["time_s"]), (&json!(7), &json!(1.25)));
        assert!(["scan", "pose", "truth", "command", "latency_us"].iter().all(|key| frame[*key].is_null()));
        assert!(frame["row"]["speed_mps"].is_null());
    }

    #[test]
    fn ranges_and_plan_arrive_as_they_were_published() {
        let mut scan = Scan::of(ScanGeometry::URG_04LX);
        (scan.ranges_mm[0], scan.ranges_mm[681]) = (0x1234, 4095);
        let mut command = Command { kind: CommandKind::Drive.wire(), plan_length: 2, ..Command::default() };
        command.plan[1].x_m = 1.234_56;
        let samples =
            Samples { scan: Some(scan.into()), command: Some(command.into()), ..Samples::default() };
        let text = samples.frame(samples.row(1, 0.0)).text;
        let frame: Value = serde_json::from_str(&text).unwrap();
        let bytes = STANDARD.decode(frame["scan"]["ranges_mm_base64"].as_str().unwrap()).unwrap();
        assert_eq!((bytes.len(), &bytes[..2], &bytes[1362..]), (1364, &[0x34, 0x12][..], &[0xff, 0x0f][..]));
        assert_eq!(frame["command"]["plan"], json!([[0.0, 0.0, 0.0, 0.0], [1.2346, 0.0, 0.0, 0.0]]));
        assert!(text.len() < 12_000, "small enough for ten a second to a phone");
    }

    #[test]
    fn samples_belong_together_once_the_newest_scan_is_answered() {
        let mut samples = Samples::default();
        assert!(!samples.is_whole());
        let header = Header { scan_id: 5, ..Header::default() };
        samples.scan = Some(Box::new(Scan { header, ..Scan::of(ScanGeometry::URG_04LX) }));
        samples.act(&Actuation { header: Header { scan_id: 4, ..header }, ..Actuation::default() });
        assert!(!samples.is_whole());
        samples.act(&Actuation { header, ..Actuation::default() });
        assert!(samples.is_whole() && samples.newest_scan() == 5);
    }
}
