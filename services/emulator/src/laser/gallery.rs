//! The hall along a course, which only the scanner sees.
//!
//! Walls follow the course 2 m outside of its width on both sides, with square pillars on their inside at regular
//! places, and end walls close it 4 m before the begin and behind the end. Parts that would stand in another part of
//! the way are left out. The referee does not know the walls.
//!
//! The walls are short straight segments. A grid holds for each of its cells which segments cross it, and a beam looks
//! at the cells along it: it costs the same beside a course of any length.

mod grid;
mod sections;

use nalgebra::Vector2;
use vehicle::course::{Leg, Tangent};
use vehicle::{Course, Surroundings};

use super::hall::{PILLAR_M, SPACING_M, WALL_M};
use grid::{Grid, Segment};
use sections::Sections;

/// The bounds of the track are this far before the begin and behind the end of the course [m].
const BEYOND_M: f64 = 2.0;
/// The same where the robot changes between forwards and backwards [m].
const BEYOND_TURN_M: f64 = 0.0;
/// Parts of a wall that stand this much nearer to another part of the way than the walls of that are left out [m].
const SLACK_M: f64 = 0.1;
/// Longest step along the course from one corner of a wall to the next [m].
const STEP_M: f64 = 0.25;
/// How far a segment may be from the arc that it stands for [m].
const CHORD_M: f64 = 0.003;
/// The place along the course where the way is blocked or becomes free is found by so many halvings of a step.
const HALVINGS: usize = 12;

/// The hall along a course.
#[derive(Debug, Clone)]
pub(super) struct Gallery {
    grid: Grid,
}

impl Gallery {
    /// The hall along `course` for a scanner with the reach `reach_m`; none in open surroundings.
    pub(super) fn of(course: &Course, reach_m: f64) -> Option<Self> {
        let keys = course.keys();
        let is_seen = keys.surroundings == Surroundings::Hall && !course.is_line();
        is_seen.then(|| Self { grid: Grid::new(segments(course, keys.width_m.largest_m() / 2.0), reach_m) })
    }

    /// Distance along a beam (unit `direction`) to a wall or a pillar [m], infinite beyond the reach of the scanner.
    pub(super) fn range(&self, origin: Vector2<f64>, direction: Vector2<f64>) -> f64 {
        self.grid.range(origin, direction)
    }
}

/// The walls of all legs of a course, each beside its own and in the way of none.
fn segments(course: &Course, half_width: f64) -> Vec<Segment> {
    let wall = half_width + WALL_M;
    let beyond = BEYOND_M + WALL_M;
    let legs = course.legs();
    let mut sections = Sections::new(wall - SLACK_M);
    let ends = |leg: &Course| {
        let [begin, end] = [leg.begin_m(), leg.length_m()];
        let turns = [begin > 0.0, end < course.length_m()];
        let [before, behind] = turns.map(|turns| if turns { BEYOND_TURN_M + WALL_M } else { beyond });
        [begin - before, end + behind]
    };
    for leg in &legs {
        let [first, last] = ends(&leg.course);
        sections.add(&leg.course, [first + SLACK_M, last - SLACK_M]);
    }
    let plan = |leg: &Leg| {
        Plan { course: &leg.course, ends: ends(&leg.course), wall, sections: &sections }.segments()
    };
    legs.iter().flat_map(plan).collect()
}

/// Where the walls of a leg stand.
struct Plan<'a> {
    course: &'a Course,
    /// The end walls, along the course [m].
    ends: [f64; 2],
    /// Distance of the side walls from the course [m].
    wall: f64,
    sections: &'a Sections,
}

impl Plan<'_> {
    fn segments(&self) -> Vec<Segment> {
        let mut segments = Vec::new();
        for side in [-self.wall, self.wall] {
            self.follow(side, &mut segments);
            self.pillars(side, &mut segments);
        }
        for end in self.ends {
            let tangent = self.course.at(end);
            let steps = (2.0 * self.wall / STEP_M).ceil();
            let corner = |share: f64| tangent.point(0.0, self.wall * (2.0 * share - 1.0));
            for step in 0..steps as u32 {
                let share = f64::from(step) / steps;
                self.clip(corner, share, share + 1.0 / steps, &mut segments);
            }
        }
        segments
    }

    /// Adds the wall `side` metres to the left of the course.
    fn follow(&self, side: f64, segments: &mut Vec<Segment>) {
        let corner = |along: f64| self.course.at(along).point(0.0, side);
        let [mut from, end] = self.ends;
        while from < end {
            let to = (from + self.step(from)).min(end);
            self.clip(corner, from, to, segments);
            from = to;
        }
    }

    /// How far the next corner is along the course [m].
    fn step(&self, along: f64) -> f64 {
        let [here, ahead] = [along, along + STEP_M].map(|along| self.course.curvature(along).abs());
        let sharp = here.max(ahead);
        // The outer wall turns by `turn` around a circle of `radius`; a chord is radius * turn^2 / 8 from its arc.
        let radius = 1.0 / sharp + self.wall;
        let turn = (8.0 * CHORD_M / radius).sqrt();
        if sharp > 0.0 { STEP_M.min(turn / sharp) } else { STEP_M }
    }

    /// Adds the part of a wall between two of its corners that does not stand in the way.
    fn clip(&self, corner: impl Fn(f64) -> Vector2<f64>, from: f64, to: f64, segments: &mut Vec<Segment>) {
        let blocks = |at: f64| self.sections.hold(corner(at), self.wall - SLACK_M);
        let [from, to] = match (blocks(from), blocks(to)) {
            (false, false) => [from, to],
            (true, true) => return,
            (before, _) => {
                let (mut free, mut blocked) = if before { (to, from) } else { (from, to) };
                for _ in 0..HALVINGS {
                    let middle = (free + blocked) / 2.0;
                    if blocks(middle) { blocked = middle } else { free = middle }
                }
                if before { [free, to] } else { [from, free] }
            }
        };
        if from < to {
            let segment = Segment::between(corner(from), corner(to));
            if !segments.last_mut().is_some_and(|last| last.extend(&segment)) {
                segments.push(segment);
            }
        }
    }

    /// Adds the pillars of the wall `side` metres to the left, equally spaced along it; one is at the begin of the course.
    fn pillars(&self, side: f64, segments: &mut Vec<Segment>) {
        let begin = self.course.begin_m();
        self.pillar(begin, side, segments);
        let corner = |along: f64| self.course.at(along).point(0.0, side);
        for (end, direction) in self.ends.into_iter().zip([-1.0, 1.0]) {
            let (mut along, mut since) = (begin, 0.0);
            while (end - along) * direction > 0.0 {
                let step = self.step(along);
                let length = (corner(along + direction * step) - corner(along)).norm();
                if since + length >= SPACING_M {
                    let at = along + direction * step * (SPACING_M - since) / length;
                    if (end - at) * direction > 0.0 {
                        self.pillar(at, side, segments);
                    }
                    since -= SPACING_M;
                }
                since += length;
                along += direction * step;
            }
        }
    }

    /// Adds a pillar unless it would stand in another part of the way.
    fn pillar(&self, along: f64, side: f64, segments: &mut Vec<Segment>) {
        let tangent = self.course.at(along);
        let face = side - PILLAR_M.copysign(side);
        let stands_in_the_way = self.sections.hold(tangent.point(0.0, side), self.wall - SLACK_M)
            || self.sections.hold(tangent.point(0.0, face), self.wall - SLACK_M - PILLAR_M);
        if !stands_in_the_way {
            let half = PILLAR_M / 2.0;
            let corners = [[-half, side], [-half, face], [half, face], [half, side]];
            let corners = corners.map(|[ahead, left]| tangent.point(ahead, left));
            segments.extend(corners.windows(2).map(|pair| Segment::between(pair[0], pair[1])));
        }
    }
}

#[cfg(test)]
mod tests;
