//! Commands that end by themselves: drives in lock-step, analyses, calibrations and benches, and what they refuse.

mod analyse;
mod bad_input;
mod bench_estimator;
mod bench_latency;
mod bench_ride;
mod bench_solver;
mod bench_transport;
mod calibrate;
mod campaign;
mod description;
mod drives;
mod foreign_files;
mod import;
mod moving_bodies;
mod outputs;
mod possible;
mod reference;
mod released;
mod scenarios;
mod schema;
mod system_file;
mod urg;
mod without_truth;
mod wrong_sensors;
