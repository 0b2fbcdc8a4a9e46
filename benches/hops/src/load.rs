//! A loaded machine: one process per processor that computes without end.

use std::process::{Child, Command, Stdio};

use crate::setup::{HOPS, SETUP_VARIABLE};
use crate::spawn::{Scheduling, prepare, processors};
use crate::{HopError, Plan, Policy, SMALLEST, Setup};

/// The contender's name of a process that only computes.
pub(crate) const SPIN: &str = "spin";

/// Busy processes with default scheduling, one per processor; ended when dropped.
#[derive(Debug)]
pub struct Load(Vec<Child>);

impl Load {
    /// Starts them; `plan` tells the program.
    ///
    /// # Errors
    /// [`HopError::System`] when a process can't be started.
    pub fn start(plan: &Plan) -> Result<Self, HopError> {
        let setup = Setup {
            contender: SPIN.to_owned(),
            index: 0,
            control: std::path::PathBuf::new(),
            payload_bytes: [SMALLEST; HOPS],
            period_ns: 0,
            warm_up: 0,
            samples: 0,
            policy: Policy::Block,
            addresses: Vec::new(),
        };
        let mut load = Self(Vec::new());
        for _ in processors() {
            let mut command = Command::new(&plan.program);
            command.args(&plan.arguments).env(SETUP_VARIABLE, setup.to_json()?).stdin(Stdio::null());
            prepare(&mut command, Scheduling::Other, &[], &[]);
            load.0.push(command.spawn().map_err(HopError::system("start a busy process"))?);
        }
        Ok(load)
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Computes until killed.
pub(crate) fn spin() -> ! {
    let mut number = 1_u64;
    loop {
        number = std::hint::black_box(number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1));
    }
}
