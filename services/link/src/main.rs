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
mod frame;
mod gate;
mod network;
mod newest;
mod receiver;
mod repeats;
mod sender;

use std::process::ExitCode;

fn main() -> ExitCode {
    runtime::start_logging();
    match arguments::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            runtime::print(runtime::Priority::Error, &format!("error: scanloop-link: {error:#}"));
            ExitCode::from(4)
        }
    }
}
