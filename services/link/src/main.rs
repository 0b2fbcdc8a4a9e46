//! `scanloop-link`: the bridge between the hosts of one system, over Zenoh. `scanloop run` and `scanloop agent` start it.
//!
//! Each host has a bus of its own. The link of a host observes the topics that others need, and publishes here what they
//! send: the newest sample of a topic only, with its times mapped to the clock of this host, and never one that is too
//! old. The transport is Zenoh's; what counts is decided in [`gate`], [`newest`] and [`clock`], which know no network.

mod arguments;
mod bridge;
mod clock;
mod common_clock;
mod control;
mod counters;
mod credentials;
mod frame;
mod gate;
mod link;
mod network;
mod newest;
mod ping;
mod receiver;
mod repeats;
mod sender;
mod zeros;

use std::process::ExitCode;

fn main() -> ExitCode {
    match arguments::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // What a user has to change in files or arguments has exit code 2, as everywhere.
            let is_input =
                std::env::args().nth(1).is_some_and(|what| ["check", "pair"].contains(&what.as_str()));
            runtime::print(runtime::Priority::Error, &format!("error: {error:#}"));
            ExitCode::from(if is_input { 2 } else { 4 })
        }
    }
}
