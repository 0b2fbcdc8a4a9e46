//! What stands around the robot: obstacles that appear, vanish and move, and walls.
//!
//! Permanent obstacles are sorted along the track and found by bisection, so ten kilometres of them cost no more
//! than ten metres. Those that move, appear or vanish are few and always checked.
//!
//! Walls are infinite straight lines at the lateral bounds.

use nalgebra::Vector2;
use vehicle::frame::heading;
use vehicle::geometry::Rectangle;

use crate::scenario::{Scenario, ScenarioObstacle};

pub use crate::solid::Solid;

/// The clearance where nothing stands anywhere [m].
pub const NOTHING_M: f64 = 1e9;

/// Clearances up to this are found from nearby obstacles only [m].
const NEARBY_M: f64 = 10.0;

/// An obstacle at its place on the track.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedObstacle {
    obstacle: ScenarioObstacle,
    reach: f64,
    /// Body at the place where it appears.
    solid: Solid,
    /// When it appears [s]; `None` while it waits for the robot to come near.
    appears_s: Option<f64>,
}

/// All that stands around the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Sorted by x.
    permanent: Vec<PlacedObstacle>,
    largest_reach: f64,
    /// Moving, appearing or disappearing ones.
    temporary: Vec<PlacedObstacle>,
    /// Surfaces of the walls, low y first.
    walls: Option<[f64; 2]>,
}

impl Scene {
    /// The scene of a scenario at the start of the run.
    pub fn new(scenario: &Scenario) -> Self {
        let (mut permanent, temporary): (Vec<_>, Vec<_>) = scenario
            .placed_obstacles()
            .into_iter()
            .map(PlacedObstacle::new)
            .partition(PlacedObstacle::is_permanent);
        permanent.sort_by(|one, other| one.obstacle.x_m.total_cmp(&other.obstacle.x_m));
        let largest_reach = permanent.iter().map(|entry| entry.reach).fold(0.0, f64::max);
        let walls = scenario.track.walls.then_some(scenario.track.y_m);
        Self { permanent, largest_reach, temporary, walls }
    }

    /// Lets obstacles appear that wait for the front of the body to come near.
    pub fn trigger(&mut self, body: &Rectangle, time_s: f64) {
        for entry in &mut self.temporary {
            let (None, Some(ahead)) = (entry.appears_s, entry.obstacle.appears_ahead_m) else { continue };
            let forward = heading(body.yaw);
            let front = body.centre.dot(&forward) + body.length / 2.0;
            if entry.solid.nearest_along(forward) - front <= ahead {
                entry.appears_s = Some(time_s);
            }
        }
    }

    /// When obstacles that wait for the robot have appeared [s], `None` for those that still wait; always in the
    /// same order.
    pub(crate) fn appearances(&self) -> impl Iterator<Item = Option<f64>> {
        self.temporary.iter().filter(|entry| entry.waits()).map(|entry| entry.appears_s)
    }

    /// Sets what [`Self::appearances`] returns.
    pub(crate) fn set_appearances(&mut self, appearances: impl Iterator<Item = Option<f64>>) {
        let waiting = self.temporary.iter_mut().filter(|entry| entry.waits());
        waiting.zip(appearances).for_each(|(entry, appears_s)| entry.appears_s = appears_s);
    }

    /// Surfaces of the walls, low y first [m].
    pub fn walls(&self) -> Option<[f64; 2]> {
        self.walls
    }

    /// Obstacles whose body may be within `radius` of `place`, and all that move, appear or vanish.
    pub fn near(&self, place: Vector2<f64>, radius: f64) -> impl Iterator<Item = &PlacedObstacle> {
        let range = radius + self.largest_reach;
        let first = self.permanent.partition_point(|entry| entry.obstacle.x_m < place.x - range);
        let end = self.permanent.partition_point(|entry| entry.obstacle.x_m <= place.x + range);
        self.permanent[first..end.max(first)].iter().chain(&self.temporary)
    }

    /// Distance of the body to the nearest obstacle or wall, negative when they overlap [m].
    ///
    /// [`NOTHING_M`] when there is nothing.
    pub fn clearance(&self, body: &Rectangle, time_s: f64) -> f64 {
        let nearby = self.clearance_below(body, time_s, NEARBY_M);
        if nearby < NEARBY_M { nearby } else { self.clearance_below(body, time_s, NOTHING_M) }
    }

    /// The clearance where it is below `limit`, else `limit` [m]; the cheaper the smaller the limit.
    pub fn clearance_below(&self, body: &Rectangle, time_s: f64, limit: f64) -> f64 {
        let reach = body.length.hypot(body.width) / 2.0;
        let mut clearance = limit;
        if let Some([low, high]) = self.walls {
            let middle = (low + high) / 2.0;
            clearance =
                clearance.min(body.distance_to_wall(low, middle)).min(body.distance_to_wall(high, middle));
        }
        for near in self.near(body.centre, reach + limit.max(0.0)) {
            let gap = (near.centre(time_s) - body.centre).norm() - near.reach() - reach;
            // A body that can't be nearer than the nearest so far needs no exact distance; one that may overlap does.
            if gap < clearance
                && let Some(solid) = near.solid(time_s)
            {
                clearance = clearance.min(solid.distance_to(body));
            }
        }
        clearance
    }
}

impl PlacedObstacle {
    fn new(obstacle: ScenarioObstacle) -> Self {
        Self {
            obstacle,
            reach: obstacle.reach(),
            solid: obstacle.solid_at(Vector2::new(obstacle.x_m, obstacle.y_m)),
            appears_s: obstacle.appears_ahead_m.is_none().then_some(obstacle.appears_s),
        }
    }

    /// Radius of the circle about the centre that holds all of it [m].
    pub fn reach(&self) -> f64 {
        self.reach
    }

    /// Its description in the scenario.
    pub fn obstacle(&self) -> &ScenarioObstacle {
        &self.obstacle
    }

    /// Speed of the obstacle [m/s].
    pub fn speed(&self) -> f64 {
        self.obstacle.velocity_x_mps.hypot(self.obstacle.velocity_y_mps)
    }

    /// Whether its surface is black.
    pub fn is_black(&self) -> bool {
        self.obstacle.black
    }

    /// Whether it stands at one place for the whole run.
    pub fn is_permanent(&self) -> bool {
        self.obstacle.is_permanent()
    }

    /// Centre at a time, whether it is there or not [m].
    pub fn centre(&self, time_s: f64) -> Vector2<f64> {
        Vector2::new(self.obstacle.x_m, self.obstacle.y_m) + self.offset(time_s)
    }

    /// Its body at a time, `None` while it is not there.
    pub fn solid(&self, time_s: f64) -> Option<Solid> {
        let is_there = self.appears_s.is_some_and(|appears| time_s >= appears)
            && self.obstacle.disappears_s.is_none_or(|disappears| time_s < disappears);
        is_there.then(|| self.solid.moved_by(self.offset(time_s)))
    }

    /// Whether it appears when the robot comes near.
    fn waits(&self) -> bool {
        self.obstacle.appears_ahead_m.is_some()
    }

    fn offset(&self, time_s: f64) -> Vector2<f64> {
        let since = self.appears_s.map_or(0.0, |appears| (time_s - appears).max(0.0));
        Vector2::new(self.obstacle.velocity_x_mps, self.obstacle.velocity_y_mps) * since
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(obstacles: &str) -> Scene {
        Scene::new(&Scenario::parse(obstacles, "test").unwrap())
    }

    fn body(x: f64) -> Rectangle {
        Scenario::default().body(x, 0.0, 0.0)
    }

    #[test]
    fn clearance_is_from_the_front_of_the_body_to_the_face_of_the_box() {
        let scene = scene(Scenario::shipped("corridor").unwrap());
        // Front at 0.28, face at 4.95.
        assert!((scene.clearance(&body(0.0), 0.0) - 4.67).abs() < 1e-12);
        assert!((scene.clearance(&body(4.7), 0.0) + 0.03).abs() < 1e-12, "overlap is negative");
        assert_eq!(scene.clearance_below(&body(0.0), 0.0, 1.0), 1.0);
    }

    #[test]
    fn without_anything_around_the_clearance_is_a_billion() {
        assert_eq!(scene("").clearance(&body(0.0), 0.0), NOTHING_M);
    }

    #[test]
    fn an_obstacle_is_there_from_its_appearance_to_its_disappearance() {
        let scene = scene(
            "[[obstacle]]\nshape = \"circle\"\nx_m = 2.28\ny_m = 0\nradius_m = 0.5\nappears_s = 1\ndisappears_s = 2",
        );
        assert_eq!(scene.clearance(&body(0.0), 0.999), NOTHING_M);
        assert!((scene.clearance(&body(0.0), 1.0) - 1.5).abs() < 1e-12);
        assert_eq!(scene.clearance(&body(0.0), 2.0), NOTHING_M);
    }

    #[test]
    fn a_moving_obstacle_starts_when_it_appears() {
        let scene = scene(
            "[[obstacle]]\nshape = \"circle\"\nx_m = 3.28\ny_m = 0\nradius_m = 0.5\nappears_s = 1\nvelocity_x_mps = -0.5",
        );
        assert!((scene.clearance(&body(0.0), 2.0) - 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_sudden_obstacle_comes_when_the_front_is_near_and_stays() {
        let mut scene = scene(Scenario::shipped("sudden").unwrap());
        // Face at 4.95, front 0.28 ahead of the centre: 1.2 m ahead at a centre of 3.47.
        scene.trigger(&body(3.46), 4.0);
        assert_eq!(scene.clearance(&body(3.46), 4.0), NOTHING_M);
        scene.trigger(&body(3.48), 5.0);
        assert!((scene.clearance(&body(3.48), 5.0) - 1.19).abs() < 1e-12);
        scene.trigger(&body(0.0), 6.0);
        assert!((scene.clearance(&body(3.48), 6.0) - 1.19).abs() < 1e-12);
    }

    #[test]
    fn walls_count_as_obstacles() {
        let scene = scene("[track]\ny_m = [-1.9, 1.9]\nwalls = true");
        assert!((scene.clearance(&body(0.0), 0.0) - 1.7).abs() < 1e-12);
    }

    #[test]
    fn of_ten_kilometres_of_obstacles_only_the_nearby_ones_are_checked() {
        let scene = scene(Scenario::shipped("endless").unwrap());
        assert!(scene.permanent.len() > 1800);
        assert!(scene.near(Vector2::new(5000.0, 0.0), 6.0).count() <= 4);
        let all = scene.permanent.iter().map(|entry| entry.solid.distance_to(&body(5000.0)));
        let nearest = all.fold(NOTHING_M, f64::min);
        assert_eq!(scene.clearance(&body(5000.0), 0.0), nearest);
    }
}
