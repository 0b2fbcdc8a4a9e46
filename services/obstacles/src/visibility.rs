//! Whether a scan shows that the place of a body is free, for bodies that it did not show.

use nalgebra::Vector2;
use shared_types::{BEAMS, FIRST_BEAM_YAW_RAD, PITCH_RAD, Scan};
use vehicle::frame::{to_robot, wrap_angle};
use vehicle::geometry::{Rectangle, ray_in_box};

use crate::points::{Beams, Place, range_of};

/// A return that is nearer or farther than the body by less than this is on it [m].
const MARGIN_M: f64 = 0.15;
/// Bodies farther away than this need not return anything [m].
const REACH_M: f64 = 5.2;
/// Share of the silhouette's width, at each side, that is not used because of noise of the yaw.
const RIM: f64 = 0.2;

/// What the beams towards a place show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sight {
    /// Beams pass through: nothing is there.
    Free,
    /// Something is there.
    Taken,
    /// Nothing is known: out of the sweep, too far, or hidden.
    Unknown,
}

/// What the scan shows at the place of `rectangle`.
pub(crate) fn sight(scan: &Scan, beams: &Beams, place: &Place, rectangle: &Rectangle) -> Sight {
    let distance = rectangle.distance_to_point(place.at);
    if distance <= 0.0 {
        // The robot stands at this place, so no body is there.
        return Sight::Free;
    }
    if distance > REACH_M {
        return Sight::Unknown;
    }
    let bearing = |point: Vector2<f64>| {
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
        // Background and noise put fewer than a third of the returns on a body.
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
    let half = Vector2::new(rectangle.length / 2.0, rectangle.width / 2.0);
    let (enter, leave) = ray_in_box(start, ray, half).filter(|(enter, _)| *enter <= REACH_M)?;
    match range_of(scan, beam) {
        None => Some(true),
        Some(range) if range > leave + MARGIN_M => Some(true),
        Some(range) if range < enter - MARGIN_M => None,
        Some(_) => Some(false),
    }
}
