//! What a person who drives asks for: limited and verified as the plans of the controller are.
//!
//! A person decides where to; the limits of speed, the bounds, the clearance and the stop are those of the controller. Held
//! for one interval, what was asked for must leave room to stop behind it, at each time at which the wheels may be blocked.
//! With `person_margin = "close"` it may pass closer to what it sees, never faster.

use shared_types::{GivenControl, Level};
use vehicle::Control;

use crate::config::PersonMargin;
use crate::planner::{Choice, Planner};
use crate::scene::Scene;
use crate::verify::verify;

/// Shares of the velocity that are tried, the first that may be driven counts: a person who drives towards an obstacle
/// gets slower before it, as the controller does.
const SLOWER: [f64; 5] = [1.0, 0.7, 0.45, 0.25, 0.1];

/// What is asked for at a scan taken at `acquired_ns`, within the bounds; `None` for no motion.
pub(crate) fn asked(
    scene: &Scene,
    person: &GivenControl,
    acquired_ns: u64,
    period_ns: u64,
) -> Option<Control> {
    let slowest = scene.config.vehicle.bounds.velocity_min_mps;
    let asks = person.is_fresh(acquired_ns, period_ns) && person.velocity_mps >= slowest;
    let asked = Control { velocity: person.velocity_mps, steering: person.steering_rad };
    (asks && asked.is_finite()).then(|| scene.bounds().clamp(asked))
}

/// The plan that follows it, in the planner; `None` when it may not be driven at any speed. With the obstacle that allows no
/// more than that, if one is the reason.
pub(crate) fn follow(
    scene: &Scene,
    asked: Control,
    planner: &mut Planner,
) -> (Option<Choice>, Option<usize>) {
    let scene = &match scene.config.person_margin {
        PersonMargin::Whole => *scene,
        PersonMargin::Close => Scene { escapes: true, ..scene.keeping(scene.margin.close(), scene.speed) },
    };
    let mut refused = None;
    for share in SLOWER {
        let control = scene.bounds().clamp(Control { velocity: share * asked.velocity, ..asked });
        planner.controls.clear();
        planner.controls.push(control);
        let verdict = verify(scene, &planner.controls, &mut planner.rollout);
        if let Some(verified) = verdict.verified() {
            return (Some(Choice { level: Level::Person, verified }), refused);
        }
        refused = verdict.obstacle();
    }
    (None, refused)
}
