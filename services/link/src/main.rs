//! `scanloop-link`: the bridge between the hosts of one system, over Zenoh. `scanloop run` and `scanloop agent` start it.
//!
//! Each host has a bus of its own. The link of a host observes the topics that others need, and publishes here what they
//! send: the newest sample of a topic only, with its times mapped to the clock of this host, and never one that is too
//! old. The transport is Zenoh's; what counts is decided in [`gate`], [`newest`] and [`clock`], which know no network.

mod arguments;
mod batch;
mod bridge;
mod clock;
mod common_clock;
mod control;
mod counters;
mod credentials;
mod flows;
mod frame;
mod gate;
mod inbox;
mod link;
mod listener;
mod losses;
mod network;
mod newest;
mod offsets;
mod receiver;
mod refusals;
mod repeats;
mod sender;
mod standstill;
mod threads;
mod zeros;

use std::process::ExitCode;

fn main() -> ExitCode {
    refusals::watch();
    end_at_a_panic();
    match network::set_threads().and_then(|()| arguments::run()) {
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

/// Ends this program at a panic of any thread, to be started anew: one of Zenoh's that reads would leave a connection behind
/// from which nothing comes.
fn end_at_a_panic() {
    let print = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        print(panic);
        std::process::abort();
    }));
}
