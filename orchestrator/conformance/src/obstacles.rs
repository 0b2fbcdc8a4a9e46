//! What a list of obstacles must contain: all that is there, and nothing else.

mod failing;
pub(crate) mod scanner;

use shared_types::{Obstacle, Obstacles};

use super::case::{Tried, Verdict, observed, require};
use super::drive::Course;
use super::suite::Suite;
use super::vehicle::SuiteVehicle;

/// The box of the default robot's drive: centre, length and width [m].
const BOX_M: [f64; 4] = [5.0, 0.0, 0.1, 0.4];
/// How much of the box the ellipse may leave out on each side: three standard deviations of a range [m].
const LEFT_OUT_M: f64 = 0.03;
/// Scans of a case.
const SCANS: usize = 12;
/// An obstacle may need some scans before it is reported.
const FIRST_SIGHTINGS: usize = 4;

pub(crate) fn sees_a_box(suite: &Suite) -> Verdict {
    for obstacles in before_the_box(suite)? {
        require(obstacles.list().iter().any(|item| covers_the_box(&suite.vehicle, item)), || {
            let near = obstacles.list().iter().map(|item| {
                format!("({:.2}, {:.2}) with {:.2} m x {:.2} m", item.x_m, item.y_m, item.a_m, item.b_m)
            });
            let (scan_id, near) = (obstacles.header.scan_id, near.collect::<Vec<_>>().join("; "));
            let x_m = suite.vehicle.m(BOX_M[0]);
            format!("scan {scan_id}: no ellipse around the box at ({x_m}, 0); there are: {near}")
        })?;
    }
    Ok(format!("{} scans, the box lies within an ellipse", SCANS - FIRST_SIGHTINGS))
}

/// The answers to scans that have the box 2.5 m ahead and nearer, without those to the first scans.
fn before_the_box(suite: &Suite) -> Tried<Vec<Obstacles>> {
    let first_scan = suite.drive(Course::Corridor)?.scan_at(BOX_M[0] - 2.5);
    Ok(suite.started_on(Course::Corridor, first_scan)?.samples(SCANS)?.split_off(FIRST_SIGHTINGS))
}

/// Whether the front of the box lies within the ellipse.
fn covers_the_box(vehicle: &SuiteVehicle, item: &Obstacle) -> bool {
    let [x, y, length, width] = BOX_M.map(|usual_m| vehicle.m(usual_m));
    [-1.0, 1.0].iter().all(|side| {
        let corner = [x - length / 2.0 + LEFT_OUT_M, y + side * (width / 2.0 - LEFT_OUT_M)];
        ((corner[0] - item.x_m) / item.a_m).powi(2) + ((corner[1] - item.y_m) / item.b_m).powi(2) <= 1.0
    })
}

/// Index of the first ellipse near a place on the default robot's course.
fn position_at(vehicle: &SuiteVehicle, described: &Obstacles, [x_m, y_m]: [f64; 2]) -> Option<usize> {
    let (x_m, y_m) = (vehicle.m(x_m), vehicle.m(y_m));
    described.list().iter().position(|item| (item.x_m - x_m).hypot(item.y_m - y_m) < 0.6)
}

pub(crate) fn no_phantoms(suite: &Suite) -> Verdict {
    for Obstacles { header, count, .. } in suite.started_on(Course::Free, 1)?.samples(2 * SCANS)? {
        require(count == 0, || format!("scan {}: {count} ellipses on an empty track", header.scan_id))?;
    }
    let reports = before_the_box(suite)?.last().is_some_and(|described| described.count > 0);
    observed(reports, || "it reports no obstacle where there is one either")?;
    Ok(format!("{} scans of an empty track", 2 * SCANS))
}

pub(crate) fn nearest_first(suite: &Suite) -> Verdict {
    let first_scan = suite.drive(Course::Two)?.scan_at(1.5);
    let described: Vec<Obstacles> = suite.started_on(Course::Two, first_scan)?.samples(2 * SCANS)?;
    let mut both = 0;
    for described in &described[FIRST_SIGHTINGS..] {
        let place = |usual_m| position_at(&suite.vehicle, described, usual_m);
        let places = (place([4.5, 0.9]), place([6.0, -0.9]));
        if let (Some(near), Some(far)) = places {
            both += 1;
            let scan_id = described.header.scan_id;
            require(near < far, || format!("scan {scan_id}: the farther box is listed first"))?;
        }
    }
    observed(both > 0, || "it never reported both boxes")?;
    Ok(format!("{both} scans with both boxes"))
}

pub(crate) fn keeps_identity(suite: &Suite) -> Verdict {
    let described = before_the_box(suite)?;
    let its = described
        .iter()
        .filter_map(|described| described.list().iter().find(|item| covers_the_box(&suite.vehicle, item)));
    let mut ids: Vec<u32> = its.map(|item| item.id).collect();
    let scans = ids.len();
    observed(scans > 1, || format!("it reported the box in {scans} scans"))?;
    ids.dedup();
    require(ids.len() == 1, || format!("{} numbers in {scans} scans: {ids:?}", ids.len()))?;
    Ok(format!("number {} in {scans} scans", ids[0]))
}
