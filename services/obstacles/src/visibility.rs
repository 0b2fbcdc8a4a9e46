//! Whether the place of a body that was not seen in a scan is seen to be free.

use shared_types::{BEAMS, FIRST_BEAM_YAW_RAD, PITCH_RAD, Scan};
use vehicle::frame::{to_robot, wrap_angle};
use vehicle::geometry::Rectangle;

use crate::points::{Beams, Place, range_of};

/// A return nearer or farther than the body by less than this is on it [m].
const MARGIN_M: f64 = 0.15;
/// Bodies farther away than this need not return anything [m].
const REACH_M: f64 = 5.2;
/// Share of the silhouette's width at each side that noise of the yaw may move off the body.
const RIM: f64 = 0.2;

/// What the beams towards a place say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sight {
    /// Beams pass through: nothing is there.
    Free,
    /// Something is there.
    Taken,
    /// Nothing is known: out of the sweep, too far, or hidden.
    Unknown,
}

/// Looks at the place of `rectangle`.
pub(crate) fn look(scan: &Scan, beams: &Beams, place: &Place, rectangle: &Rectangle) -> Sight {
    let distance = rectangle.distance_to_point(place.at);
    if distance <= 0.0 {
        // The robot stands in it, so it is not there.
        return Sight::Free;
    }
    if distance > REACH_M {
        return Sight::Unknown;
    }
    let bearing = |point: nalgebra::Vector2<f64>| {
        let offset = point - place.at;
        offset.y.atan2(offset.x) - place.yaw
    };
    let middle = wrap_angle(bearing(rectangle.centre));
    let (mut low, mut high) = (0.0_f64, 0.0_f64);
    for corner in rectangle.corners() {
        let offset = wrap_angle(bearing(corner) - middle);
        (low, high) = (low.min(offset), high.max(offset));
    }
    let rim = RIM * (high - low);
    let index = |angle: f64| (angle - FIRST_BEAM_YAW_RAD) / PITCH_RAD;
    let from = index(middle + low + rim).ceil().max(0.0);
    // A body narrower than a beam still has the one nearest to its middle.
    let to = index(middle + high - rim).floor().max(index(middle).round()).min((BEAMS - 1) as f64);
    let from = from.min(index(middle).round().max(0.0));
    let (mut through, mut there) = (0_u32, 0_u32);
    let mut beam = from;
    while beam <= to {
        match along(scan, beams, place, rectangle, beam as usize) {
            Some(true) => through += 1,
            Some(false) => there += 1,
            None => {}
        }
        beam += 1.0;
    }
    match (through, there) {
        (0, 0) => Sight::Unknown,
        // A third of returns on a body is more than background and noise explain.
        _ if through >= 2 * there => Sight::Free,
        _ => Sight::Taken,
    }
}

/// Whether a beam passes through the rectangle; `None` when it misses it or ends before.
fn along(scan: &Scan, beams: &Beams, place: &Place, rectangle: &Rectangle, beam: usize) -> Option<bool> {
    let offset = place.at - rectangle.centre;
    let start = to_robot(rectangle.yaw, offset.x, offset.y);
    let unit = beams.unit(beam);
    let ray = to_robot(rectangle.yaw - place.yaw, unit.x, unit.y);
    let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
    for (start, ray, half) in
        [(start.x, ray.x, rectangle.length / 2.0), (start.y, ray.y, rectangle.width / 2.0)]
    {
        if ray.abs() < 1e-12 {
            if start.abs() > half {
                return None;
            }
            continue;
        }
        let (one, two) = ((-half - start) / ray, (half - start) / ray);
        enter = enter.max(one.min(two));
        leave = leave.min(one.max(two));
    }
    if enter > leave || enter > REACH_M {
        return None;
    }
    match range_of(scan, beam) {
        None => Some(true),
        Some(range) if range > leave + MARGIN_M => Some(true),
        Some(range) if range < enter - MARGIN_M => None,
        Some(_) => Some(false),
    }
}
