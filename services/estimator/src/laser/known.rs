//! The surfaces that a track states, its walls or the hall around it, or a map. A robot may be elsewhere: they count while
//! scans show them more often than what is behind them.

use nalgebra::{Matrix3, Vector2, Vector3};
use shared_types::plain_state;
use vehicle::{Surroundings, Track};

use super::surface::{LONG_M, SurfaceLine};

/// Standard deviations of where a surface is seen, the same in many scans: stamps and ranges are off a little [rad, m, m].
const SEEN: [f64; 3] = [3e-4, 1.5e-3, 1.5e-3];
/// A map that is off in a place is off in direction as if it bent over this [m].
const BENDS_M: f64 = 8.0;
/// Looks through a kind of surface that are let pass.
const LET_PASS: u64 = 6;
/// As many looks are remembered.
const REMEMBERED: u64 = 4096;

plain_state! {
    /// Whether what the track states is there: walls first, then pillars.
    pub struct Stated {
        /// How often each was seen where it should be
        pub seen: [u64; 2],
        /// How often what is behind was
        pub through: [u64; 2],
    }
}

impl Stated {
    /// Whether walls, or pillars, are there.
    pub(super) fn is_there(&self, is_long: bool) -> bool {
        let kind = usize::from(!is_long);
        self.through[kind] <= self.seen[kind].saturating_add(LET_PASS)
    }

    /// Takes into account how often a kind was seen, and how often what is behind it.
    pub(super) fn note(&mut self, is_long: bool, seen: u64, through: u64) {
        let kind = usize::from(!is_long);
        self.seen[kind] = self.seen[kind].saturating_add(seen);
        self.through[kind] = self.through[kind].saturating_add(through);
        if self.seen[kind].max(self.through[kind]) > REMEMBERED {
            (self.seen[kind], self.through[kind]) = (self.seen[kind] / 2, self.through[kind] / 2);
        }
    }
}

/// The lines of surfaces that are given from end to end, what is free to the right, as x, y, x and y [m]; all of them may be off by
/// `map_m` where the robot is, and each by `off_m`, standard deviations [m].
pub fn given(surfaces: &[[f64; 4]], map_m: f64, off_m: f64) -> Vec<SurfaceLine> {
    let deviations = Vector3::new(map_m / BENDS_M, map_m, map_m);
    let line = |&[x, y, to_x, to_y]: &[f64; 4]| {
        let (from, way) = (Vector2::new(x, y), Vector2::new(to_x - x, to_y - y));
        let half_m = way.norm() / 2.0;
        let middle = from + way / 2.0;
        SurfaceLine {
            normal: Vector2::new(way.y, -way.x).normalize(),
            middle,
            extent_m: [-half_m, half_m],
            closed_m: [-half_m, half_m],
            is_long: 2.0 * half_m >= LONG_M,
            covariance: Matrix3::from_diagonal(&deviations.map(|sigma| sigma * sigma)),
            seen_from: middle,
            off_m,
            center: None,
            radius_m: 0.0,
            index: None,
            counts: true,
        }
    };
    surfaces.iter().map(line).collect()
}

/// Hands over those of them that face a place within `reach_m`, the nearest `most`; `near` is memory that is kept.
pub(super) fn within(
    lines: &[SurfaceLine],
    place: Vector2<f64>,
    (reach_m, most): (f64, usize),
    near: &mut Vec<(f64, usize)>,
    take: &mut dyn FnMut(SurfaceLine),
) {
    let faces = |(index, line): (usize, &SurfaceLine)| {
        let from = place - line.middle;
        let along_m = line.along().dot(&from);
        let beyond_m = along_m - along_m.clamp(line.extent_m[0], line.extent_m[1]);
        let off_m = line.normal.dot(&from);
        let apart_m = off_m.hypot(beyond_m);
        (off_m > 0.0 && apart_m <= reach_m).then_some((apart_m, index))
    };
    near.clear();
    near.extend(lines.iter().enumerate().filter_map(faces));
    if near.len() > most {
        near.select_nth_unstable_by(most, |one, other| one.0.total_cmp(&other.0));
        near.truncate(most);
    }
    // Where a map is off, it is so for all that is seen from one place.
    near.iter().for_each(|(_, index)| take(SurfaceLine { seen_from: place, ..lines[*index] }));
}

/// Hands over the surfaces within `reach_m` of a place.
pub fn surfaces(track: &Track, place: Vector2<f64>, reach_m: f64, take: &mut dyn FnMut(SurfaceLine)) {
    let Track { x_m, y_m, walls, surroundings } = *track;
    let (across, along) = (Vector2::y(), Vector2::x());
    let mut wall = |normal: Vector2<f64>, middle: Vector2<f64>, half_m: f64| {
        if normal.dot(&(place - middle)) <= reach_m {
            take(SurfaceLine {
                normal,
                middle,
                extent_m: [-half_m, half_m],
                closed_m: [-half_m, half_m],
                is_long: half_m > Surroundings::PILLAR_M,
                covariance: Matrix3::from_diagonal(&Vector3::from(SEEN)).map(|sigma| sigma * sigma),
                seen_from: middle,
                off_m: 0.0,
                center: (half_m <= Surroundings::PILLAR_M).then_some(middle),
                radius_m: 0.0,
                index: None,
                counts: true,
            });
        }
    };
    let middle_m = x_m.map(|bound| bound.clamp(place.x - reach_m, place.x + reach_m));
    let (middle_x, half_m) = (f64::midpoint(middle_m[0], middle_m[1]), (middle_m[1] - middle_m[0]) / 2.0);
    if walls {
        wall(-across, Vector2::new(middle_x, y_m[1]), half_m);
        wall(across, Vector2::new(middle_x, y_m[0]), half_m);
        return;
    }
    if surroundings == Surroundings::Open {
        return;
    }
    let out_m = Surroundings::HALL_M;
    let (low, high) =
        (Vector2::new(x_m[0] - out_m, y_m[0] - out_m), Vector2::new(x_m[1] + out_m, y_m[1] + out_m));
    let center = (low + high) / 2.0;
    let half = (high - low) / 2.0;
    wall(-across, Vector2::new(middle_x, high.y), half_m + out_m);
    wall(across, Vector2::new(middle_x, low.y), half_m + out_m);
    wall(-along, Vector2::new(high.x, center.y), half.y);
    wall(along, Vector2::new(low.x, center.y), half.y);
    let side_m = Surroundings::PILLAR_M;
    let first = ((place.x - reach_m) / Surroundings::SPACING_M).ceil() as i64;
    let last = ((place.x + reach_m) / Surroundings::SPACING_M).floor() as i64;
    for pillar in first..=last {
        let x = pillar as f64 * Surroundings::SPACING_M;
        if x + side_m / 2.0 < low.x || x - side_m / 2.0 > high.x {
            continue;
        }
        for (face_y, normal) in [(high.y - side_m, -across), (low.y + side_m, across)] {
            let center_y = face_y - normal.y * side_m / 2.0;
            wall(normal, Vector2::new(x, face_y), side_m / 2.0);
            wall(along, Vector2::new(x + side_m / 2.0, center_y), side_m / 2.0);
            wall(-along, Vector2::new(x - side_m / 2.0, center_y), side_m / 2.0);
        }
    }
}
