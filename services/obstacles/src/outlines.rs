//! Outlines of one scan: what it shows of bodies, and of which tracked body each is.

use nalgebra::Vector2;
use shared_types::Scan;

use crate::ObstaclesConfig;
use crate::hull::{HOLLOW_M, Hull};
use crate::outline::{Vertex, trace};
use crate::part::Known;
use crate::points::{Beams, Place, Point};
use crate::segment::Segments;
use crate::state::TRACKS;
use crate::walls::Walls;
use crate::way::Way;

/// Returns nearer than this to where a body is expected belong to it [m]; at 1 m/s it moves 0.1 m between scans.
const GATE_M: f64 = 0.2;
/// Growth of the gate with the distance: three standard deviations of a yaw that is off by 0.01 rad.
const GATE_PER_M: f64 = 0.03;

/// Outline of one cluster: a range of the vertices.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Outline {
    /// Index of its first vertex.
    first: usize,
    /// Index behind its last vertex.
    end: usize,
    /// Number of its returns.
    pub(crate) returns: usize,
    /// Direction of its edges, see [`trace`].
    pub(crate) edges: Vector2<f64>,
    /// Whether it is evidence enough for a new body.
    pub(crate) may_start: bool,
    /// Index of the track that it belongs to.
    pub(crate) track: Option<usize>,
}

/// The outlines of one scan; buffers are kept.
#[derive(Debug, Clone, Default)]
pub(crate) struct Outlines {
    /// All outlines, from right to left.
    pub(crate) list: Vec<Outline>,
    segments: Segments,
    vertices: Vec<Vertex>,
    expected: Vec<Known>,
    /// Of each whether it is beside the track.
    beside: Vec<bool>,
    hull: Hull,
}

impl Outlines {
    /// Buffers large enough for any scan of a scanner that is turned by `yaw_rad`.
    pub(crate) fn with_capacity(beams: &Beams, yaw_rad: f64) -> Self {
        let count = beams.count();
        Self {
            list: Vec::with_capacity(count),
            segments: Segments::with_capacity(beams, yaw_rad),
            vertices: Vec::with_capacity(4 * count),
            expected: Vec::with_capacity(TRACKS + 1),
            beside: Vec::with_capacity(TRACKS + 1),
            hull: Hull::with_capacity(beams),
        }
    }

    /// Finds the outlines among `points`, without those on walls, and which of the `known` bodies each belongs to.
    pub(crate) fn find(
        &mut self,
        config: &ObstaclesConfig,
        (scan, beams): (&Scan, &Beams),
        (place, way): (&Place, &Way),
        points: &mut Vec<Point>,
        known: impl Iterator<Item = Known>,
    ) {
        self.expected.clear();
        self.expected.extend(known);
        self.beside.clear();
        self.beside.extend(self.expected.iter().map(|(expected, _)| way.is_box_beside(expected)));
        self.outline(config, (scan, beams), (place, way), points);
        self.associate(place, way);
    }

    /// The vertices of an outline.
    pub(crate) fn vertices(&self, outline: &Outline) -> &[Vertex] {
        &self.vertices[outline.first..outline.end]
    }

    /// Each outline with its returns.
    pub(crate) fn members(&self) -> impl Iterator<Item = (&Outline, &[Point])> {
        let returns = |first: usize, end: usize| &self.segments.members[first..end];
        self.list
            .iter()
            .zip(self.segments.clusters.iter().map(move |cluster| returns(cluster.first, cluster.end)))
    }

    /// Segments the scan into outlines of bodies.
    fn outline(
        &mut self,
        config: &ObstaclesConfig,
        (scan, beams): (&Scan, &Beams),
        (place, way): (&Place, &Way),
        points: &mut Vec<Point>,
    ) {
        let walls = Walls::fit(config, place, points);
        points.retain(|point| walls.leaves(way.of(point)));
        let is_beside = |point: &Point| way.is_point_beside(point);
        self.segments.find((scan, beams), points, config.range_noise_m, is_beside);
        self.segments.part(&self.expected);
        self.segments.part_at_hollows(config.range_noise_m);
        self.list.clear();
        self.vertices.clear();
        for cluster in &self.segments.clusters {
            let members = &self.segments.members[cluster.first..cluster.end];
            let first = self.vertices.len();
            let edges =
                trace(cluster, members, (place, beams.pitch()), config.range_noise_m, &mut self.vertices);
            walls.extend(&mut self.vertices, first);
            let end = self.vertices.len();
            self.list.push(Outline {
                first,
                end,
                returns: members.len(),
                edges,
                may_start: cluster.may_start,
                track: None,
            });
        }
    }

    /// Gives each outline to the track whose expected box it is nearest to.
    fn associate(&mut self, place: &Place, way: &Way) {
        for outline in &mut self.list {
            let vertices = &self.vertices[outline.first..outline.end];
            let mut best = f64::INFINITY;
            let beside = way.is_beside(vertices.iter().map(|vertex| vertex.at));
            for (index, (expected, moves)) in self.expected.iter().enumerate() {
                if !moves && self.beside[index] != beside {
                    continue;
                }
                let (mut least, mut sum) = (f64::INFINITY, 0.0);
                for vertex in vertices {
                    let distance = expected.distance_to_point(vertex.at).max(0.0);
                    least = least.min(distance);
                    sum += distance;
                }
                let gate = GATE_M + GATE_PER_M * (expected.centre - place.at).norm();
                // The mean decides between two boxes that both touch the outline.
                let cost = least + 0.1 * sum / vertices.len() as f64;
                // What lies on the body is of it, whatever its shape.
                let is_on_it = *moves || !outline.may_start || sum < HOLLOW_M * vertices.len() as f64;
                if least < gate
                    && cost < best
                    && (is_on_it || !self.hull.is_hollow(expected, vertices, place.at))
                {
                    (best, outline.track) = (cost, Some(index));
                }
            }
        }
    }
}
