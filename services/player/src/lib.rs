//! Driver for robots behind a Player 3 server, implementation `player` of role `robot`.
//!
//! The protocol is a codec without input and output: [`stream`] cuts bytes into messages, [`message`] and [`command`]
//! read and write them, [`handshake`] opens the devices. [`beams`], [`motion`] and [`join`] turn what the server reports
//! into scan and odometry, [`devices`] into a state for `scanloop status`. [`client`] is the connection, [`guard`] the process that stops the wheels when the driver is
//! silent, [`service`] the process of the driver.

pub mod beams;
pub mod client;
pub mod clock;
pub mod command;
pub mod config;
pub mod devices;
pub mod guard;
pub mod handshake;
pub mod header;
pub mod join;
pub mod message;
pub mod motion;
pub mod order;
pub mod sensing;
pub mod service;
pub mod stream;
pub mod xdr;

pub use config::PlayerConfig;
