//! Time per scan of each stage and of the whole loop as plain calls, on laps recorded beforehand.

use std::hint::black_box;
use std::time::Duration;

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, SamplingMode};
use emulator::Emulator;
use estimator::Estimator;
use laboratory::Lap;
use nmpc::{Budget, Controller};
use obstacles::ObstacleDetector;
use pipeline::{Pipeline, Step};
use shared_types::{CommandKind, Odometry, Scan, Truth};

type Group<'a> = BenchmarkGroup<'a, WallTime>;

fn main() {
    let mut criterion = Criterion::default()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
        .configure_from_args();
    let (corridor, free) = (Lap::record("corridor"), Lap::record("free"));
    let mut group = criterion.benchmark_group("per_scan");
    // Laps differ by noise of the machine only, so no slope over growing numbers of laps is needed.
    group.sampling_mode(SamplingMode::Flat);
    emulator_scan(&mut group, &corridor);
    estimator_step(&mut group, &corridor);
    obstacles_step(&mut group, &corridor);
    controller_step(&mut group, "controller, nothing in the way", &free, |_| true);
    controller_step(&mut group, "controller, obstacle ahead", &corridor, obstacle_ahead);
    pipeline_step(&mut group, &corridor);
    group.finish();
    criterion.final_summary();
}

/// Advance the plant by a period and take scan, odometry and truth.
fn emulator_scan(group: &mut Group<'_>, lap: &Lap) {
    let settings = &lap.settings;
    let fresh = || Emulator::new(&settings.scenario, settings.period_ns);
    let (mut scan, mut odometry, mut truth) = (Scan::default(), Odometry::default(), Truth::default());
    group.bench_function("emulator", |bencher| {
        bencher.iter_custom(|iterations| {
            lap.time(iterations, fresh, every, |emulator, step| {
                let scan_id = step.scan.header.scan_id;
                emulator.advance_to(emulator.scan_ready_ns(scan_id));
                emulator.measure(scan_id, &mut scan, &mut odometry, &mut truth);
                if let Some(actuation) = &step.actuation {
                    emulator.actuate(black_box(actuation));
                }
            })
        });
    });
}

/// Correct an odometry sample, filter it, predict the state, and note what was sent.
fn estimator_step(group: &mut Group<'_>, lap: &Lap) {
    let config = lap.tuning().estimator;
    let fresh = || Estimator::new(&config).expect("default settings are valid");
    group.bench_function("estimator", |bencher| {
        bencher.iter_custom(|iterations| {
            lap.time(iterations, fresh, every, |estimator, step| {
                let now_ns = step.scan.header.scan_published_ns();
                black_box(estimator.step(black_box(&step.odometry), None, now_ns));
                if let Some(actuation) = &step.actuation {
                    estimator.note(actuation, now_ns);
                }
            })
        });
    });
}

/// Turn the ranges of a scan into ellipses.
fn obstacles_step(group: &mut Group<'_>, lap: &Lap) {
    let config = lap.tuning().obstacles;
    let fresh = || ObstacleDetector::new(config.clone()).expect("default settings are valid");
    group.bench_function("obstacles", |bencher| {
        bencher.iter_custom(|iterations| {
            lap.time(iterations, fresh, every, |detector, step| {
                if let Some(pose) = &step.pose {
                    black_box(detector.step(black_box(&step.scan), pose));
                }
            })
        });
    });
}

/// Search a reference path, solve the program to convergence, verify the plan.
fn controller_step(group: &mut Group<'_>, name: &str, lap: &Lap, counts: impl Fn(&Step) -> bool + Copy) {
    let config = lap.tuning().controller;
    let budget = Budget::Iterations(config.budget_iterations);
    let fresh = || Controller::new(config.clone()).expect("default settings are valid");
    group.bench_function(name, |bencher| {
        bencher.iter_custom(|iterations| {
            lap.time(iterations, fresh, counts, |controller, step| {
                if let (Some(pose), Some(obstacles)) = (&step.pose, &step.obstacles) {
                    black_box(controller.step(black_box(pose), obstacles, &budget));
                }
            })
        });
    });
}

/// The whole loop once without a bus: the cost of a scan in one process.
fn pipeline_step(group: &mut Group<'_>, lap: &Lap) {
    let fresh = || Pipeline::new(&lap.settings).expect("default settings are valid");
    group.bench_function("pipeline", |bencher| {
        bencher.iter_custom(|iterations| {
            lap.time(iterations, fresh, every, |pipeline, _| {
                black_box(pipeline.step());
            })
        });
    });
}

fn every(_: &Step) -> bool {
    true
}

/// Driving with an ellipse in sight whose end is still before the robot.
fn obstacle_ahead(step: &Step) -> bool {
    let drives = step.command.is_some_and(|command| command.kind == CommandKind::Drive.wire());
    let (Some(pose), Some(obstacles)) = (&step.pose, &step.obstacles) else { return false };
    drives && obstacles.list().iter().any(|obstacle| obstacle.x_m + obstacle.a_m > pose.x_m)
}
