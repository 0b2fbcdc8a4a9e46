//! The course as lines that can be drawn.

use super::Course;
use crate::frame::to_track;

/// Distance from one point to the next, unless they would be too many [m].
const STEP_M: f64 = 0.2;
/// Most steps of a line.
const MAX_STEPS: f64 = 4000.0;

/// A course and the bounds of the robot's centre beside it, as lines of points; the ends of all three lie beside each other.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CourseOutline {
    /// The course itself [m].
    pub centre: Vec<[f64; 2]>,
    /// The bound to its left [m].
    pub left: Vec<[f64; 2]>,
    /// The bound to its right [m].
    pub right: Vec<[f64; 2]>,
}

impl CourseOutline {
    /// The corners of the way: along its left bound, and back along its right one.
    pub fn corners(&self) -> Vec<[f64; 2]> {
        self.left.iter().chain(self.right.iter().rev()).copied().collect()
    }

    /// The direction of the course where it is nearest to a point [rad].
    pub fn yaw_near(&self, [x, y]: [f64; 2]) -> f64 {
        let far = |pair: &&[[f64; 2]]| {
            let middle = [0, 1].map(|axis| f64::midpoint(pair[0][axis], pair[1][axis]));
            (middle[0] - x).hypot(middle[1] - y)
        };
        let nearest = self.centre.windows(2).min_by(|one, other| far(one).total_cmp(&far(other)));
        nearest.map_or(0.0, |pair| (pair[1][1] - pair[0][1]).atan2(pair[1][0] - pair[0][0]))
    }
}

/// A point of an ellipse about `centre` with semi-axes a and b, whose axis a has this yaw, at an angle from that axis.
pub fn ellipse_point(centre: [f64; 2], [a, b]: [f64; 2], yaw: f64, angle: f64) -> [f64; 2] {
    let (sin, cos) = angle.sin_cos();
    let offset = to_track(yaw, a * cos, b * sin);
    [centre[0] + offset.x, centre[1] + offset.y]
}

impl Course {
    /// The course between two lengths along it, as wide as its way.
    pub fn outline(&self, [from_m, to_m]: [f64; 2]) -> CourseOutline {
        let steps = ((to_m - from_m) / STEP_M).ceil().clamp(1.0, MAX_STEPS);
        let mut outline = CourseOutline::default();
        for step in 0..=steps as u32 {
            let along_m = from_m + (to_m - from_m) * f64::from(step) / steps;
            let (tangent, half_m) = (self.at(along_m), self.half_width_m(along_m));
            let beside = |left_m| <[f64; 2]>::from(tangent.point(0.0, left_m));
            outline.centre.push(<[f64; 2]>::from(tangent.point));
            outline.left.push(beside(half_m));
            outline.right.push(beside(-half_m));
        }
        outline
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::course::{CourseKeys, Waypoint, Widths};

    #[test]
    fn bounds_are_half_the_width_beside_the_course_and_its_ends_go_on_straight() {
        // A quarter of a circle with 10 m radius to the left.
        let waypoints = vec![
            Waypoint { yaw_rad: Some(0.0), ..Waypoint::default() },
            Waypoint::new(10.0, 10.0, Some(std::f64::consts::FRAC_PI_2)),
        ];
        let course =
            Course::try_from(CourseKeys { waypoints, width_m: Widths::All(4.0), ..CourseKeys::default() })
                .unwrap();
        let outline = course.outline([-2.0, course.length_m() + 2.0]);
        let close =
            |point: [f64; 2], x: f64, y: f64| (Vector2::from(point) - Vector2::new(x, y)).norm() < 1e-6;
        assert!(close(outline.left[0], -2.0, 2.0) && close(outline.right[0], -2.0, -2.0));
        assert!(outline.centre.last().is_some_and(|last| close(*last, 10.0, 12.0)));
        let middle = Vector2::new(0.0, 10.0);
        let on_arc = |point: &&[f64; 2]| point[0] > 0.0 && point[1] < 9.9;
        for (line, radius_m) in [(&outline.centre, 10.0), (&outline.left, 8.0), (&outline.right, 12.0)] {
            for point in line.iter().filter(on_arc) {
                assert!(((Vector2::from(*point) - middle).norm() - radius_m).abs() < 1e-6, "{point:?}");
            }
        }
        assert_eq!(outline.corners().len(), 2 * outline.centre.len());
        assert!(course.outline([0.0, 1e9]).centre.len() <= 4001);
    }

    #[test]
    fn an_ellipse_lies_along_the_course_beside_it() {
        let at = |x_m: f64, y_m: f64, yaw: f64| Waypoint::new(x_m, y_m, Some(yaw));
        let waypoints = vec![
            at(0.0, 0.0, 0.0),
            at(5.0, 5.0, std::f64::consts::FRAC_PI_2),
            at(5.0, 9.0, std::f64::consts::FRAC_PI_2),
        ];
        let course = Course::try_from(CourseKeys { waypoints, ..CourseKeys::default() }).unwrap();
        let yaw = course.outline([0.0, course.length_m()]).yaw_near([5.4, 7.0]);
        assert!((yaw - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
        let end = ellipse_point([5.4, 7.0], [1.2, 0.5], yaw, 0.0);
        assert!((end[0] - 5.4).abs() < 1e-9 && (end[1] - 8.2).abs() < 1e-9, "{end:?}");
    }
}
