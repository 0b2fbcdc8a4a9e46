use super::*;
use estimator::correction::{CorrectionMode, CorrectionState, Drift, Planar};

/// A run along a sine whose odometry errs exactly so that the estimator's own correction undoes it.
fn run(number: u32, df: f64, dds: f64, seconds: usize) -> Vec<SineRow> {
    let drift = Drift { mode: CorrectionMode::Moving, longitudinal: df, lateral_rate: dds, reset_s: 0.0 };
    let speed = 0.8;
    let reported = |step: usize| {
        let time_s = 0.1 * step as f64;
        Planar { yaw: 0.3 * (1.2 * time_s).sin(), x: 0.79 * time_s, y: 0.1 * (1.2 * time_s).cos() }
    };
    let mut state = CorrectionState::begin(reported(0), speed);
    (0..=10 * seconds)
        .map(|step| {
            let at = reported(step);
            let truth = if step == 0 { at } else { state.correct(&drift, at, speed, 0.1, None) };
            let marked = step % 20 == 0;
            SineRow {
                run: number,
                time_s: 0.1 * step as f64,
                sent_steering_rad: None,
                reported_x_m: at.x,
                reported_y_m: at.y,
                reported_yaw_rad: at.yaw,
                speed_mps: speed,
                measured_x_m: marked.then_some(truth.x),
                measured_y_m: marked.then_some(truth.y),
                place: format!("runs.csv: line {}", step + 2),
            }
        })
        .collect()
}

fn reason(rows: &[SineRow]) -> String {
    fit(rows, &Description::default()).unwrap_err().to_string()
}

#[test]
fn the_coefficients_are_those_that_the_estimators_correction_undoes() {
    let fit = fit(&run(1, 0.012, 0.05, 20), &Description::default()).unwrap();
    assert!((fit.longitudinal.value - 0.012).abs() < 1e-9, "{:?}", fit.longitudinal);
    assert!((fit.lateral_rate.value - 0.05).abs() < 1e-9, "{:?}", fit.lateral_rate);
    assert_eq!((fit.runs, fit.marks, fit.play), (1, 11, None));
}

#[test]
fn a_frame_that_is_shifted_and_turned_changes_nothing() {
    let mut rows = run(1, 0.012, 0.0003, 40);
    for row in &mut rows {
        let (sin, cos) = 0.003_f64.sin_cos();
        if let (Some(x), Some(y)) = (row.measured_x_m, row.measured_y_m) {
            row.measured_x_m = Some(0.02 + cos * x - sin * y);
            row.measured_y_m = Some(-0.01 + sin * x + cos * y);
        }
    }
    let fit = fit(&rows, &Description::default()).unwrap();
    // The turn is fitted to first order: the rest, 0.003^2 / 2 of the distance, adds to df.
    assert!((fit.longitudinal.value - 0.012).abs() < 1e-5, "{:?}", fit.longitudinal);
    assert!((fit.lateral_rate.value - 0.0003).abs() < 2e-6, "{:?}", fit.lateral_rate);
}

#[test]
fn short_runs_and_few_marks_are_refused() {
    assert!(
        reason(&run(1, 0.01, 0.0, 3)).contains("too few") || reason(&run(1, 0.01, 0.0, 3)).contains("long")
    );
    let mut rows = run(1, 0.01, 0.0, 20);
    rows.iter_mut().skip(50).for_each(|row| (row.measured_x_m, row.measured_y_m) = (None, None));
    assert_eq!(reason(&rows), "3 measured positions of a run are too few: at least 5 are needed");
    assert_eq!(reason(&[]), "0 sine runs are too few: at least 1 are needed");
    let many: Vec<SineRow> = (1..=MAX_RUNS as u32 + 1).flat_map(|number| run(number, 0.01, 0.0, 4)).collect();
    assert_eq!(reason(&many), "the fit is refused: 201 runs are more than 200: fit them in parts");
}

#[test]
fn rows_out_of_order_standstill_and_half_a_position_are_refused_with_their_line() {
    let mut rows = run(1, 0.01, 0.0, 20);
    rows[7].time_s = 0.5;
    assert!(reason(&rows).starts_with("runs.csv: line 9: time_s = 0.5 is not allowed"), "{}", reason(&rows));
    let mut rows = run(1, 0.01, 0.0, 20);
    rows[7].speed_mps = 0.0;
    assert!(reason(&rows).starts_with("runs.csv: line 9: speed_mps = 0 is not allowed"));
    let mut rows = run(1, 0.01, 0.0, 20);
    rows[20].measured_y_m = None;
    assert!(reason(&rows).contains("line 22: measured_x_m and measured_y_m have to be given both"));
    let rows = [run(1, 0.01, 0.0, 20), run(2, 0.01, 0.0, 20), run(1, 0.01, 0.0, 20)].concat();
    assert!(reason(&rows).contains("run 1 continues after another run"));
}

#[test]
fn an_odometry_that_errs_otherwise_is_refused() {
    let mut rows = run(1, 0.01, 0.0, 20);
    for row in &mut rows {
        row.measured_y_m = row.measured_y_m.map(|y| y + 0.5 * (0.5 * row.time_s).sin());
    }
    assert!(reason(&rows).contains("does not err as"), "{}", reason(&rows));
    let mut rows = run(1, 0.01, 0.0, 20);
    rows[100].measured_x_m = rows[100].measured_x_m.map(|x| x + 1.0);
    assert!(reason(&rows).contains("runs.csv: line 102: the measured position"), "{}", reason(&rows));
    assert!(reason(&run(1, 0.7, 0.0, 20)).contains("df = 0.7000 is outside"));
}
