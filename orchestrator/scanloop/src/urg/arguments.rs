//! Arguments of `scanloop urg`.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

/// What to do with the scanner.
#[derive(Debug, Subcommand)]
pub enum UrgCommand {
    /// Print identification, state and parameters of a scanner; its laser stays off.
    ///
    /// Exit code 1 if it does not answer, 2 if it can't be reached.
    Info(InfoArguments),
    /// Draw the scans of a scanner in the terminal, seen from above, until Ctrl-C.
    ///
    /// Exit code 1 if no scan comes within 10 s, 2 if the scanner can't be reached or used.
    Plot(PlotArguments),
    /// Write the scans of a scanner to a file, one per line, until Ctrl-C.
    ///
    /// Exit code 1 if no scan comes within 10 s, 2 if the scanner can't be reached or used.
    Log(LogArguments),
    /// Emulate a scanner that stands in a room, for a try without hardware, until Ctrl-C.
    ///
    /// Prints its device or address to standard output. Without `--tcp` it is a serial line.
    Emulate(EmulateArguments),
}

/// Where the scanner is.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub struct PlaceArguments {
    /// Serial device of the scanner, also one over USB, such as `/dev/ttyACM0`.
    #[arg(long, value_name = "PATH")]
    pub device: Option<PathBuf>,
    /// Address of a scanner with Ethernet, such as `192.168.0.10:10940`.
    #[arg(long, value_name = "HOST:PORT")]
    pub tcp: Option<String>,
}

/// The scanner and how it measures.
#[derive(Debug, Args)]
pub struct ScannerArguments {
    /// Where the scanner is.
    #[command(flatten)]
    pub place: PlaceArguments,
    /// Bit rate of a serial line; without effect over USB.
    #[arg(long, value_name = "RATE", default_value_t = 115_200, value_parser = clap::value_parser!(u32).range(9600..=4_000_000))]
    pub bit_rate: u32,
    /// Code ranges with two characters: a third less to transmit, and ranges end at 4.09 m.
    #[arg(long)]
    pub two_characters: bool,
    /// Leave out this many scans after each one.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=9))]
    pub skip: u8,
    /// Merge this many steps to one range, the smallest of theirs: less to transmit, and a coarser picture.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=99))]
    pub cluster: u8,
    /// Stop after this many scans.
    #[arg(long, short = 'n', value_name = "N")]
    pub count: Option<u64>,
    /// Stop after this many seconds.
    #[arg(long, value_name = "S")]
    pub duration: Option<f64>,
}

/// Arguments of `urg info`.
#[derive(Debug, Args)]
pub struct InfoArguments {
    /// Where the scanner is.
    #[command(flatten)]
    pub place: PlaceArguments,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `urg plot`.
#[derive(Debug, Args)]
pub struct PlotArguments {
    /// The scanner.
    #[command(flatten)]
    pub scanner: ScannerArguments,
    /// Distance from the scanner to the edges of the picture [m].
    #[arg(long, value_name = "M", default_value_t = 4.0)]
    pub range: f64,
}

/// Arguments of `urg log`.
#[derive(Debug, Args)]
pub struct LogArguments {
    /// The scanner.
    #[command(flatten)]
    pub scanner: ScannerArguments,
    /// The file, which grows with each scan.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Replace a file of that name.
    #[arg(long)]
    pub force: bool,
}

/// What is emulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum EmulatedModel {
    /// An URG-04LX.
    #[value(name = "urg-04lx")]
    Urg04lx,
    /// An UST-10LX.
    #[value(name = "ust-10lx")]
    Ust10lx,
}

/// Arguments of `urg emulate`.
#[derive(Debug, Args)]
pub struct EmulateArguments {
    /// Accept connections here instead of making a serial line; port 0 is any free one.
    #[arg(long, value_name = "HOST:PORT")]
    pub tcp: Option<String>,
    /// The model: 682 steps and 10 scans per second, or 1,081 and 40.
    #[arg(long, value_name = "MODEL", value_enum, default_value = "urg-04lx")]
    pub model: EmulatedModel,
    /// A fault and when it happens: `checksum`, `half-scan`, `stall`, `stuck`, `garbage`, `restart` or `backwards`, as in
    /// `--fault stall@5`.
    #[arg(long, value_name = "FAULT@S")]
    pub fault: Vec<String>,
    /// Stop after this many seconds.
    #[arg(long, value_name = "S")]
    pub duration: Option<f64>,
}
