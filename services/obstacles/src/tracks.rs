//! All tracked bodies: started, updated, united and forgotten.

use std::ops::RangeInclusive;

use nalgebra::Vector2;
use shared_types::{SECTOR_BEAMS, Scan};
use vehicle::frame::to_track;
use vehicle::geometry::Rectangle;

use crate::ObstaclesConfig;
use crate::evidence::{Evidence, REST_MPS};
use crate::hull::Hull;
use crate::outline::Vertex;
use crate::outlines::Outlines;
use crate::part::Known;
use crate::points::{Beams, Place};
use crate::shape::Directions;
use crate::state::TRACKS;
use crate::track::{MAX_BODY, Track, View};
use crate::visibility::{Sight, beams_towards, free_sides, sight};
use crate::way::Way;

/// Bodies nearer to each other than this are one [m].
const TOUCHING_M: f64 = 0.04;
/// A body that is not confirmed is forgotten after this time [s].
const SPECKLE_MEMORY_S: f64 = 0.35;
/// When a body that stands should be in view and has shown nothing for this long, the scanner is doubted there [s].
const DOUBTFUL_S: f64 = 0.25;
/// When a body that stands has been silent for this long while the robot rested, the robot may drive on past it [s].
const RELIED_S: f64 = 0.5;
/// When it still rests after this time, the body has gone [s]. Neither has moved since it was seen, so its surface has not
/// turned black: either it has gone, or the scanner fails there and nowhere else.
const GONE_S: f64 = 0.9;
/// A scan counts for no longer than this: what was silent in one only has not gone [s].
const COUNTED_S: f64 = 0.4;
/// Only of a body that is seen by so many beams of a sector of 11, without its rim, can it be found that it has gone: with
/// its rim that is more than two sectors. What a sector that fails may hide is not forgotten.
const WIDE_BEAMS: usize = 14;
/// A body that has gone was within this distance of where it is known [m].
const AROUND_M: f64 = 0.2;
/// A body further away than this is out of reach: the pose must have jumped [m].
const LOST_M: f64 = 12.0;

/// The tracked bodies, oldest first; buffers are kept.
#[derive(Debug, Clone)]
pub(crate) struct Tracks {
    /// The bodies.
    pub(crate) list: Vec<Track>,
    /// Identity of the body last found.
    pub(crate) last_body: u32,
    /// The directions of their reaches.
    pub(crate) directions: Directions,
    config: ObstaclesConfig,
    view: Vec<Vertex>,
    boxes: Vec<Rectangle>,
    hull: Hull,
}

impl Tracks {
    /// No bodies, and room for all.
    pub(crate) fn new(config: ObstaclesConfig, beams: &Beams) -> Self {
        Self {
            list: Vec::with_capacity(TRACKS + 1),
            last_body: 0,
            config,
            directions: Directions::new(),
            view: Vec::with_capacity(4 * beams.count()),
            boxes: Vec::with_capacity(TRACKS + 1),
            hull: Hull::with_capacity(beams),
        }
    }

    /// The boxes where the next sightings are expected, and whether the bodies move.
    pub(crate) fn expected(&self) -> impl Iterator<Item = Known> {
        self.list.iter().map(|track| (track.expected(&self.directions), track.moving))
    }

    /// The bodies `elapsed` seconds later.
    pub(crate) fn predict(&mut self, elapsed: f64) {
        for track in &mut self.list {
            track.predict(elapsed);
        }
    }

    /// Updates each track with all outlines that belong to it.
    pub(crate) fn sight(
        &mut self,
        outlines: &Outlines,
        evidence: &mut Evidence,
        place: &Place,
        elapsed: f64,
    ) {
        for (index, track) in self.list.iter_mut().enumerate() {
            self.view.clear();
            let (mut returns, mut edges) = (0, Vector2::zeros());
            for outline in outlines.list.iter().filter(|outline| outline.track == Some(index)) {
                self.view.extend_from_slice(outlines.vertices(outline));
                returns += outline.returns;
                edges += outline.edges;
            }
            if returns == 0 {
                continue;
            }
            if track.unseen_s > elapsed {
                track.free = 0;
            }
            // Time since it was last seen, which may be longer than a scan.
            let elapsed = track.unseen_s.max(elapsed);
            let view = View { vertices: &self.view, edges, returns, robot: place.at, elapsed };
            let stood = !track.moving;
            track.sight(&view, &self.config, &self.directions);
            track.confirmed = true;
            if stood && track.moving && place.speed() < REST_MPS {
                evidence.release(&track.swept(&self.directions));
            }
        }
    }

    /// Starts a track for each outline in the window that belongs to none; returns how many did not fit.
    pub(crate) fn start(&mut self, outlines: &Outlines, place: &Place, way: &Way) -> u32 {
        let mut overflow = 0;
        for outline in outlines.list.iter().filter(|outline| outline.track.is_none() && outline.may_start) {
            let vertices = outlines.vertices(outline);
            let nearest =
                vertices.iter().map(|vertex| (vertex.at - place.at).norm()).fold(f64::INFINITY, f64::min);
            if self.list.len() >= TRACKS {
                if way.is_beside(vertices.iter().map(|vertex| vertex.at)) {
                    continue;
                }
                let Some(farthest) = least_needed(&self.list, way, place, nearest, &self.directions) else {
                    overflow += 1;
                    continue;
                };
                self.list.remove(farthest);
            }
            self.last_body = self.last_body % MAX_BODY + 1;
            let view = View {
                vertices,
                edges: outline.edges,
                returns: outline.returns,
                robot: place.at,
                elapsed: 0.0,
            };
            let mut track = Track::start(self.last_body, &view, &self.config, &self.directions);
            // A wall may be near although its ends, the only vertices, are not.
            let distance = track.rectangle(&self.directions).distance_to_point(place.at);
            track.confirmed = distance < self.config.first_sight_m();
            self.list.push(track);
        }
        overflow
    }

    /// Forgets bodies whose place is free, or from which nothing has come for too long.
    pub(crate) fn forget(
        &mut self,
        scan: &Scan,
        beams: &Beams,
        evidence: &mut Evidence,
        (place, way): (&Place, &Way),
        elapsed: f64,
    ) {
        let is_reliable = evidence.is_reliable();
        let rests = place.speed() < REST_MPS;
        let sector_beams = evidence.sector_beams();
        let wide_beams = (WIDE_BEAMS * sector_beams).div_ceil(SECTOR_BEAMS);
        for track in self.list.iter_mut().filter(|track| track.unseen_s == 0.0 && !track.moving) {
            let rectangle = track.rectangle(&self.directions);
            let mut sides = free_sides(scan, beams, place, &rectangle, None);
            let is_free = sides.iter().flatten().next().is_some();
            track.free = if is_free { track.free.saturating_add(1) } else { 0 };
            if !is_free {
                sides = free_sides(scan, beams, place, &rectangle, Some(wide_beams));
                let silent = || sides.iter().flatten();
                // What was never seen from about here may be silent for other reasons.
                let has_begun = track.rested_s > 0.0 || silent().any(|side| evidence.suspects(side));
                if !(is_reliable && has_begun && silent().next().is_some()) {
                    track.rested_s = 0.0;
                    continue;
                }
                track.rested_s += if rests { elapsed.min(COUNTED_S) } else { f64::EPSILON };
                // A scanner that loses many returns leaves sides silent while the robot drives.
                if rests {
                    silent().for_each(|side| evidence.doubt(side, track.rested_s >= RELIED_S));
                }
            }
            let has_gone = track.rested_s >= GONE_S && evidence.lacks_only_bodies();
            if is_free && track.free >= self.config.free_scans || !is_free && has_gone {
                (track.free, track.rested_s) = (0, 0.0);
                let inner = |side: Option<RangeInclusive<usize>>, is_right: bool| {
                    let unit =
                        beams.unit(side.map(|side| if is_right { *side.end() } else { *side.start() })?);
                    Some(to_track(place.yaw, unit.x, unit.y))
                };
                let [right, left] = sides;
                let sides = [inner(right, true), inner(left, false)];
                if let Some(before) = track.trim(sides, place.at, &self.directions) {
                    evidence.release(&around(&before));
                }
            }
        }
        for track in self.list.iter_mut().filter(|track| track.unseen_s > 0.0) {
            if track.unseen_s <= elapsed {
                track.free = 0;
            }
            let rectangle = track.rectangle(&self.directions);
            match sight(scan, beams, place, &rectangle) {
                Sight::Free => track.free = track.free.saturating_add(1),
                Sight::Taken => track.free = 0,
                Sight::Silent => {
                    let counted = if is_reliable { elapsed.min(COUNTED_S) } else { 0.0 };
                    let had_rested = track.rested_s >= RELIED_S;
                    track.silent_s += counted;
                    let towards = beams_towards(beams, place, &rectangle);
                    let is_wide = towards.clone().is_some_and(|towards| towards.count() >= wide_beams);
                    track.rested_s += if rests && is_wide { counted } else { 0.0 };
                    if track.stands()
                        && !way.is_box_beside(&rectangle)
                        && track.silent_s > DOUBTFUL_S
                        && let Some(towards) = towards
                    {
                        let may_have_gone = track.rested_s >= RELIED_S;
                        if may_have_gone && !had_rested {
                            evidence.release(&around(&rectangle));
                        }
                        evidence.doubt(&towards, may_have_gone);
                    }
                }
                Sight::Unknown => {}
            }
        }
        let limit = self.config.free_scans;
        let memory_s = self.config.memory_s;
        // Scans may come at irregular times, but none in less than it takes to sweep.
        let period = elapsed.max(scan.sweep_ns as f64 * 1e-9);
        let lacks_only_bodies = evidence.lacks_only_bodies();
        let directions = &self.directions;
        self.list.retain(|track| {
            let is_free = track.free >= if track.confirmed { limit } else { limit.min(2) };
            let has_gone = track.rested_s >= GONE_S && lacks_only_bodies;
            let is_forgotten = is_free || has_gone || track.is_outdated(memory_s, period);
            if is_forgotten {
                evidence.release(&around(&track.rectangle(directions)));
            }
            !is_forgotten
        });
    }

    /// Merges standing bodies that touch: parts of one body that were first seen apart, by the robot at `robot`.
    pub(crate) fn unite(&mut self, robot: Vector2<f64>, way: &Way) {
        self.boxes.clear();
        self.boxes.extend(self.list.iter().map(|track| track.rectangle(&self.directions)));
        let mut older = 0;
        while older < self.list.len() {
            let mut younger = older + 1;
            while younger < self.list.len() {
                let (a, b) = (&self.boxes[older], &self.boxes[younger]);
                let standing = !self.list[older].moving && !self.list[younger].moving;
                let reach = (a.length.hypot(a.width) + b.length.hypot(b.width)) / 2.0 + TOUCHING_M;
                let touch = standing
                    && (a.centre - b.centre).norm_squared() < reach * reach
                    && a.distance_to_rectangle(b) < TOUCHING_M
                    && way.is_box_beside(a) == way.is_box_beside(b)
                    && !self.hull.is_hollow_between(a, b, robot);
                if touch {
                    let part = self.list.remove(younger);
                    self.boxes.remove(younger);
                    self.list[older].absorb(&part, &self.directions);
                    self.boxes[older] = self.list[older].rectangle(&self.directions);
                } else {
                    younger += 1;
                }
            }
            older += 1;
        }
    }

    /// Forgets bodies that are far behind, out of reach, moved out of sight, or never confirmed.
    pub(crate) fn expire(&mut self, pose: [f64; 3], way: &Way) {
        let (config, directions) = (&self.config, &self.directions);
        self.list.retain(|track| {
            if !track.is_sound() {
                return false;
            }
            let rectangle = track.rectangle(directions);
            let at = Vector2::new(pose[0], pose[1]);
            let front = rectangle
                .corners()
                .map(|corner| way.ahead(pose, corner))
                .into_iter()
                .fold(f64::NEG_INFINITY, f64::max);
            let lost = rectangle.distance_to_point(at) > LOST_M || front < -config.keep_behind_m;
            let gone = track.moving && track.unseen_s > config.moving_memory_s;
            let speckle = !track.confirmed && track.unseen_s > SPECKLE_MEMORY_S;
            !(lost || gone || speckle)
        });
    }
}

/// A box with some room around it.
fn around(rectangle: &Rectangle) -> Rectangle {
    let Rectangle { length, width, .. } = *rectangle;
    Rectangle { length: length + 2.0 * AROUND_M, width: width + 2.0 * AROUND_M, ..*rectangle }
}

/// Index of the track that is needed least: the farthest that is at rest beside the track, else the farthest among those not
/// seen now, when it is farther than `distance`.
fn least_needed(
    tracks: &[Track],
    way: &Way,
    place: &Place,
    distance: f64,
    directions: &Directions,
) -> Option<usize> {
    let mut farthest = (distance, None);
    for (index, track) in tracks.iter().enumerate() {
        let rectangle = track.rectangle(directions);
        let beside = !track.moving && way.is_box_beside(&rectangle);
        let distance = rectangle.distance_to_point(place.at) + if beside { LOST_M } else { 0.0 };
        if (beside || track.unseen_s > 0.0) && distance > farthest.0 {
            farthest = (distance, Some(index));
        }
    }
    farthest.1
}
