//! What drivers of foreign robots share, whatever they speak: `player`, and the program `scanloop-ros2`.
//!
//! [`beams`], [`motion`], [`odometry`] and [`join`] turn what a robot reports into scan and odometry, [`sensing`] joins both,
//! [`scanner`] reads a Hokuyo scanner at this computer, [`devices`] makes a state for `scanloop status`. [`guard`] stops the wheels when the driver is silent, [`service`] is
//! the process of a driver. [`ros2`] has the settings of the program that is built apart.

pub mod beams;
pub mod clock;
pub mod devices;
pub mod event;
pub mod feed;
pub mod guard;
pub mod join;
pub mod motion;
pub mod odometry;
pub mod order;
pub mod ros2;
pub mod scanner;
pub mod sensing;
pub mod service;
