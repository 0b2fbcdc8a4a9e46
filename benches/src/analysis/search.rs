//! The controls with the largest error, and lengths of intervals with a small one, by search.
//!
//! A grid over the box finds the regions, a pattern search with halving steps the maximum in them. With a control
//! per interval the grid is walked one interval at a time, again and again until nothing changes, from several
//! starts: the full grid would have 9^N points. The errors are smooth in the controls but not concave, so the
//! result is the largest error that was found, not one that is proven to be the largest.

use vehicle::{Bounds, Control};

use super::run::{Node, Runner};

/// Velocities of the grid.
const VELOCITIES: usize = 5;
/// Steering angles of the grid.
const ANGLES: usize = 7;
/// First step of the pattern search, as a share of the box.
const FIRST_STEP: f64 = 0.125;
/// The pattern search ends below this step.
pub(crate) const LAST_STEP: f64 = 0.001;
/// The same where many controls are searched together.
const LAST_STEP_OF_MANY: f64 = 0.01;
/// Maximum of walks over all intervals.
const WALKS: usize = 12;
/// A walk that gains no more than this share is the last.
const SETTLED: f64 = 1e-3;

/// Controls with a large error.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Found {
    /// Largest error along the horizon.
    pub error: f64,
    /// The controls, one per interval.
    pub controls: Vec<Control>,
}

/// The control that has the largest error when it is held over all intervals.
pub(crate) fn constant(runner: &Runner, bounds: &Bounds, lengths: &[f64]) -> Found {
    let error = |control: Control| runner.error(lengths, &vec![control; lengths.len()]);
    let (control, error) = maximise(bounds, grid(bounds, VELOCITIES, ANGLES), LAST_STEP, error);
    Found { error, controls: vec![control; lengths.len()] }
}

/// The controls, one per interval, that have the largest error together; `constant` is one of the starts.
pub(crate) fn piecewise(runner: &Runner, bounds: &Bounds, lengths: &[f64], constant: &Found) -> Found {
    let mut best = constant.clone();
    for start in starts(bounds, lengths.len()).into_iter().chain([constant.controls.clone()]) {
        let found = walk(runner, bounds, lengths, start);
        if found.error > best.error {
            best = found;
        }
    }
    best
}

/// Changes one control at a time to the best of the grid until no change helps, then refines in the same way.
fn walk(runner: &Runner, bounds: &Bounds, lengths: &[f64], mut controls: Vec<Control>) -> Found {
    let mut error = runner.error(lengths, &controls);
    let candidates = grid(bounds, 3, 3);
    let mut refining = false;
    for _ in 0..WALKS {
        let before = error;
        let mut node = Node::default();
        for index in 0..lengths.len() {
            let of = |control: Control| {
                let node = runner.advance(&node, lengths[index], &control);
                rest(runner, node, &lengths[index + 1..], &controls[index + 1..])
            };
            let (control, largest) = if refining {
                maximise(bounds, vec![controls[index]], LAST_STEP_OF_MANY, of)
            } else {
                best_of(candidates.iter().copied(), of)
            };
            if largest > error {
                controls[index] = control;
                error = largest;
            }
            node = runner.advance(&node, lengths[index], &controls[index]);
        }
        if error <= before * (1.0 + SETTLED) {
            if refining {
                break;
            }
            refining = true;
        }
    }
    Found { error, controls }
}

fn rest(runner: &Runner, node: Node, lengths: &[f64], controls: &[Control]) -> f64 {
    let intervals = lengths.iter().zip(controls);
    intervals.fold(node, |node, (length, control)| runner.advance(&node, *length, control)).error
}

/// The best candidate, moved to the nearest maximum by a pattern search.
pub(crate) fn maximise(
    bounds: &Bounds,
    candidates: Vec<Control>,
    last_step: f64,
    error: impl Fn(Control) -> f64,
) -> (Control, f64) {
    let (mut control, mut largest) = best_of(candidates.into_iter(), &error);
    let width = bounds.velocity_max_mps - bounds.velocity_min_mps;
    let mut step = FIRST_STEP;
    while step > last_step && largest.is_finite() {
        let (along, across) = (step * width, 2.0 * step * bounds.steering_max_rad);
        let moved = [(along, 0.0), (-along, 0.0), (0.0, across), (0.0, -across)].map(|(along, across)| {
            bounds.clamp(Control { velocity: control.velocity + along, steering: control.steering + across })
        });
        let (candidate, found) = best_of(moved.into_iter(), &error);
        if found > largest {
            (control, largest) = (candidate, found);
        } else {
            step *= 0.5;
        }
    }
    (control, largest)
}

/// The first candidate with the largest error.
fn best_of(candidates: impl Iterator<Item = Control>, error: impl Fn(Control) -> f64) -> (Control, f64) {
    let mut best = (Control::default(), f64::NEG_INFINITY);
    for candidate in candidates {
        let found = error(candidate);
        if found > best.1 {
            best = (candidate, found);
        }
    }
    best
}

/// Points of the box, its edges included, the fastest left turn first.
pub(crate) fn grid(bounds: &Bounds, velocities: usize, angles: usize) -> Vec<Control> {
    let width = bounds.velocity_max_mps - bounds.velocity_min_mps;
    let part = |index: usize, count: usize| index as f64 / (count - 1) as f64;
    (0..velocities)
        .flat_map(|along| (0..angles).map(move |across| (along, across)))
        .map(|(along, across)| {
            bounds.clamp(Control {
                velocity: bounds.velocity_max_mps - width * part(along, velocities),
                steering: bounds.steering_max_rad * (1.0 - 2.0 * part(across, angles)),
            })
        })
        .collect()
}

/// Starts of the walk: alternating sides, one change of side, and alternating speeds.
fn starts(bounds: &Bounds, count: usize) -> Vec<Vec<Control>> {
    let fast = |left: bool| Control {
        velocity: bounds.velocity_max_mps,
        steering: if left { bounds.steering_max_rad } else { -bounds.steering_max_rad },
    };
    let slow = |left: bool| Control { velocity: bounds.velocity_min_mps, ..fast(left) };
    vec![
        (0..count).map(|index| fast(index % 2 == 0)).collect(),
        (0..count).map(|index| fast(2 * index < count)).collect(),
        (0..count).map(|index| if index % 2 == 0 { slow(true) } else { fast(true) }).collect(),
        (0..count).map(|index| if index % 2 == 0 { fast(true) } else { slow(false) }).collect(),
    ]
}

/// Moves time from one interval to another as long as the error becomes smaller.
pub(crate) fn improve(mut lengths: Vec<f64>, error: impl Fn(&[f64]) -> f64) -> (Vec<f64>, f64) {
    /// First and last time moved, as a share of the mean length.
    const STEPS: (f64, f64) = (0.4, 0.006);
    /// No interval becomes shorter than this share of the mean length.
    const MIN_SHARE: f64 = 0.02;
    let count = lengths.len();
    let mean = lengths.iter().sum::<f64>() / count as f64;
    let mut smallest = error(&lengths);
    let mut step = STEPS.0;
    while step > STEPS.1 {
        let before = smallest;
        for from in 0..count {
            for to in (0..count).filter(|to| *to != from) {
                if lengths[from] - step * mean < MIN_SHARE * mean {
                    continue;
                }
                let mut moved = lengths.clone();
                moved[from] -= step * mean;
                moved[to] += step * mean;
                let found = error(&moved);
                if found < smallest {
                    (lengths, smallest) = (moved, found);
                }
            }
        }
        if smallest > before * 0.99 {
            step *= 0.5;
        }
    }
    (lengths, smallest)
}
