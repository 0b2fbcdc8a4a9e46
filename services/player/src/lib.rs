//! Driver for robots behind a Player 3 server, implementation `player` of role `robot`.
//!
//! The protocol is a codec without input and output: [`stream`] cuts bytes into messages, [`message`] and [`command`]
//! read and write them, [`handshake`] opens the devices. [`client`] is the connection, [`guard`] its sending end,
//! [`service`] makes a robot of both; what it reports becomes scan and odometry in the crate `driver`.

pub mod client;
pub mod command;
pub mod config;
pub mod guard;
pub mod handshake;
pub mod header;
pub mod message;
pub mod service;
pub mod stream;
pub mod xdr;

pub use config::PlayerConfig;
