//! The combinations of passing sides that are tried.

use super::ellipse::Ellipse;

/// Maximum number of bodies that are tried on both sides: 2^5 combinations. Others are passed on the side of the line.
const MAX_BODIES: usize = 5;

/// The ellipses of one body, which are passed on one side.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Body<'a> {
    pub(crate) ellipses: Vec<&'a Ellipse>,
    /// Whether it may be passed on the left, and on the right.
    sides: [bool; 2],
}

/// Which sides are tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sides {
    /// Both of each body.
    Both,
    /// Those on which the robot of the drive passed.
    Taken,
}

/// A side for each body: true is left.
pub(crate) type Combination = Vec<bool>;

/// The bodies ahead of a place at a time, each with its possible sides.
pub(crate) fn bodies<'a>(
    ellipses: &[&'a Ellipse],
    time_s: f64,
    place: [f64; 2],
    line_y: f64,
    tried: Sides,
) -> Vec<Body<'a>> {
    let mut bodies: Vec<Body> = Vec::new();
    for &ellipse in ellipses {
        let [x, y] = ellipse.centre_at(time_s);
        let known = bodies.iter_mut().find(|body| body.ellipses[0].body == ellipse.body);
        let beside = !ellipse.moves() && (place[0] - x).abs() < 0.8 * ellipse.a;
        let sides = match tried {
            Sides::Taken => [ellipse.passed_left, !ellipse.passed_left],
            Sides::Both if beside => [place[1] >= y, place[1] < y],
            Sides::Both => [true; 2],
        };
        match known {
            Some(body) => {
                body.ellipses.push(ellipse);
                let both = [body.sides[0] && sides[0], body.sides[1] && sides[1]];
                body.sides = if both == [false; 2] { sides } else { both };
            }
            None => bodies.push(Body { ellipses: vec![ellipse], sides }),
        }
    }
    limit(&mut bodies, time_s, line_y);
    bodies
}

/// All combinations of the possible sides.
pub(crate) fn combinations(bodies: &[Body]) -> Vec<Combination> {
    let mut all = vec![Vec::new()];
    for body in bodies {
        let with =
            |left: bool| all.iter().map(move |sides: &Combination| [sides.as_slice(), &[left]].concat());
        let left = with(true).filter(|_| body.sides[0]);
        all = left.chain(with(false).filter(|_| body.sides[1])).collect();
    }
    all
}

/// Leaves both sides to the bodies that are nearest to the line, and its own side to the others.
fn limit(bodies: &mut [Body], time_s: f64, line_y: f64) {
    let offset = |body: &Body| body.ellipses[0].centre_at(time_s)[1] - line_y;
    let mut order: Vec<usize> = (0..bodies.len()).filter(|&index| bodies[index].sides == [true; 2]).collect();
    order.sort_by(|&one, &other| offset(&bodies[one]).abs().total_cmp(&offset(&bodies[other]).abs()));
    for &index in order.iter().skip(MAX_BODIES) {
        let is_left = offset(&bodies[index]) < 0.0;
        bodies[index].sides = [is_left, !is_left];
    }
}

#[cfg(test)]
mod tests {
    use super::super::ellipse::Path;
    use super::*;

    fn ellipse(body: u32, x: f64, y: f64) -> Ellipse {
        Ellipse {
            body,
            a: 1.2,
            b: 0.5,
            passed_left: false,
            path: Path::Fixed([x, y]),
            known_s: 0.0,
            known_x_m: 0.0,
        }
    }

    #[test]
    fn each_body_has_two_sides_and_all_of_its_ellipses_share_them() {
        let ellipses = [ellipse(1, 4.0, 0.0), ellipse(1, 4.5, 0.0), ellipse(2, 9.0, 0.0)];
        let ellipses: Vec<&Ellipse> = ellipses.iter().collect();
        let bodies = bodies(&ellipses, 0.0, [0.0, 0.0], 0.0, Sides::Both);
        assert_eq!((bodies.len(), bodies[0].ellipses.len()), (2, 2));
        assert_eq!(combinations(&bodies).len(), 4);
    }

    #[test]
    fn beside_a_body_its_side_is_taken_already() {
        let sides = |x: f64| {
            let beside = ellipse(1, x, 0.4);
            combinations(&bodies(&[&beside], 0.0, [0.0, 0.0], 0.0, Sides::Both))
        };
        assert_eq!(sides(0.3), [[false]], "right of it");
        assert_eq!(sides(1.1), [[true], [false]], "not yet next to it");
    }

    #[test]
    fn the_sides_of_the_drive_are_one_combination() {
        let ellipses = [ellipse(1, 4.0, 0.0), Ellipse { passed_left: true, ..ellipse(2, 9.0, 0.0) }];
        let ellipses: Vec<&Ellipse> = ellipses.iter().collect();
        let taken = bodies(&ellipses, 0.0, [0.0, 0.0], 0.0, Sides::Taken);
        assert_eq!(combinations(&taken), [[false, true]]);
    }

    #[test]
    fn only_the_bodies_next_to_the_line_are_tried_on_both_sides() {
        let far = [(1.0, 8), (-0.8, 9)].map(|(y, body)| ellipse(body, 3.0 * f64::from(body), y));
        let near = (1..6).map(|body| ellipse(body, 3.0 * f64::from(body), 0.1));
        let ellipses: Vec<Ellipse> = far.into_iter().chain(near).collect();
        let ellipses: Vec<&Ellipse> = ellipses.iter().collect();
        let combinations = combinations(&bodies(&ellipses, 0.0, [0.0, 0.0], 0.0, Sides::Both));
        assert_eq!(combinations.len(), 32);
        assert!(combinations.iter().all(|sides| !sides[0] && sides[1]), "on the side of the line");
    }
}
