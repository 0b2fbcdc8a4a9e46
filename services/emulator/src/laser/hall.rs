//! The hall around the track, which only the scanner sees.
//!
//! Four walls stand 2 m outside of the track's bounds. The side walls, along the track, have square pillars on their
//! inside at regular places. They are no obstacles: the referee does not know them.
//!
//! A beam costs the same in a hall of any length. Pillars are equally spaced, so the first one that a beam meets
//! follows from where the beam enters the strip in which they stand.

use nalgebra::Vector2;
use vehicle::Surroundings;

use crate::scenario::{Scenario, Track};

pub(super) const WALL_M: f64 = Surroundings::HALL_M;
pub(super) const PILLAR_M: f64 = Surroundings::PILLAR_M;
pub(super) const SPACING_M: f64 = Surroundings::SPACING_M;

/// A hall: a closed box, x along the side walls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hall {
    low: Vector2<f64>,
    high: Vector2<f64>,
    /// Reach of the scanner [m].
    reach_m: f64,
}

impl Hall {
    /// The hall of a scenario; none in open surroundings, and none behind the walls of a track.
    pub(super) fn of(scenario: &Scenario) -> Option<Self> {
        let Track { x_m, y_m, walls, surroundings } = scenario.track;
        let bound = |index: usize| Vector2::new(x_m[index], y_m[index]);
        let outside = Vector2::new(WALL_M, WALL_M);
        let is_seen = surroundings == Surroundings::Hall && !walls;
        let reach_m = scenario.true_scanner().range_m;
        is_seen.then(|| Self { low: bound(0) - outside, high: bound(1) + outside, reach_m })
    }

    /// Distance along a beam (unit `direction`) to a wall or a pillar [m], infinite beyond the reach of the scanner.
    ///
    /// Zero inside a pillar and behind a wall.
    pub(super) fn range(&self, origin: Vector2<f64>, direction: Vector2<f64>) -> f64 {
        let (left, right) = (self.high.y - origin.y, origin.y - self.low.y);
        let (ahead, behind) = (self.high.x - origin.x, origin.x - self.low.x);
        let (sideways, forward) = (direction.y.abs(), direction.x.abs());
        let side = to_plane(if direction.y > 0.0 { left } else { right }, sideways, self.reach_m);
        let end = to_plane(if direction.x > 0.0 { ahead } else { behind }, forward, self.reach_m);
        let reach = side.min(end).min(self.reach_m);
        let pillar = to_pillar(origin.x, direction, left, reach);
        let range = pillar.min(to_pillar(origin.x, Vector2::new(direction.x, -direction.y), right, reach));
        range.min(side).min(end)
    }
}

/// Distance along a beam to a plane, zero behind the plane and infinite beyond the reach `reach_m` of the scanner.
///
/// `slope` is the part of the direction towards the plane, not negative.
fn to_plane(offset: f64, slope: f64, reach_m: f64) -> f64 {
    // Most beams are spared the division.
    if offset > reach_m * slope { f64::INFINITY } else { (offset / slope).max(0.0) }
}

/// Distance to the first pillar at the wall `wall` to the left of the beam's origin, infinite when there is none up to
/// `reach`.
fn to_pillar(x: f64, direction: Vector2<f64>, wall: f64, reach: f64) -> f64 {
    // Negative in the strip in which the pillars stand.
    let strip = wall - PILLAR_M;
    if strip > 0.0 && strip > reach * direction.y {
        return f64::INFINITY;
    }
    let crossing = strip / direction.y;
    let (enter, leave) = match direction.y {
        slope if slope > 0.0 => (crossing.max(0.0), reach),
        slope if slope < 0.0 => (0.0, crossing.min(reach)),
        _ => (0.0, reach),
    };
    let range = enter + along(x + enter * direction.x, direction.x);
    if range <= leave { range } else { f64::INFINITY }
}

/// Way of a beam that is in a strip at `x` to the next pillar; zero at the face of one or inside.
fn along(x: f64, slope: f64) -> f64 {
    let ahead = if slope < 0.0 { -x } else { x };
    // Distance from the last pillar's near side, which the beam has reached.
    let near_side = ahead + PILLAR_M / 2.0;
    let since = near_side - SPACING_M * (near_side / SPACING_M).floor();
    match slope.abs() {
        _ if since <= PILLAR_M => 0.0,
        0.0 => f64::INFINITY,
        slope => (SPACING_M - since) / slope,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use vehicle::frame::heading;
    use vehicle::geometry::Rectangle;

    use super::*;
    use crate::scene::Solid;

    /// Walls at x = -2 and 24 and at y = -3.5 and 3.5.
    fn hall() -> Hall {
        Hall::of(&Scenario::default()).unwrap()
    }

    fn range(from: [f64; 2], direction: [f64; 2]) -> f64 {
        hall().range(Vector2::from(from), Vector2::from(direction).normalize())
    }

    fn near(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }

    #[test]
    fn a_beam_ends_at_a_side_wall_between_two_pillars() {
        near(range([1.0, 0.0], [0.0, 1.0]), 3.5);
        near(range([1.0, 0.5], [0.0, -1.0]), 4.0);
        // 3-4-5: 4 m up and 3 m to the right of x = 8 is x = 11, 1 m past the pillar at 10.
        near(range([8.0, -0.5], [3.0, 4.0]), 5.0);
    }

    #[test]
    fn a_beam_ends_at_the_face_of_a_pillar() {
        near(range([2.5, 0.0], [0.0, 1.0]), 3.2);
        near(range([2.64, 0.0], [0.0, -1.0]), 3.2);
        near(range([2.66, 0.0], [0.0, -1.0]), 3.5);
        near(range([7.5, 0.2], [0.0, 1.0]), 3.0);
        // 3-4-5: from (0.05, 0.8) 2.4 m up and 1.8 m to the left: (-1.75, 3.2), then (-1.975, 3.5), no pillar there.
        near(range([0.05, 0.8], [-3.0, 4.0]), 3.375);
        // To the pillar at x = 0: face at y = 3.2 is met at x = 1.8 - 1.8 = 0.
        near(range([1.8, 0.8], [-3.0, 4.0]), 3.0);
    }

    #[test]
    fn a_beam_ends_at_the_side_of_a_pillar() {
        // Face line y = 3.2 at x = 2.3, side of the pillar at x = 2.35 1/15 m higher: range 4 + 0.05 * 5 / 3.
        near(range([-0.1, 0.0], [3.0, 4.0]), 4.0 + 0.25 / 3.0);
        // The same to the other sides: face line y = -3.2 at x = 2.7, side at 2.65.
        near(range([5.1, 0.0], [-3.0, -4.0]), 4.0 + 0.25 / 3.0);
        // Along the wall inside of the strip.
        near(range([1.0, 3.4], [1.0, 0.0]), 1.35);
        near(range([1.0, -3.4], [-1.0, 0.0]), 0.85);
        // Out of the strip again: from (1, 3.45) the side at 2.35 is met at y = 3.45 - 0.135, before y = 3.2.
        near(range([1.0, 3.45], [10.0, -1.0]), 1.35 * 1.01_f64.sqrt());
    }

    #[test]
    fn a_beam_ends_at_an_end_wall_and_beyond_the_reach_there_is_nothing() {
        near(range([20.0, 0.0], [1.0, 0.0]), 4.0);
        near(range([1.0, 0.0], [-1.0, 0.0]), 3.0);
        assert_eq!(range([10.0, 0.0], [1.0, 0.0]), f64::INFINITY);
        near(range([18.41, 0.0], [1.0, 0.0]), 5.59);
        assert_eq!(range([18.39, 0.0], [1.0, 0.0]), f64::INFINITY);
        // Faces are 5.28 m away along the beam, the wall 5.76 m, and x = 6.13 to 6.37 has no pillar.
        assert_eq!(range([2.0, 0.1], [5.0, -4.0]), f64::INFINITY);
    }

    #[test]
    fn a_pillar_in_a_corner_is_seen_as_far_as_it_is_inside() {
        // The pillar at 2.5 stands behind an end wall at x = 2.4 but for 5 cm.
        let hall = Hall { high: Vector2::new(2.4, 3.5), ..hall() };
        let up = |x: f64| hall.range(Vector2::new(x, 3.0), Vector2::new(0.0, 1.0));
        near(up(2.36), 0.2);
        near(up(2.34), 0.5);
    }

    #[test]
    fn inside_a_pillar_and_behind_a_wall_the_range_is_zero() {
        assert_eq!(range([2.5, 3.3], [1.0, 0.0]), 0.0);
        assert_eq!(range([2.5, 3.3], [0.0, -1.0]), 0.0);
        assert_eq!(range([1.0, 3.6], [0.0, 1.0]), 0.0);
        assert_eq!(range([-2.1, 0.0], [-1.0, 0.1]), 0.0);
    }

    #[test]
    fn walls_of_the_track_and_open_surroundings_leave_no_hall() {
        let hall = |text: &str| Hall::of(&Scenario::parse(text, "test").unwrap());
        assert_eq!(hall("[track]\nwalls = true"), None);
        assert_eq!(hall("[track]\nsurroundings = \"open\""), None);
        let long = hall("[track]\nx_m = [-1.0, 10000.0]\ny_m = [-1.0, 2.0]").unwrap();
        assert_eq!((long.low, long.high), (Vector2::new(-3.0, -3.0), Vector2::new(10_002.0, 4.0)));
        // 4000 pillars on, the next one is where it should be.
        near(long.range(Vector2::new(9999.0, 3.9), Vector2::new(1.0, 0.0)), 0.85);
    }

    /// Walls of 1 m depth and all pillars, as bodies.
    fn bodies(hall: &Hall) -> Vec<Solid> {
        let solid = |low: [f64; 2], high: [f64; 2]| {
            let [low, high] = [Vector2::from(low), Vector2::from(high)];
            let size = high - low;
            Solid::rectangle(Rectangle {
                centre: (low + high) / 2.0,
                yaw: 0.0,
                length: size.x,
                width: size.y,
            })
        };
        let (low, high) = (hall.low, hall.high);
        let mut all = vec![
            solid([low.x - 1.0, low.y - 1.0], [high.x + 1.0, low.y]),
            solid([low.x - 1.0, high.y], [high.x + 1.0, high.y + 1.0]),
            solid([low.x - 1.0, low.y - 1.0], [low.x, high.y + 1.0]),
            solid([high.x, low.y - 1.0], [high.x + 1.0, high.y + 1.0]),
        ];
        for k in -20..=20 {
            let x = 2.5 * f64::from(k);
            all.push(solid([x - 0.15, low.y], [x + 0.15, low.y + 0.3]));
            all.push(solid([x - 0.15, high.y - 0.3], [x + 0.15, high.y]));
        }
        all
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 20_000, ..ProptestConfig::default() })]

        #[test]
        fn ranges_are_those_to_a_list_of_bodies(
            track_x in -4.0..4.0_f64,
            length in 0.5..20.0_f64,
            track_y in -3.0..3.0_f64,
            width in 0.5..6.0_f64,
            (along, across) in (0.0..1.0_f64, 0.0..1.0_f64),
            yaw in prop_oneof![-3.2..3.2_f64, (-4..=4).prop_map(|k| f64::from(k) * std::f64::consts::FRAC_PI_4)],
            at_the_wall in 0.0..0.35_f64,
            is_at_the_wall in any::<bool>(),
        ) {
            let hall = Hall {
                low: Vector2::new(track_x - 2.0, track_y - 2.0),
                high: Vector2::new(track_x + length + 2.0, track_y + width + 2.0),
                ..hall()
            };
            let size = hall.high - hall.low;
            let mut origin = hall.low + Vector2::new(along * size.x, across * size.y);
            if is_at_the_wall {
                origin.y = if across > 0.5 { hall.high.y - at_the_wall } else { hall.low.y + at_the_wall };
            }
            let direction = heading(yaw);
            let found = hall.range(origin, direction);
            let of_bodies = |shift: f64| {
                let ranges = bodies(&hall).into_iter().filter_map(move |solid| {
                    // A beam that grazes a corner may pass on either side of it, so a beam a nanometre off counts.
                    solid.ray(origin + shift * Vector2::new(-direction.y, direction.x), direction)
                });
                Some(ranges.fold(f64::INFINITY, f64::min)).filter(|range| *range <= hall.reach_m).unwrap_or(f64::INFINITY)
            };
            let close = |expected: f64| found == expected || (found - expected).abs() < 1e-6;
            prop_assert!(
                [0.0, 1e-9, -1e-9].into_iter().any(|shift| close(of_bodies(shift))),
                "{hall:?} {origin:?} {yaw}: {found} {}", of_bodies(0.0)
            );
        }
    }
}
