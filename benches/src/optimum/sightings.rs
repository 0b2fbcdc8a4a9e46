//! From the described obstacles of each scan to the ellipses of the optimum.
//!
//! A description changes from scan to scan. The optimum gets one ellipse per identity:
//!
//! * the last description before the robot passed its centre: that is the one that the plans past it had to keep;
//! * with the margin of the command of that scan, as the controller adds it;
//! * but no larger than the drive kept it: a plan may be driven if the body keeps its margin, even where its centre cuts
//!   the ellipse by some centimetres;
//! * known from the first scan in which any ellipse contained its centre: an identity may change, the obstacle is
//!   known;
//! * not at all if it was forgotten before the robot entered its span, or first described behind its centre: it did
//!   not
//!   bind the robot where it counts.
//!
//! A moving body has the recorded centres of all scans, and keeps its last described velocity when it is seen no more.
//! The optimum knows this path from the first scan on, so it is clairvoyant about the motion, and the regret is not
//! smaller for that.

use std::collections::BTreeMap;

use shared_types::{Command, CommandKind, Obstacle, Obstacles, Truth};

use super::ellipse::{Ellipse, Path};

/// Speed in standard deviations from which a body counts as moving, as in the controller.
const SIGNIFICANCE: f64 = 2.0;
/// Speed below which a body counts as standing, as in the controller [m/s].
const STANDING_MPS: f64 = 0.08;

/// The descriptions of all scans.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sightings {
    scans: Vec<Sighting>,
    /// What the newest command that drives added to the ellipses, beside the fixed margin [m].
    growth_m: f64,
}

/// The description of one scan.
#[derive(Debug, Clone)]
struct Sighting {
    time_s: f64,
    x_m: f64,
    y_m: f64,
    speed_mps: f64,
    growth_m: f64,
    items: Vec<Obstacle>,
}

impl Sightings {
    /// Adds what was described for a scan. Scans come in their order.
    pub(crate) fn add(&mut self, truth: &Truth, obstacles: &Obstacles, command: Option<&Command>) {
        if let Some(command) = command.filter(|command| command.kind == CommandKind::Drive.wire()) {
            self.growth_m = command.margin.sum() - command.margin.base_m;
        }
        self.scans.push(Sighting {
            time_s: truth.time_s,
            x_m: truth.x_m,
            y_m: truth.y_m,
            speed_mps: truth.speed_mps,
            growth_m: self.growth_m,
            items: obstacles.list().to_vec(),
        });
    }

    /// The ellipses of the optimum, enlarged by `margin_m` and the growth of the margin, nearest first. A command acts
    /// `lead_s` after the scan that it answers.
    pub(crate) fn ellipses(&self, margin_m: f64, lead_s: f64) -> Vec<Ellipse> {
        let mut by_id: BTreeMap<u32, Vec<(&Sighting, &Obstacle)>> = BTreeMap::new();
        for scan in &self.scans {
            for item in &scan.items {
                by_id.entry(item.id).or_default().push((scan, item));
            }
        }
        let mut ellipses: Vec<Ellipse> =
            by_id.values().filter_map(|seen| self.ellipse(seen, margin_m, lead_s)).collect();
        ellipses.sort_by(|one, other| one.centre_at(0.0)[0].total_cmp(&other.centre_at(0.0)[0]));
        ellipses
    }

    fn ellipse(&self, seen: &[(&Sighting, &Obstacle)], margin_m: f64, lead_s: f64) -> Option<Ellipse> {
        let (scan, item) = *seen.iter().rev().find(|(scan, item)| scan.x_m <= item.x_m)?;
        let margin = margin_m + scan.growth_m;
        let (a, b) = (item.a_m + margin, item.b_m + margin);
        let moving = 2 * seen.iter().filter(|(_, item)| moves(item)).count() > seen.len();
        let (end, last) = *seen.last()?;
        let is_over = self.scans.last().is_some_and(|newest| newest.time_s <= end.time_s);
        if !is_over && !moving && end.x_m < last.x_m - a {
            return None;
        }
        let first = if moving { seen[0].0 } else { self.first_inside(item, [a, b]).unwrap_or(seen[0].0) };
        let path = if moving {
            let places = seen.iter().map(|(scan, item)| (scan.time_s, [item.x_m, item.y_m])).collect();
            Path::Recorded(places, [last.velocity_x_mps, last.velocity_y_mps])
        } else {
            Path::Fixed([item.x_m, item.y_m])
        };
        let known_x_m = first.x_m + first.speed_mps * lead_s;
        let passed_left = scan.y_m >= item.y_m;
        let known_s = first.time_s + lead_s;
        let described = Ellipse { body: item.body, a, b, passed_left, path, known_s, known_x_m };
        let kept = self.kept(&described);
        Some(Ellipse { a: a * kept, b: b * kept, ..described })
    }

    /// The scale at which the drive stayed outside of an ellipse, at most 1.
    fn kept(&self, ellipse: &Ellipse) -> f64 {
        let square = |scan: &Sighting| {
            let [x, y] = ellipse.centre_at(scan.time_s);
            ((scan.x_m - x) / ellipse.a).powi(2) + ((scan.y_m - y) / ellipse.b).powi(2)
        };
        let known = self.scans.iter().filter(|scan| scan.time_s >= ellipse.known_s);
        known.map(square).fold(1.0, f64::min).sqrt()
    }

    /// The first scan in which the centre of an ellipse was within this one.
    fn first_inside(&self, item: &Obstacle, [a, b]: [f64; 2]) -> Option<&Sighting> {
        let inside = |other: &Obstacle| {
            ((other.x_m - item.x_m) / a).powi(2) + ((other.y_m - item.y_m) / b).powi(2) < 1.0
        };
        self.scans.iter().find(|scan| scan.items.iter().any(inside))
    }
}

/// Whether the described velocity is significant against its covariance.
fn moves(item: &Obstacle) -> bool {
    let (x, y) = (item.velocity_x_mps, item.velocity_y_mps);
    let speed = x.hypot(y);
    let [xx, xy, yy] = item.velocity_covariance;
    let variance = (x * x * xx + 2.0 * x * y * xy + y * y * yy) / (speed * speed);
    speed > STANDING_MPS && speed * speed > SIGNIFICANCE * SIGNIFICANCE * variance
}

#[cfg(test)]
mod tests {
    use shared_types::Margin;

    use super::*;

    /// Obstacles that are described at each scan, 0.1 s and 0.1 m apart from x = 0, far to the right of all of them.
    fn sightings(scans: &[Vec<Obstacle>]) -> Sightings {
        along(-3.0, scans)
    }

    /// The same along another line.
    fn along(y_m: f64, scans: &[Vec<Obstacle>]) -> Sightings {
        let mut sightings = Sightings::default();
        for (index, items) in scans.iter().enumerate() {
            let at = 0.1 * index as f64;
            let truth = Truth { time_s: at, x_m: at, y_m, speed_mps: 1.0, ..Truth::default() };
            let mut obstacles = Obstacles { count: items.len() as u32, ..Obstacles::default() };
            obstacles.items[..items.len()].copy_from_slice(items);
            let margin = Margin { base_m: 0.05, pose_m: 0.01 * index as f64, ..Margin::default() };
            let command = Command { kind: CommandKind::Drive.wire(), margin, ..Command::default() };
            sightings.add(&truth, &obstacles, Some(&command));
        }
        sightings
    }

    fn obstacle(id: u32, x_m: f64, y_m: f64) -> Obstacle {
        Obstacle { id, body: id, x_m, y_m, a_m: 1.2, b_m: 0.5, ..Obstacle::default() }
    }

    #[test]
    fn the_last_description_before_the_centre_counts_from_the_first_sight_on() {
        let at = |index: usize| obstacle(7, 1.0, 0.01 * index as f64);
        let scans: Vec<Vec<Obstacle>> =
            (0..30).map(|index| if index < 3 { vec![] } else { vec![at(index)] }).collect();
        let ellipses = sightings(&scans).ellipses(0.02, 0.03);
        let [ellipse] = &ellipses[..] else { panic!("{ellipses:?}") };
        // At scan 10 the robot is at x = 1; the margin has grown by 0.1 m.
        assert_eq!(ellipse.path, Path::Fixed([1.0, 0.1]));
        assert!((ellipse.a - 1.32).abs() < 1e-12 && (ellipse.b - 0.62).abs() < 1e-12);
        assert!((ellipse.known_s - 0.33).abs() < 1e-12 && (ellipse.known_x_m - 0.33).abs() < 1e-12);
    }

    #[test]
    fn an_obstacle_that_changes_its_identity_is_known_from_its_first_one_on() {
        let scans: Vec<Vec<Obstacle>> = (0..80)
            .map(|index| vec![if index < 20 { obstacle(1, 5.0, 0.0) } else { obstacle(2, 5.1, 0.1) }])
            .collect();
        let ellipses = sightings(&scans).ellipses(0.02, 0.0);
        let [ellipse] = &ellipses[..] else { panic!("the first identity was forgotten: {ellipses:?}") };
        assert_eq!((ellipse.body, ellipse.known_s), (2, 0.0));
    }

    #[test]
    fn an_ellipse_is_no_larger_than_the_drive_kept_it() {
        // The robot drives along y = 0 past a centre at y = 0.48 with b = 0.5 + 0.02 + the margin at scan 20.
        let scans: Vec<Vec<Obstacle>> = (0..80).map(|_| vec![obstacle(1, 2.0, 0.48)]).collect();
        let ellipses = along(0.0, &scans).ellipses(0.02, 0.0);
        assert!((ellipses[0].b - 0.48).abs() < 1e-9, "{ellipses:?}");
        assert!((ellipses[0].a / ellipses[0].b - 1.42 / 0.72).abs() < 1e-9);
    }

    #[test]
    fn what_is_first_described_behind_the_robot_does_not_count() {
        let scans: Vec<Vec<Obstacle>> =
            (0..80).map(|index| if index < 60 { vec![] } else { vec![obstacle(1, 5.0, 0.9)] }).collect();
        assert!(sightings(&scans).ellipses(0.02, 0.0).is_empty());
    }

    #[test]
    fn a_moving_body_has_its_recorded_path_and_its_velocity_behind_it() {
        let moving = |index: usize| Obstacle {
            velocity_y_mps: 0.2,
            velocity_covariance: [1e-4, 0.0, 1e-4],
            ..obstacle(3, 5.0, 0.02 * index as f64 - 1.0)
        };
        let scans: Vec<Vec<Obstacle>> = (0..40).map(|index| vec![moving(index)]).collect();
        let ellipses = sightings(&scans).ellipses(0.0, 0.0);
        let [ellipse] = &ellipses[..] else { panic!("{ellipses:?}") };
        for (time_s, y_m) in [(0.0, -1.0), (1.05, -0.79), (3.9, -0.22), (5.0, 0.0)] {
            assert!((ellipse.centre_at(time_s)[1] - y_m).abs() < 1e-9, "{time_s}");
        }
        let noisy = |index: usize| Obstacle { velocity_covariance: [0.04, 0.0, 0.04], ..moving(index) };
        let scans: Vec<Vec<Obstacle>> = (0..40).map(|index| vec![noisy(index)]).collect();
        assert!(!sightings(&scans).ellipses(0.0, 0.0)[0].moves());
    }
}
