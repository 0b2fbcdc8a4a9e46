//! One node of `scanloop bench transport` in a dataflow of dora, started by `dora run`.
//!
//! As dora's documentation recommends for low latency: Rust nodes, outputs written in place (`send_output_raw`), its
//! default data plane (Zenoh from node to node on this machine, shared memory from 4 KB on), no tracing, no metrics.

use std::error::Error;
use std::time::Duration;

use dora_node_api::{DoraNode, Event, EventStream, MetadataParameters, dora_core::config::DataId};
use hops::{Arrival, ChainStage, HopError, Setup, Stamp, run};

/// Longest sleep.
const MAX_WAIT: Duration = Duration::from_millis(230);

fn main() -> Result<(), Box<dyn Error>> {
    let setup = Setup::from_environment()?;
    let (node, events) = DoraNode::init_from_env()?;
    let output = DataId::from("message".to_owned());
    Ok(run(&mut Hop { node, events, output, bytes: setup.outlet_bytes(), noticed: None }, &setup)?)
}

/// The ports of one process.
struct Hop {
    node: DoraNode,
    events: EventStream,
    output: DataId,
    bytes: usize,
    noticed: Option<Arrival>,
}

impl Hop {
    fn notice(&mut self, event: Option<Event>) {
        self.noticed = match event {
            Some(Event::Input { data, .. }) => {
                <&[u8]>::try_from(&data).ok().and_then(Stamp::read).map(Arrival::now)
            }
            _ => None,
        };
    }
}

impl ChainStage for Hop {
    fn send(&mut self, stamp: Stamp) -> Result<(), HopError> {
        if self.bytes == 0 {
            return Ok(());
        }
        self.node
            .send_output_raw(self.output.clone(), MetadataParameters::default(), self.bytes, |message| {
                stamp.write(message)
            })
            .map_err(|error| HopError::transport("send an output", error))
    }

    fn take(&mut self) -> Option<Arrival> {
        self.noticed.take()
    }

    fn poll(&mut self) -> bool {
        let event = self.events.try_recv().ok();
        self.notice(event);
        self.noticed.is_some()
    }

    fn block(&mut self, _longest_ns: Option<u64>) {
        let event = self.events.recv_timeout(MAX_WAIT);
        self.notice(event);
    }
}
