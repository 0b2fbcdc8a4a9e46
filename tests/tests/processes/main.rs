//! Systems of real processes that drive, are disturbed, swapped, stopped and orphaned.
//!
//! One program, so that it is linked once and the tests of all files wait for their robots at the same time. Tests
//! that load the machine on purpose are in `load.rs`.

mod adoption;
mod blame;
mod companions;
mod control_socket;
mod demo;
mod doctor;
mod exhausted;
mod faults;
mod hang;
mod hosts;
mod imu;
mod inject;
mod ladder;
mod languages;
mod ledger;
mod live;
mod live_check;
mod namespaces;
mod operator;
mod other_user;
mod output;
mod pages;
mod pauses;
mod person;
mod player;
mod possible_poses;
mod private_place;
mod prompt;
mod recording;
mod restart;
mod run_limits;
mod service_manager;
mod set;
mod shadow;
mod shared_memory;
mod soak;
mod stop;
mod strays;
mod streams;
mod swap;
mod swap_robot;
mod top;
mod view;
mod view_hostile;
mod watch;
mod without_truth;
