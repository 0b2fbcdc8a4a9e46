//! Whether a plan may be driven: an independent check of every command before it leaves the controller.
//!
//! The plan's controls are driven through the model from the initial state, without the states of the solver. The
//! trajectory is checked against the obstacles every few centimetres. A robot that is already too near, or outside
//! a bound, may drive a plan that does not make it worse. A plan must leave room to turn back to along the track: at a
//! crawl its end is nearer than such a turn. Behind the goal nothing is checked, because the robot
//! lands there; the plan is cut.
//!
//! Assumed: the obstacles are described correctly. Obstacles out of sight are not known here; they are seen before
//! the plan gets to them, because the scanner reaches 2 m further than the horizon.

use vehicle::bounds::ROUNDING;
use vehicle::{Control, State};

use crate::braking::Stopping;
use crate::config::ControllerConfig;
use crate::rollout::{PIECES, Rollout, advance_on_course};
use crate::sampled::Sampled;
use crate::scene::{BEHIND_GOAL_M, Baseline, Scene, Violation};

/// The part of a plan that must be clear [s]: about 20 scans, and four times as long as a stop from full speed.
pub(crate) const VERIFIED_S: f64 = 2.72;

/// When the wheels may be blocked instead of the next command, in scan periods after the start of the plan: when the next
/// scan gives no plan, after the actuator's timeout, and by the dead man of the robot when the actuator is lost.
const BLOCKED_AFTER: [f64; 3] = [1.0, 1.5, 2.0];
/// Smallest velocity of the model [m/s].
const SLOWEST_MPS: f64 = 0.01;
/// Largest step along a slide, and where no margin covers what happens between two steps [m].
const SLIDE_STEP_M: f64 = 0.08;
const FINE_SLIDE_STEP_M: f64 = 0.01;
/// Steps between two samples of a plan where no margin covers what happens between them: 7 mm of a robot and a body that
/// approach each other with 1.4 m/s.
const FINE_STEPS: usize = 10;

/// Evidence that a plan may be driven: only [`Verdict::verified`] makes it, and the command takes its controls from it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Verified {
    first: Control,
    intervals: usize,
}

impl Verified {
    /// The control of the first interval.
    pub(crate) fn first(&self) -> Control {
        self.first
    }

    /// How many intervals may be driven, at least one.
    pub(crate) fn intervals(&self) -> usize {
        self.intervals
    }
}

/// The result of a verification.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Verdict {
    first: Control,
    /// How many intervals may be driven.
    pub(crate) intervals: usize,
    /// The first violation and its time, `None` when there is none up to the end or the goal.
    pub(crate) violation: Option<(Violation, f64)>,
}

impl Verdict {
    fn refused(violation: Violation) -> Self {
        Self { first: Control::default(), intervals: 0, violation: Some((violation, 0.0)) }
    }

    /// Whether the plan may be driven. What comes later than [`VERIFIED_S`] is planned again before the robot gets there.
    fn holds(&self) -> bool {
        self.intervals > 0 && self.violation.is_none_or(|(_, t)| t > VERIFIED_S)
    }

    /// The evidence, when the plan may be driven.
    pub(crate) fn verified(&self) -> Option<Verified> {
        let Self { first, intervals, .. } = *self;
        self.holds().then_some(Verified { first, intervals })
    }

    /// Whether the plan comes to ground that was not seen, or where a body may have come.
    pub(crate) fn comes_unseen(&self) -> bool {
        matches!(self.violation, Some((Violation::Unseen, _)))
    }

    /// The obstacle that the plan comes too near to.
    pub(crate) fn obstacle(&self) -> Option<usize> {
        match self.violation? {
            (Violation::Ellipse(index) | Violation::Obstacle(index), _) => Some(index),
            _ => None,
        }
    }
}

/// Drives `controls` into `rollout` and returns how far they may be driven.
pub(crate) fn verify(scene: &Scene, controls: &[Control], rollout: &mut Rollout) -> Verdict {
    rollout.nodes.clear();
    rollout.samples.clear();
    let Some(&first) = controls.first().filter(|_| scene.initial.is_finite()) else {
        return Verdict::refused(Violation::NotFinite);
    };
    let bounds = scene.bounds();
    if !controls.iter().all(|control| bounds.contains(*control, ROUNDING)) {
        return Verdict::refused(Violation::Control);
    }
    rollout.drive(scene, controls);
    let baseline = scene.baseline();
    if let Some(index) = scene.too_near_to_start(&baseline) {
        return Verdict::refused(Violation::Obstacle(index));
    }
    let backwards = scene.behind.map(|behind| (behind, scene.bodies()));
    let is_unseen = |index: usize, sample: &Sampled| {
        let Some((behind, (bodies, count))) = &backwards else { return false };
        let body = scene.body_at(&sample.state);
        index.is_multiple_of(PIECES) && !behind.is_free(&body, sample.t, scene.config, &bodies[..*count])
    };
    let is_fine = scene.escapes || scene.is_touched(&baseline);
    let mut behind_goal = false;
    for (index, sample) in rollout.samples.iter().enumerate() {
        behind_goal |= sample.state.x > scene.config.goal.x_m + BEHIND_GOAL_M;
        let before = index.checked_sub(1).filter(|_| is_fine).map(|before| &rollout.samples[before]);
        let found = before.and_then(|before| touched_between(scene, &baseline, before, sample));
        let checked = || scene.check(&baseline, sample).or_else(|| scene.leads_out(&baseline, &sample.state));
        let unseen = || is_unseen(index, sample).then_some(Violation::Unseen);
        if let Some(violation) = found.or_else(checked).or_else(unseen) {
            let intervals = index.saturating_sub(1) / PIECES;
            let violation = (!behind_goal || intervals == 0).then_some((violation, sample.t));
            let slid = slide(scene, &baseline, &first, &rollout.samples[..index]);
            return Verdict { first, intervals, violation: slid.or(violation) };
        }
    }
    let violation = slide(scene, &baseline, &first, &rollout.samples);
    Verdict { first, intervals: controls.len(), violation }
}

/// The first contact between two samples of a plan, which are so near that the robot drives straight.
fn touched_between(scene: &Scene, baseline: &Baseline, from: &Sampled, to: &Sampled) -> Option<Violation> {
    let State { x, y, yaw, .. } = from.state;
    (1..FINE_STEPS).find_map(|step| {
        let share = step as f64 / FINE_STEPS as f64;
        let at = |from: f64, to: f64| from + share * (to - from);
        let (t, speed) = (at(from.t, to.t), at(from.speed, to.speed));
        let state =
            State { x: at(x, to.state.x), y: at(y, to.state.y), yaw: at(yaw, to.state.yaw), ..to.state };
        scene.touched(baseline, scene.margin.sum(t, speed), t, &state)
    })
}

/// The first contact of a robot that blocks its wheels instead of following the plan's next command.
///
/// Until the block it holds the first control of the plan, because only a command brings another one.
fn slide(
    scene: &Scene,
    baseline: &Baseline,
    first: &Control,
    samples: &[Sampled],
) -> Option<(Violation, f64)> {
    let goal_x = scene.config.goal.x_m + BEHIND_GOAL_M;
    let mut blocks = BLOCKED_AFTER.map(|periods| periods * scene.config.period_s).into_iter().peekable();
    // The plan is checked up to the end of its first interval; what is held longer is checked here.
    let planned = samples.iter().take(PIECES + 1).copied();
    let later = std::iter::successors(samples.get(PIECES).copied(), |last| Some(hold(scene, first, last)));
    for (index, held) in planned.chain(later.skip(1)).enumerate() {
        if held.state.x > goal_x {
            return None;
        }
        let longer = index > PIECES;
        let touched =
            if longer { scene.touched(baseline, scene.margin.base(), held.t, &held.state) } else { None };
        let mut is_blocked = false;
        while blocks.next_if(|after_s| held.t >= *after_s).is_some() {
            is_blocked = true;
        }
        let slid = || if is_blocked { slide_from(scene, baseline, first, &held) } else { None };
        if let Some(violation) = touched.or_else(slid) {
            // Nothing plans again before it, however late it is.
            return Some((violation, held.t.min(VERIFIED_S)));
        }
        blocks.peek()?;
    }
    None
}

/// The first contact of blocked wheels: they keep their angle, so the robot slides along the arc that the model drives then.
/// It may be faster and brake less than described.
fn slide_from(scene: &Scene, baseline: &Baseline, control: &Control, start: &Sampled) -> Option<Violation> {
    let stopping = Stopping::new(scene.config, scene.config.period_s, scene.margin.age_s());
    let (deceleration, speed) = (stopping.deceleration_mps2, start.speed * stopping.speed_ratio);
    let length = stopping.slide(start.speed);
    let step_m = if scene.escapes { FINE_SLIDE_STEP_M } else { SLIDE_STEP_M };
    let steps = (length / step_m).ceil().max(1.0);
    let (mut state, mut before) = (start.state, speed);
    (1..=steps as usize).find_map(|step| {
        let way = length * step as f64 / steps;
        let left = (speed * speed - 2.0 * deceleration * way).max(0.0).sqrt();
        // The model has no lateral motion at standstill.
        let control = Control { velocity: f64::midpoint(before, left).max(SLOWEST_MPS), ..*control };
        state = advance_on_course(scene, &state, &control, (before - left) / deceleration);
        before = left;
        let t = start.t + (speed - left) / deceleration;
        scene.touched(baseline, scene.margin.base(), t, &state)
    })
}

/// The next sample of a robot that holds a control.
fn hold(scene: &Scene, control: &Control, last: &Sampled) -> Sampled {
    let ControllerConfig { vehicle, .. } = scene.config;
    let piece_s = scene.config.interval_s() / PIECES as f64;
    Sampled {
        t: last.t + piece_s,
        speed: control.velocity.max(last.speed - vehicle.deceleration_max_mps2 * piece_s),
        state: advance_on_course(scene, &last.state, control, piece_s),
    }
}

#[cfg(test)]
mod tests;
