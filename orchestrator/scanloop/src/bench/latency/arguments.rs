//! Arguments of `scanloop bench latency`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use console::exit::Failure;
use plan::Choice;

use crate::bench::scheduling::SchedulingArguments;

/// Largest payload [bytes].
const LARGEST_PAYLOAD: usize = 16 << 20;

/// What the five processes compute.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Compute {
    /// The pipeline that drives the scenario `endless`.
    #[default]
    Real,
    /// Nothing: stages answer at once, so that only transport remains.
    None,
}

impl Compute {
    /// Its name in reports.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Real => "real",
            Self::None => "none",
        }
    }
}

/// Arguments of `bench latency`.
#[derive(Debug, Clone, Args)]
pub struct LatencyArguments {
    /// Scans per second, 0.5 to 1000.
    #[arg(long, value_name = "HZ", default_value_t = 10.0)]
    pub rate: f64,
    /// Driven time [s], 0.1 to 36000.
    #[arg(long, value_name = "S", default_value_t = 30.0)]
    pub duration: f64,
    /// What the stages compute.
    #[arg(long, value_name = "WHAT", value_enum, default_value = "real")]
    pub compute: Compute,
    /// Bytes per message on each of the four hops, 1 to 16777216, or for example 4k or 1M; only with `--compute none`.
    /// Without it messages are as large as the samples of the pipeline.
    #[arg(long, value_name = "BYTES", value_parser = size)]
    pub payload: Option<usize>,
    /// Policy and processors of the processes.
    #[command(flatten)]
    pub scheduling: SchedulingArguments,
    /// Keep all processors busy during the measurement.
    #[arg(long)]
    pub load: bool,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
    /// Folder for histograms, pictures, a trace and `report.json`.
    #[arg(long, value_name = "DIR", value_parser = console::output::folder())]
    pub out: Option<PathBuf>,
    /// Replace files in the folder that this program did not write.
    #[arg(long)]
    pub force: bool,
    /// Print no progress.
    #[arg(long)]
    pub quiet: bool,
    /// The choice of system and settings, as of `run`.
    #[command(flatten)]
    pub choice: Choice,
}

fn size(text: &str) -> Result<usize, String> {
    bytes(text).ok_or_else(|| format!("1 to {LARGEST_PAYLOAD} bytes, or like 4k or 1M, are allowed"))
}

impl LatencyArguments {
    /// Checks what no other part does.
    ///
    /// # Errors
    /// A value that is not allowed; exit code 2.
    pub(crate) fn check(&self) -> anyhow::Result<()> {
        if !(0.5..=1000.0).contains(&self.rate) {
            return Err(Failure::bad_input(format!(
                "--rate {} is not allowed: 0.5 to 1000 scans per second",
                self.rate
            )));
        }
        if !(0.1..=36_000.0).contains(&self.duration) {
            return Err(Failure::bad_input(format!(
                "--duration {} is not allowed: 0.1 to 36000 s",
                self.duration
            )));
        }
        match self.payload {
            Some(bytes) if self.compute == Compute::Real => Err(Failure::bad_input(format!(
                "--payload {bytes} is not allowed with --compute real: the pipeline has its own samples"
            ))),
            Some(bytes) if !(1..=LARGEST_PAYLOAD).contains(&bytes) => Err(Failure::bad_input(format!(
                "--payload {bytes} is not allowed: 1 to {LARGEST_PAYLOAD} bytes"
            ))),
            _ => Ok(()),
        }
    }
}

/// A number of bytes like `4096`, `4k` or `1M`.
pub fn bytes(text: &str) -> Option<usize> {
    let (digits, unit) = match text.strip_suffix(['k', 'K']) {
        Some(digits) => (digits, 1 << 10),
        None => text.strip_suffix(['m', 'M']).map_or((text, 1), |digits| (digits, 1 << 20)),
    };
    digits.parse::<usize>().ok()?.checked_mul(unit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        latency: LatencyArguments,
    }

    fn refusal(arguments: &[&str]) -> String {
        let line = Line::try_parse_from([&["bench"], arguments].concat()).unwrap();
        line.latency.check().map_or_else(|error| error.to_string(), |()| String::new())
    }

    #[test]
    fn what_is_not_allowed_is_named() {
        assert_eq!(refusal(&[]), "");
        assert_eq!(refusal(&["--compute", "none", "--payload", "4096"]), "");
        assert_eq!(refusal(&["--compute", "none", "--payload", "4k"]), "");
        assert!(refusal(&["--rate", "0"]).starts_with("--rate 0 is not allowed: 0.5 to 1000"));
        assert!(refusal(&["--rate", "NaN"]).starts_with("--rate NaN is not allowed"));
        assert!(refusal(&["--duration", "1e9"]).contains("0.1 to 36000 s"));
        assert!(refusal(&["--payload", "8"]).contains("with --compute real"));
        assert!(refusal(&["--compute", "none", "--payload", "0"]).contains("1 to 16777216 bytes"));
    }
}
