//! The drive on the map, in one strip or several.

mod movers;

use emulator::JudgedBy;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use vehicle::Goal;
use vehicle::course::{CourseOutline, ellipse_point};
use vehicle::frame::to_track;

use super::clip::{self, View};
use super::{
    Area, Axes, BODY, BOUND, EDGE, ELLIPSE, ESTIMATED_PATH, GOAL, OBSTACLE, TRACK, TRUE_PATH, WIDTH,
};
use super::{Ellipse, Moment, PictureDrive, PictureScene, Result, fine, mesh};

/// Room for labels on the left [pixels].
const LEFT: u32 = 60;
/// Room on the right [pixels].
const RIGHT: u32 = 66;
/// Width of a strip [pixels].
const ACROSS: u32 = WIDTH - LEFT - RIGHT;
/// Room below each strip for its labels [pixels].
const BELOW: u32 = 26;
/// More room below the last strip for the name of its axis [pixels].
const BELOW_LAST: u32 = 16;
/// Smallest height of a strip [pixels].
const MIN_DOWN: u32 = 90;
/// Largest height of a strip [pixels].
const MAX_DOWN: u32 = 640;

/// A drive is folded beyond this length [m].
const FOLD_M: f64 = 26.0;
/// Maximum number of strips.
const MAX_STRIPS: usize = 8;
/// Maximum length of a strip; of a longer drive the first part is left out [m].
const MAX_STRIP_M: f64 = 60.0;
/// Room around the drive [m].
const AROUND_M: f64 = 0.7;
/// Bounds of the track are shown up to this distance from the drive [m].
const NEAR_M: f64 = 3.0;
/// Positions beyond this are nonsense and not shown [m].
const FARTHEST_M: f64 = 1e6;
/// Maximum number of bodies per strip.
const MAX_BODIES: usize = 40;
/// Maximum number of points of a path; more are thinned further.
const MAX_POINTS: usize = 8000;
/// Corners of a drawn ellipse.
const CORNERS: usize = 72;

/// What part of the track each strip shows, and how large.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    strips: Vec<View>,
    down: u32,
    cut: bool,
}

impl Layout {
    /// Lays out the strips for a drive.
    pub(super) fn of(scene: &PictureScene, drive: &PictureDrive) -> Self {
        let whole = viewed(scene, drive);
        let length = whole.x[1] - whole.x[0];
        // A course may come back to any x.
        let foldable = scene.course.is_none() && whole.y[1] - whole.y[0] < FOLD_M / 2.0;
        let count = if foldable { ((length / FOLD_M).ceil() as usize).clamp(1, MAX_STRIPS) } else { 1 };
        let longest = if foldable { MAX_STRIP_M } else { f64::INFINITY };
        let strip_length = (length / count as f64).min(longest);
        let first = whole.x[1] - strip_length * count as f64;

        let wanted = (whole.y[1] - whole.y[0]) * f64::from(ACROSS) / strip_length;
        let down = (wanted.round() as u32).clamp(MIN_DOWN, MAX_DOWN);
        // Where the height was limited, more is shown in the other direction to keep the scale.
        let metres_down = strip_length * f64::from(down) / f64::from(ACROSS);
        let (wider, higher) = if wanted > f64::from(MAX_DOWN) {
            let metres_across = (whole.y[1] - whole.y[0]) * f64::from(ACROSS) / f64::from(down);
            ((metres_across - strip_length) / 2.0, 0.0)
        } else {
            (0.0, (metres_down - (whole.y[1] - whole.y[0])) / 2.0)
        };
        let strip = |index: usize| {
            let left = first + strip_length * index as f64;
            View {
                x: [left - wider, left + strip_length + wider],
                y: [whole.y[0] - higher, whole.y[1] + higher],
            }
        };
        Self {
            strips: (0..count).map(strip).collect(),
            down,
            cut: strip_length * (count as f64) < length - 1e-6,
        }
    }

    /// Height of all strips with their labels [pixels].
    pub(super) fn height(&self) -> u32 {
        self.strips.len() as u32 * (self.down + BELOW) + BELOW_LAST
    }

    /// Whether the first part of the drive is left out.
    pub(super) fn is_cut(&self) -> bool {
        self.cut
    }

    /// Scale along and across the track.
    #[cfg(test)]
    pub(super) fn pixels_per_metre(&self) -> (f64, f64) {
        let View { x, y } = self.strips[0];
        (f64::from(ACROSS) / (x[1] - x[0]), f64::from(self.down) / (y[1] - y[0]))
    }

    /// Whether a point is in the first strip, and there is no other one.
    #[cfg(test)]
    pub(super) fn shows(&self, x_m: f64, y_m: f64) -> bool {
        let View { x: [left, right], y: [low, high] } = self.strips[0];
        self.strips.len() == 1 && (left..=right).contains(&x_m) && (low..=high).contains(&y_m)
    }

    /// Draws all strips.
    pub(super) fn draw(&self, area: &Area<'_>, scene: &PictureScene, drive: &PictureDrive) -> Result<()> {
        let bodies = bodies(&drive.moments, MAX_BODIES * self.strips.len());
        let mut rest = area.clone();
        for (index, view) in self.strips.iter().enumerate() {
            let last = index + 1 == self.strips.len();
            let labels = if last { BELOW + BELOW_LAST } else { BELOW };
            let (strip, below) = rest.split_vertically(fine(self.down + labels));
            Strip { view, scene, drive }.draw(&strip, &bodies, labels, last)?;
            rest = below;
        }
        Ok(())
    }
}

/// The part of the track that is shown: the drive, start and goal, and the bounds near them.
fn viewed(scene: &PictureScene, drive: &PictureDrive) -> View {
    let path = drive.moments.iter().map(|moment| [moment.x_m, moment.y_m]);
    let way = scene.course.iter().flat_map(CourseOutline::corners);
    let goals = scene.goals.iter().map(|goal| [goal.x_m, goal.y_m]);
    let points = path.chain(drive.estimates.iter().copied()).chain([scene.start_m]).chain(goals).chain(way);
    let mut view = View { x: [f64::INFINITY, f64::NEG_INFINITY], y: [f64::INFINITY, f64::NEG_INFINITY] };
    for [x, y] in points.filter(|point| point.iter().all(|value| value.abs() < FARTHEST_M)) {
        view.x = [view.x[0].min(x - AROUND_M), view.x[1].max(x + AROUND_M)];
        view.y = [view.y[0].min(y - AROUND_M), view.y[1].max(y + AROUND_M)];
    }
    if view.x[0] > view.x[1] {
        return View { x: [0.0, 10.0], y: [-2.0, 2.0] };
    }
    for bound in scene.track_y_m.into_iter().filter(|_| scene.course.is_none()) {
        if bound >= view.y[0] - NEAR_M && bound <= view.y[1] + NEAR_M {
            view.y = [view.y[0].min(bound - AROUND_M / 3.0), view.y[1].max(bound + AROUND_M / 3.0)];
        }
    }
    view
}

/// The moments at which the body is drawn: one per second, or fewer where that would be too many.
fn bodies(moments: &[Moment], max: usize) -> Vec<Moment> {
    let finite = moments.iter().filter(|moment| moment.time_s.abs() < FARTHEST_M);
    let last_s = finite.clone().next_back().map_or(0.0, |moment| moment.time_s);
    let first_s = finite.clone().next().map_or(0.0, |moment| moment.time_s);
    let every_s = ((last_s - first_s) / max as f64).ceil().max(1.0);
    // Half a scan at 100 Hz of tolerance: scans do not fall on whole seconds exactly.
    let mut due_s = first_s - 0.005;
    let mut chosen: Vec<Moment> = Vec::new();
    for moment in finite {
        if moment.time_s >= due_s {
            chosen.push(*moment);
            due_s += every_s * ((moment.time_s - due_s) / every_s).floor().max(0.0) + every_s;
        }
    }
    chosen
}

/// One strip: the part of the plane it shows, and what is drawn in it.
struct Strip<'a> {
    view: &'a View,
    scene: &'a PictureScene,
    drive: &'a PictureDrive,
}

impl Strip<'_> {
    fn draw(&self, area: &Area<'_>, bodies: &[Moment], labels: u32, last: bool) -> Result<()> {
        let View { x, y } = *self.view;
        let mut chart = ChartBuilder::on(area)
            .margin_left(fine(EDGE))
            .margin_right(fine(RIGHT))
            .x_label_area_size(fine(labels))
            .y_label_area_size(fine(LEFT - EDGE))
            .build_cartesian_2d(x[0]..x[1], y[0]..y[1])?;
        self.draw_ground(&mut chart)?;
        self.draw_mesh(&mut chart, last)?;
        self.draw_bounds(&mut chart)?;
        self.draw_things(&mut chart)?;
        for body in bodies {
            self.outline(&mut chart, &self.body(body), BODY.stroke_width(fine(1) as u32))?;
        }
        self.draw_paths(&mut chart)
    }

    fn draw_mesh(&self, chart: &mut Axes<'_, '_>, last: bool) -> Result<()> {
        let height = self.view.y[1] - self.view.y[0];
        let mut mesh = mesh(chart);
        mesh.x_labels(14)
            .y_labels(if height < 3.0 { 4 } else { 6 })
            .x_label_formatter(&|x| trim(*x))
            .y_label_formatter(&|y| trim(*y))
            .y_desc("y [m]");
        if last {
            mesh.x_desc("x [m]");
        }
        Ok(mesh.draw()?)
    }

    fn draw_ground(&self, chart: &mut Axes<'_, '_>) -> Result<()> {
        if let Some(course) = &self.scene.course {
            return self.fill(chart, &course.corners(), TRACK.filled());
        }
        let PictureScene { track_x_m: [left, right], track_y_m: [low, high], .. } = *self.scene;
        self.fill(chart, &[[left, low], [right, low], [right, high], [left, high]], TRACK.filled())
    }

    fn draw_bounds(&self, chart: &mut Axes<'_, '_>) -> Result<()> {
        let PictureScene { track_x_m: [left, right], track_y_m: [low, high], walls, .. } = *self.scene;
        let bound = BOUND.stroke_width(fine(1) as u32 * 3 / 2);
        if let Some(course) = &self.scene.course {
            self.line(chart, &course.centre, BOUND.stroke_width(fine(1) as u32), true)?;
            return self.outline(chart, &course.corners(), bound);
        }
        let lateral = if walls { OBSTACLE.stroke_width(fine(4) as u32) } else { bound };
        for y in [low, high] {
            self.line(chart, &[[left, y], [right, y]], lateral, !walls)?;
        }
        for x in [left, right] {
            self.line(chart, &[[x, low], [x, high]], bound, true)?;
        }
        Ok(())
    }

    /// Obstacles, ellipses and the goal.
    fn draw_things(&self, chart: &mut Axes<'_, '_>) -> Result<()> {
        for ellipse in &self.drive.ellipses {
            let at = [ellipse.x_m, ellipse.y_m];
            let corners =
                corners(ellipse, self.scene.course.as_ref().map_or(0.0, |course| course.yaw_near(at)));
            self.fill(chart, &corners, ELLIPSE.mix(0.10).filled())?;
            self.outline(chart, &corners, ELLIPSE.stroke_width(fine(1) as u32))?;
        }
        for obstacle in &self.scene.obstacles {
            match obstacle.places.as_slice() {
                [] => self.fill(chart, &obstacle.points, OBSTACLE.filled())?,
                places => self.draw_way(chart, &obstacle.points, places)?,
            }
        }
        for Goal { x_m, y_m, tolerance_m: radius, .. } in self.scene.goals.iter().copied() {
            let tolerance = corners(&Ellipse { x_m, y_m, a_m: radius, b_m: radius }, 0.0);
            self.fill(chart, &tolerance, GOAL.mix(0.15).filled())?;
            self.outline(chart, &tolerance, GOAL.stroke_width(fine(2) as u32))?;
            self.dot(chart, [x_m, y_m], 2, GOAL)?;
        }
        Ok(())
    }

    fn draw_paths(&self, chart: &mut Axes<'_, '_>) -> Result<()> {
        let fine_step = (self.view.x[1] - self.view.x[0]) / f64::from(fine(ACROSS));
        let path = self.drive.moments.iter().map(|moment| [moment.x_m, moment.y_m]);
        let path = thinned(path, 2.0 * fine_step);
        if self.drive.judged_by == JudgedBy::Truth {
            self.line(chart, &path, TRUE_PATH.stroke_width(fine(5) as u32 / 2), false)?;
        }
        let estimates = thinned(self.drive.estimates.iter().copied(), 2.0 * fine_step);
        // A tangle of many rounds shows no dashes, but would be made of very many.
        let dashed = estimates.len() < MAX_POINTS / 2;
        self.line(chart, &estimates, ESTIMATED_PATH.stroke_width(fine(3) as u32 / 2), dashed)?;
        self.dot(chart, self.scene.start_m, 5, TRUE_PATH)
    }

    fn body(&self, moment: &Moment) -> [[f64; 2]; 4] {
        let (forward, left) = (self.scene.body_length_m / 2.0, self.scene.body_width_m / 2.0);
        [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)].map(|(along, across)| {
            let offset = to_track(moment.yaw_rad, self.scene.body_x_m + along * forward, across * left);
            [moment.x_m + offset.x, moment.y_m + offset.y]
        })
    }

    fn fill(&self, chart: &mut Axes<'_, '_>, points: &[[f64; 2]], style: ShapeStyle) -> Result<()> {
        let inside = pairs(&clip::polygon(points, self.view));
        if inside.len() >= 3 {
            chart.draw_series([Polygon::new(inside, style)])?;
        }
        Ok(())
    }

    fn outline(&self, chart: &mut Axes<'_, '_>, points: &[[f64; 2]], style: ShapeStyle) -> Result<()> {
        let closed: Vec<[f64; 2]> = points.iter().chain(points.first()).copied().collect();
        self.line(chart, &closed, style, false)
    }

    fn line(
        &self,
        chart: &mut Axes<'_, '_>,
        points: &[[f64; 2]],
        style: ShapeStyle,
        dashed: bool,
    ) -> Result<()> {
        for part in clip::line(points, self.view) {
            let part = pairs(&part);
            if dashed {
                chart.draw_series([DashedPathElement::new(part, fine(6), fine(4), style)])?;
            } else {
                chart.draw_series([PathElement::new(part, style)])?;
            }
        }
        Ok(())
    }

    fn dot(&self, chart: &mut Axes<'_, '_>, [x, y]: [f64; 2], radius: u32, colour: RGBColor) -> Result<()> {
        let View { x: [left, right], y: [low, high] } = *self.view;
        if (left..=right).contains(&x) && (low..=high).contains(&y) {
            chart.draw_series([Circle::new((x, y), fine(radius), colour.filled())])?;
        }
        Ok(())
    }
}

/// Points at least `distance` apart, or further where they would be too many.
fn thinned(points: impl Iterator<Item = [f64; 2]>, distance: f64) -> Vec<[f64; 2]> {
    let mut kept = clip::thin(points, distance);
    let mut distance = distance;
    while kept.len() > MAX_POINTS && distance.is_finite() && distance > 0.0 {
        distance *= 2.0;
        kept = clip::thin(kept.into_iter(), distance);
    }
    kept
}

/// The corners of an ellipse whose axis a has this yaw.
fn corners(ellipse: &Ellipse, yaw: f64) -> Vec<[f64; 2]> {
    let Ellipse { x_m, y_m, a_m, b_m } = *ellipse;
    let corner = |index: usize| {
        let angle = index as f64 / CORNERS as f64 * std::f64::consts::TAU;
        ellipse_point([x_m, y_m], [a_m, b_m], yaw, angle)
    };
    (0..CORNERS).map(corner).collect()
}

fn pairs(points: &[[f64; 2]]) -> Vec<(f64, f64)> {
    points.iter().map(|&[x, y]| (x, y)).collect()
}

/// A label without needless digits.
fn trim(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bodies_are_a_second_apart_or_as_many_as_allowed() {
        let moments: Vec<Moment> =
            (0..1000).map(|scan| Moment { time_s: f64::from(scan) * 0.1, ..Moment::default() }).collect();
        let times: Vec<f64> = bodies(&moments[..31], 40).iter().map(|moment| moment.time_s).collect();
        assert_eq!(times.len(), 4, "{times:?}");
        assert!(bodies(&moments, 40).len() <= 41);
    }

    #[test]
    fn labels_have_no_needless_digits() {
        assert_eq!([trim(2.0), trim(-0.5), trim(-0.0), trim(12.25)], ["2", "-0.5", "0", "12.25"]);
    }
}
