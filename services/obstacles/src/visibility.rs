//! Whether a scan shows that the place of a body is free, for bodies that it did not show.

use std::ops::RangeInclusive;

use nalgebra::Vector2;
use shared_types::Scan;
use vehicle::frame::{to_robot, wrap_angle};
use vehicle::geometry::{Rectangle, ray_in_box};

use crate::points::{Beams, Place};

/// A return that is nearer or farther than the body by less than this is on it [m].
const MARGIN_M: f64 = 0.15;
/// Bodies farther away than this need not return anything to the URG-04LX [m].
const REACH_M: f64 = 5.2;
/// At least one beam to so many without a return must show the background.
const THROUGH_SHARE: u32 = 3;
/// Share of the silhouette's width, at each side, that is not used because of noise of the yaw.
const RIM: f64 = 0.2;
/// So many beams in a row must pass beside a body before it is taken to end there: a thin part may be missed by fewer.
const BESIDE_BEAMS: usize = 4;
/// What is further apart is not one body [m].
const GAP_M: f64 = 0.3;
/// The beams of a gap are counted as if it were no nearer than this [m].
const NEAR_M: f64 = 0.5;

/// What the beams towards a place show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sight {
    /// Returns come from beyond: nothing is there.
    Free,
    /// Something is there.
    Taken,
    /// No return comes from there, nor from anything beyond: that shows nothing.
    Silent,
    /// Nothing is known: out of the sweep, too far, or hidden.
    Unknown,
}

/// The beams towards `rectangle`, without those at its rim; `None` when the scanner stands on it, or it is too far.
pub(crate) fn beams_towards(
    beams: &Beams,
    place: &Place,
    rectangle: &Rectangle,
) -> Option<RangeInclusive<usize>> {
    beams_within(beams, place, rectangle, RIM)
}

/// [`beams_towards`] without this share of the width at each side.
fn beams_within(
    beams: &Beams,
    place: &Place,
    rectangle: &Rectangle,
    rim: f64,
) -> Option<RangeInclusive<usize>> {
    let distance = rectangle.distance_to_point(place.at);
    if !(distance > 0.0 && distance <= beams.reach(REACH_M)) {
        return None;
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
    let rim = rim * (high - low);
    let index = |angle: f64| (angle - beams.geometry.first_rad) / beams.pitch();
    let from = index(middle + low + rim).ceil().max(0.0);
    // A body narrower than a beam still has the one nearest to its middle.
    let to = index(middle + high - rim).floor().max(index(middle).round()).min((beams.count() - 1) as f64);
    let from = from.min(index(middle).round().max(0.0));
    (to >= from).then_some(from as usize..=to as usize)
}

/// What the scan shows at the place of `rectangle`.
pub(crate) fn sight(scan: &Scan, beams: &Beams, place: &Place, rectangle: &Rectangle) -> Sight {
    if rectangle.distance_to_point(place.at) <= 0.0 {
        // The robot stands at this place, so no body is there.
        return Sight::Free;
    }
    let Some(towards) = beams_towards(beams, place, rectangle) else { return Sight::Unknown };
    let (mut through, mut there, mut silent) = (0_u32, 0_u32, 0_u32);
    for beam in towards {
        match along(scan, beams, place, rectangle, beam) {
            Passage::Through => through += 1,
            Passage::Ends => there += 1,
            Passage::Silent => silent += 1,
            Passage::Elsewhere => {}
        }
    }
    match (through, there, silent) {
        (0, 0, 0) => Sight::Unknown,
        // Background and noise put fewer than a third of the returns on a body; a few wrong ranges are no background.
        _ if through >= 2 * there && through * THROUGH_SHARE >= silent => Sight::Free,
        (_, 0, _) => Sight::Silent,
        _ => Sight::Taken,
    }
}

/// Where the scan shows that the body in `rectangle` has ended, to the right and to the left of what it shows most of: the
/// beams there but the innermost one. Beams pass beside it where enough of them in a row return from beyond, or not at all
/// among such: [`BESIDE_BEAMS`] from a side of the rectangle on, or as many as make [`GAP_M`] in between. With
/// `silent_beams`, so many without a return are enough. A scanner that stands in the rectangle looks at it in all directions.
pub(crate) fn free_sides(
    scan: &Scan,
    beams: &Beams,
    place: &Place,
    rectangle: &Rectangle,
    silent_beams: Option<usize>,
) -> [Option<RangeInclusive<usize>>; 2] {
    let distance = rectangle.distance_to_point(place.at);
    let towards = if distance <= 0.0 {
        Some(0..=beams.count() - 1)
    } else {
        beams_within(beams, place, rectangle, 0.0)
    };
    let Some(towards) = towards else { return [None, None] };
    let (first, end) = (*towards.start(), *towards.end());
    let gap_beams = ((GAP_M / (beams.pitch() * distance.max(NEAR_M))).ceil() as usize).max(BESIDE_BEAMS);
    let is_free = |gap: &Gap, beams: usize| match silent_beams {
        Some(silent) => gap.beams() >= beams.max(silent),
        None => gap.is_free(beams),
    };
    let (mut best, mut part) = (Part::from(first, false), Part::from(first, false));
    let mut gap = Gap::default();
    for beam in towards {
        let passage = along(scan, beams, place, rectangle, beam);
        match passage {
            Passage::Through => gap.through += 1,
            Passage::Silent => gap.silent += 1,
            Passage::Ends | Passage::Elsewhere => {}
        }
        if matches!(passage, Passage::Through | Passage::Silent) {
            continue;
        }
        let is_at_the_side = gap.beams() == beam - first;
        if is_free(&gap, if is_at_the_side { BESIDE_BEAMS } else { gap_beams }) {
            part.is_free[1] = true;
            best = best.larger(part);
            part = Part::from(beam, true);
        }
        (gap, part.last) = (Gap::default(), beam);
        part.returns += usize::from(matches!(passage, Passage::Ends));
    }
    part.is_free[1] = is_free(&gap, BESIDE_BEAMS);
    let part = best.larger(part);
    let [right, left] = part.is_free.map(|is_free| is_free && part.returns > 0);
    [right.then(|| first..=part.first - 2), left.then(|| part.last + 2..=end)]
}

/// Beams in a row from which no return comes that is on the body.
#[derive(Debug, Clone, Copy, Default)]
struct Gap {
    through: usize,
    silent: usize,
}

impl Gap {
    fn beams(&self) -> usize {
        self.through + self.silent
    }

    /// Whether at least `beams` show that nothing is there; those without a return by what is around them.
    fn is_free(&self, beams: usize) -> bool {
        self.beams() >= beams
            && self.through >= BESIDE_BEAMS
            && self.through * THROUGH_SHARE as usize >= self.silent
    }
}

/// What is seen of a body between two gaps.
#[derive(Debug, Clone, Copy)]
struct Part {
    first: usize,
    last: usize,
    /// Whether beams pass beside it, to the right and to the left.
    is_free: [bool; 2],
    returns: usize,
}

impl Part {
    fn from(beam: usize, is_free: bool) -> Self {
        Self { first: beam, last: beam, is_free: [is_free, false], returns: 0 }
    }

    /// The one of both that more returns come from.
    fn larger(self, other: Self) -> Self {
        if other.returns > self.returns { other } else { self }
    }
}

/// What a beam does at the rectangle.
enum Passage {
    /// A return comes from beyond.
    Through,
    /// A return comes from it.
    Ends,
    /// No return comes.
    Silent,
    /// It misses the rectangle, or ends before it.
    Elsewhere,
}

fn along(scan: &Scan, beams: &Beams, place: &Place, rectangle: &Rectangle, beam: usize) -> Passage {
    let offset = place.at - rectangle.centre;
    let start = to_robot(rectangle.yaw, offset.x, offset.y);
    let unit = beams.unit(beam);
    let ray = to_robot(rectangle.yaw - place.yaw, unit.x, unit.y);
    let half = Vector2::new(rectangle.length / 2.0, rectangle.width / 2.0);
    let Some((enter, leave)) =
        ray_in_box(start, ray, half).filter(|(enter, _)| *enter <= beams.reach(REACH_M))
    else {
        return Passage::Elsewhere;
    };
    match beams.range_of(scan, beam) {
        None => Passage::Silent,
        Some(range) if range > leave + MARGIN_M => Passage::Through,
        Some(range) if range < enter - MARGIN_M => Passage::Elsewhere,
        Some(_) => Passage::Ends,
    }
}

#[cfg(test)]
mod tests {
    use shared_types::{PITCH_RAD, ScanGeometry};

    use super::*;

    /// What a robot at the origin sees at the place of a box 0.4 m wide, 1.95 m ahead, where the beams towards it have these
    /// ranges, from the right to the left.
    fn sight_of(ranges_mm: &[(usize, u32)]) -> Sight {
        let body = Rectangle { centre: Vector2::new(2.0, 0.0), yaw: 0.0, length: 0.1, width: 0.4 };
        let place = Place::standing(Vector2::zeros(), 0.0);
        let mut scan = Scan::of(ScanGeometry::URG_04LX);
        let towards = beams_towards(&Beams::urg(), &place, &body).unwrap();
        // The front is 0.2044 rad wide; a fifth of it is left out at each side.
        assert_eq!(towards.clone().count(), 19);
        let ranges = ranges_mm.iter().flat_map(|(count, range)| std::iter::repeat_n(*range, *count));
        for (beam, range) in towards.zip(ranges) {
            scan.ranges_mm[beam] = range;
        }
        sight(&scan, &Beams::urg(), &place, &body)
    }

    #[test]
    fn a_place_is_free_when_at_least_a_quarter_of_its_beams_shows_what_is_behind() {
        assert_eq!(sight_of(&[(5, 3000), (14, 0)]), Sight::Free);
        assert_eq!(sight_of(&[(4, 3000), (15, 0)]), Sight::Silent);
        assert_eq!(sight_of(&[(19, 0)]), Sight::Silent);
    }

    #[test]
    fn a_place_is_taken_when_more_than_a_third_of_its_returns_is_on_the_body() {
        assert_eq!(sight_of(&[(12, 3000), (6, 1960), (1, 0)]), Sight::Free);
        assert_eq!(sight_of(&[(11, 3000), (7, 1960), (1, 0)]), Sight::Taken);
    }

    #[test]
    fn a_return_just_before_or_behind_a_body_is_of_the_body() {
        // Noise of 0.1 m is on it; 0.25 m before it something else is.
        assert_eq!(sight_of(&[(19, 1850)]), Sight::Taken);
        assert_eq!(sight_of(&[(19, 2150)]), Sight::Taken);
        assert_eq!(sight_of(&[(19, 1700)]), Sight::Unknown);
        assert_eq!(sight_of(&[(19, 2300)]), Sight::Free);
    }

    /// [`free_sides`] of a box 1 m wide, 1.95 m ahead: 81 beams, from the right to the left; as the sines of the innermost beams.
    fn sides_of(ranges_mm: &[(usize, u32)], silent_beams: Option<usize>) -> [Option<f64>; 2] {
        let body = Rectangle { centre: Vector2::new(2.0, 0.0), yaw: 0.0, length: 0.1, width: 1.0 };
        let place = Place::standing(Vector2::zeros(), 0.0);
        let towards = beams_within(&Beams::urg(), &place, &body, 0.0).unwrap();
        assert_eq!(towards.clone().count(), 81);
        let mut scan = Scan::of(ScanGeometry::URG_04LX);
        let ranges = ranges_mm.iter().flat_map(|(count, range)| std::iter::repeat_n(*range, *count));
        for (beam, range) in towards.zip(ranges) {
            scan.ranges_mm[beam] = range;
        }
        let [right, left] = free_sides(&scan, &Beams::urg(), &place, &body, silent_beams);
        let sine = |beam: usize| Beams::urg().unit(beam).y;
        [right.map(|side| sine(*side.end())), left.map(|side| sine(*side.start()))]
    }

    #[test]
    fn a_body_ends_where_beams_pass_beside_what_is_seen_of_it() {
        let sine = |beam: f64| ((beam - 40.0) * PITCH_RAD).sin();
        let close = |found: Option<f64>, beam: f64| {
            assert!((found.unwrap() - sine(beam)).abs() < 0.5 * PITCH_RAD, "{found:?} {}", sine(beam));
        };
        // The right half has gone: the last beam but one beside what is left is the 38th.
        let [right, left] = sides_of(&[(40, 3000), (41, 1960)], None);
        close(right, 38.0);
        assert_eq!(left, None);
        let [right, left] = sides_of(&[(41, 1960), (40, 3000)], None);
        close(left, 42.0);
        assert_eq!(right, None);
        // Fewer than four beams may have missed a thin part.
        assert_eq!(sides_of(&[(3, 3000), (78, 1960)], None), [None; 2]);
        // 0.3 m between two bodies, here with beams that get no return among them; the larger one is left.
        let [right, left] = sides_of(&[(43, 1960), (10, 3000), (18, 0), (10, 1960)], None);
        close(left, 44.0);
        assert_eq!(right, None);
        // A slit of 0.12 m, silence alone, and a place where nothing is seen at all.
        assert_eq!(sides_of(&[(40, 1960), (10, 3000), (31, 1960)], None), [None; 2]);
        assert_eq!(sides_of(&[(41, 1960), (40, 0)], None), [None; 2]);
        assert_eq!(sides_of(&[(81, 3000)], None), [None; 2]);
        // Silence of enough beams is taken for free where it is asked for.
        let [right, left] = sides_of(&[(41, 1960), (40, 0)], Some(14));
        close(left, 42.0);
        assert_eq!(right, None);
        assert_eq!(sides_of(&[(68, 1960), (13, 0)], Some(14)), [None; 2]);
        // What something else hides is not free.
        assert_eq!(sides_of(&[(40, 1000), (41, 1960)], None), [None; 2]);
    }
}
