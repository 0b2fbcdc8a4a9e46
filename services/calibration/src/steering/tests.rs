use super::*;
use crate::record::{read, write};
use emulator::noise::{NoiseStream, Purpose};
use emulator::steering_map::nonlinear;

/// Arc of a given length driven with a steering angle of the wheels.
fn arc(sent: f64, wheels: f64, side: Option<ApproachSide>, noise: &mut dyn FnMut() -> f64) -> CircleRun {
    let length = 4.0;
    let curvature = 2.0 * wheels.tan() / 0.37;
    let (chord, height) = if curvature.abs() < 1e-9 {
        (length, 0.0)
    } else {
        let half = length * curvature / 2.0;
        (2.0 * half.sin() / curvature, (1.0 - half.cos()) / curvature)
    };
    CircleRun {
        sent_steering_rad: sent,
        approached_from: side,
        chord_m: chord + noise(),
        height_m: height + noise(),
        place: "runs.csv: line 2".to_owned(),
    }
}

fn runs(map: &dyn Fn(f64) -> f64, play: f64, seed: Option<u64>) -> Vec<CircleRun> {
    let mut stream = NoiseStream::new(seed.unwrap_or(0), Purpose::Course, 77);
    let mut noise = || if seed.is_some() { 0.003 * stream.normal() } else { 0.0 };
    let mut runs = Vec::new();
    for step in -20..=20 {
        let sent = 0.09 * f64::from(step) / 20.0;
        runs.push(arc(sent, map(sent) - play, Some(ApproachSide::Below), &mut noise));
        runs.push(arc(sent, map(sent) + play, Some(ApproachSide::Above), &mut noise));
    }
    runs
}

fn reason(runs: &[CircleRun]) -> String {
    fit(runs, &Description::default()).unwrap_err().to_string()
}

/// Radius of the arc with a chord and a height, R = s^2 / (8 h) + h / 2 [m].
fn radius(chord_m: f64, height_m: f64) -> f64 {
    chord_m * chord_m / (8.0 * height_m) + height_m / 2.0
}

#[test]
fn chord_and_height_of_a_quarter_circle_give_its_radius() {
    // R = 2: chord 2 sqrt(2), height 2 - sqrt(2).
    let (chord, height) = (2.0 * 2.0_f64.sqrt(), 2.0 - 2.0_f64.sqrt());
    assert!((radius(chord, height) - 2.0).abs() < 1e-12);
    // tan(u2) = 0.37 / (2 R).
    assert!((realised_angle(&Parameters::default(), chord, height) - (0.37_f64 / 4.0).atan()).abs() < 1e-12);
    assert!((realised_angle(&Parameters::default(), chord, -height) + (0.37_f64 / 4.0).atan()).abs() < 1e-12);
    assert_eq!(realised_angle(&Parameters::default(), 3.0, 0.0), 0.0);
}

#[test]
fn exact_arcs_give_the_map_the_play_and_an_inverse() {
    let fit = fit(&runs(&nonlinear, 0.006, None), &Description::default()).unwrap();
    assert!((fit.play.unwrap().value - 0.006).abs() < 1e-9);
    assert!(fit.held_out_rad < 2e-5, "{}", fit.held_out_rad);
    for step in -60..=60 {
        let desired = f64::from(step) * 1e-3;
        // Half of the error is the network's, half that of its inverse; both are a few 1e-6.
        assert!((nonlinear(fit.inverse.eval(desired)) - desired).abs() < 3e-5, "{desired}");
    }
}

#[test]
fn the_fit_is_deterministic_and_survives_its_table() {
    let runs = runs(&nonlinear, 0.004, Some(3));
    let once = fit(&runs, &Description::default()).unwrap();
    assert_eq!(
        once,
        fit(&read::<CircleRun>(&write(&runs), "a.csv").unwrap(), &Description::default()).unwrap()
    );
}

/// Maps within 30 % of the identity that no network has seen.
fn unseen(trial: u64) -> impl Fn(f64) -> f64 {
    let mut stream = NoiseStream::new(trial, Purpose::Course, 5);
    let (gain, tilt, bend) =
        (stream.between(0.9, 1.2), stream.between(-0.1, 0.1), stream.between(-0.3, 0.15));
    move |sent: f64| {
        let share = sent / 0.12;
        sent * (gain + tilt * share + bend * share * share)
    }
}

#[test]
fn unseen_maps_are_found_within_2_mrad_and_their_errors_cover_the_truth() {
    let (mut covered, mut asked, mut play_covered, mut worst) = (0, 0, 0, 0.0_f64);
    for trial in 0..50 {
        let (map, play) = (unseen(trial), 0.006 * (0.7 + 0.012 * trial as f64));
        let fit = fit(&runs(&map, play, Some(trial)), &Description::default())
            .unwrap_or_else(|refusal| panic!("{trial}: {refusal}"));
        for point in &fit.points {
            let truth = map(point.sent_rad);
            worst = worst.max((truth - point.desired_rad).abs());
            asked += 1;
            covered += u32::from(point.realised_rad.covers(truth));
        }
        play_covered += u32::from(fit.play.unwrap().covers(play));
    }
    let share = f64::from(covered) / f64::from(asked);
    eprintln!("steering: worst {worst:.5} rad, covered {share:.3} of angles, {play_covered} of 50 plays");
    assert!(worst < 0.002, "{worst}");
    assert!(share >= 0.9 && play_covered >= 45, "{share} {play_covered}");
}

#[test]
fn too_few_runs_and_gaps_are_refused() {
    let all = runs(&nonlinear, 0.0, None);
    assert_eq!(reason(&all[..20]), "20 circle runs are too few: at least 30 are needed");
    let gap: Vec<CircleRun> =
        all.iter().filter(|run| !(0.02..0.05).contains(&run.sent_steering_rad)).cloned().collect();
    assert!(reason(&gap).contains("no run between sent angles of 0.0180 and 0.0540 rad"), "{}", reason(&gap));
}

#[test]
fn runs_that_do_not_realise_the_desired_angles_are_refused() {
    let text = reason(&runs(&|sent| 0.6 * sent, 0.0, None));
    assert!(text.contains("have to be covered"), "{text}");
}

#[test]
fn values_outside_their_range_and_a_forgotten_sign_are_refused_with_their_line() {
    let mut runs = runs(&nonlinear, 0.0, None);
    runs[3].height_m = 2.0;
    assert!(reason(&runs).starts_with("runs.csv: line 2: height_m = 2 is not allowed: -1."));
    runs[3].height_m = runs[3].height_m.min(0.2);
    assert!(reason(&runs).contains("the sign of the angle sent"), "{}", reason(&runs));
}

#[test]
fn a_run_off_the_curve_a_falling_map_and_forgotten_sides_are_refused() {
    let mut one = runs(&nonlinear, 0.0, Some(1));
    one[50].height_m += 0.2;
    assert!(reason(&one).contains("off the map through all others"), "{}", reason(&one));
    let falling = |sent: f64| if sent > 0.05 { 0.09 - 0.7 * sent } else { 1.1 * sent };
    assert!(
        reason(&runs(&falling, 0.0, None)).contains("the map rises from"),
        "{}",
        reason(&runs(&falling, 0.0, None))
    );
    let mut sideless = runs(&nonlinear, 0.008, Some(2));
    sideless.iter_mut().for_each(|run| run.approached_from = None);
    assert!(reason(&sideless).contains("approached_from"), "{}", reason(&sideless));
}
