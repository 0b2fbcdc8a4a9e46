//! Clips polygons and lines to the part of the plane that is drawn.

/// A rectangle along the axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct View {
    /// Left and right end.
    pub(super) x: [f64; 2],
    /// Lower and upper end.
    pub(super) y: [f64; 2],
}

/// The part of a polygon inside the view, by Sutherland and Hodgman: one border after the other.
///
/// A polygon with a corner that is not finite is left out.
pub(super) fn polygon(points: &[[f64; 2]], view: &View) -> Vec<[f64; 2]> {
    if points.iter().flatten().any(|value| !value.is_finite()) {
        return Vec::new();
    }
    let borders = [(0, view.x[0], 1.0), (0, view.x[1], -1.0), (1, view.y[0], 1.0), (1, view.y[1], -1.0)];
    let mut inside = points.to_vec();
    for (axis, border, sign) in borders {
        let depth = |point: &[f64; 2]| sign * (point[axis] - border);
        let mut kept = Vec::with_capacity(inside.len() + 4);
        for (index, point) in inside.iter().enumerate() {
            let next = &inside[(index + 1) % inside.len()];
            let (here, there) = (depth(point), depth(next));
            if here >= 0.0 {
                kept.push(*point);
            }
            if (here >= 0.0) != (there >= 0.0) {
                kept.push(between(point, next, here / (here - there)));
            }
        }
        inside = kept;
    }
    inside
}

/// The parts of a line of points inside the view; points that are not finite break it.
pub(super) fn line(points: &[[f64; 2]], view: &View) -> Vec<Vec<[f64; 2]>> {
    let mut parts: Vec<Vec<[f64; 2]>> = Vec::new();
    for pair in points.windows(2) {
        let Some([from, to]) = segment(&pair[0], &pair[1], view) else { continue };
        match parts.last_mut() {
            Some(part) if part.last() == Some(&from) => part.push(to),
            _ => parts.push(vec![from, to]),
        }
    }
    parts
}

/// The part of a straight line inside the view, by Liang and Barsky.
fn segment(from: &[f64; 2], to: &[f64; 2], view: &View) -> Option<[[f64; 2]; 2]> {
    if from.iter().chain(to).any(|value| !value.is_finite()) {
        return None;
    }
    let (mut enters, mut leaves) = (0.0_f64, 1.0_f64);
    for (axis, [low, high]) in [(0, view.x), (1, view.y)] {
        let way = to[axis] - from[axis];
        for (depth, speed) in [(from[axis] - low, way), (high - from[axis], -way)] {
            if speed > 0.0 {
                enters = enters.max(-depth / speed);
            } else if speed < 0.0 {
                leaves = leaves.min(depth / -speed);
            } else if depth < 0.0 {
                return None;
            }
        }
    }
    // Ends inside the view are kept bit by bit, so that the parts of one line join.
    let start = if enters > 0.0 { between(from, to, enters) } else { *from };
    let end = if leaves < 1.0 { between(from, to, leaves) } else { *to };
    (enters <= leaves).then_some([start, end])
}

fn between(from: &[f64; 2], to: &[f64; 2], share: f64) -> [f64; 2] {
    [from[0] + (to[0] - from[0]) * share, from[1] + (to[1] - from[1]) * share]
}

/// Leaves out points nearer than `distance` to the last one kept; the last point stays.
pub(super) fn thin(points: impl Iterator<Item = [f64; 2]>, distance: f64) -> Vec<[f64; 2]> {
    let mut kept: Vec<[f64; 2]> = Vec::new();
    let mut skipped = None;
    for point in points {
        let near = kept.last().is_some_and(|last| (point[0] - last[0]).hypot(point[1] - last[1]) < distance);
        skipped = near.then_some(point);
        if !near {
            kept.push(point);
        }
    }
    kept.extend(skipped);
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    const VIEW: View = View { x: [0.0, 10.0], y: [0.0, 4.0] };

    #[test]
    fn a_polygon_inside_is_kept_and_one_outside_vanishes() {
        let triangle = [[1.0, 1.0], [3.0, 1.0], [2.0, 2.0]];
        assert_eq!(polygon(&triangle, &VIEW), triangle);
        assert_eq!(polygon(&triangle.map(|[x, y]| [x + 20.0, y]), &VIEW), Vec::<[f64; 2]>::new());
        assert_eq!(polygon(&[], &VIEW), Vec::<[f64; 2]>::new());
    }

    #[test]
    fn a_polygon_around_the_view_becomes_the_view() {
        let clipped = polygon(&[[-5.0, -5.0], [20.0, -5.0], [20.0, 20.0], [-5.0, 20.0]], &VIEW);
        let area = (0..clipped.len()).map(|index| {
            let ([x0, y0], [x1, y1]) = (clipped[index], clipped[(index + 1) % clipped.len()]);
            (x0 * y1 - x1 * y0) / 2.0
        });
        assert_eq!(area.sum::<f64>(), 40.0);
    }

    #[test]
    fn a_line_that_leaves_and_comes_back_has_two_parts() {
        let parts = line(&[[1.0, 1.0], [1.0, 3.0], [3.0, 5.0], [5.0, 3.0], [6.0, 3.0]], &VIEW);
        assert_eq!(
            parts,
            [vec![[1.0, 1.0], [1.0, 3.0], [2.0, 4.0]], vec![[4.0, 4.0], [5.0, 3.0], [6.0, 3.0]]]
        );
    }

    #[test]
    fn a_line_through_the_view_is_cut_at_both_sides() {
        assert_eq!(line(&[[-5.0, 2.0], [25.0, 2.0]], &VIEW), [vec![[0.0, 2.0], [10.0, 2.0]]]);
        assert!(line(&[[-5.0, 9.0], [25.0, 9.0]], &VIEW).is_empty());
        assert!(line(&[[1.0, 1.0], [f64::NAN, 2.0]], &VIEW).is_empty());
    }

    #[test]
    fn thinning_keeps_both_ends() {
        let points = (0..=100).map(|step| [f64::from(step) * 0.1, 0.0]);
        let kept = thin(points, 1.05);
        assert_eq!((kept[0], kept[kept.len() - 1]), ([0.0, 0.0], [10.0, 0.0]));
        assert_eq!(kept.len(), 11);
    }
}
