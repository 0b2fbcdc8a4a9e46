//! Where a scanner is, and what is wanted of it.

use std::fmt;
use std::path::PathBuf;

use shared_types::ScanGeometry;

use crate::UrgError;
use crate::command::Coding;

/// Where a scanner is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ScannerPlace {
    /// A serial line, also one over USB.
    Device(PathBuf),
    /// A host and a port.
    Tcp(String),
}

impl ScannerPlace {
    /// A path begins with `/`; everything else is `HOST:PORT`.
    ///
    /// # Errors
    /// [`UrgError::Place`].
    pub fn parse(text: &str) -> Result<Self, UrgError> {
        let is_port = |port: &str| port.parse::<u16>().is_ok_and(|port| port > 0);
        match text.rsplit_once(':') {
            _ if text.starts_with('/') => Ok(Self::Device(text.into())),
            Some((host, port)) if !host.is_empty() && is_port(port) => Ok(Self::Tcp(text.to_owned())),
            _ => Err(UrgError::Place(text.to_owned())),
        }
    }
}

impl fmt::Display for ScannerPlace {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Device(path) => path.display().fmt(formatter),
            Self::Tcp(address) => address.fmt(formatter),
        }
    }
}

/// Which scanner is used, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct ScannerConfig {
    /// Where the scanner is.
    pub place: ScannerPlace,
    /// Scans per second that the system expects; `None` for any. A scanner that differs by more than 5 % is refused.
    pub rate_hz: Option<f64>,
    /// The beams that a scan gets, in a counter-clockwise sweep; the URG-04LX's by default.
    pub beams: ScanGeometry,
    /// Coding of the ranges: with two characters a third less is transmitted, and ranges end at 4.09 m.
    pub coding: Coding,
    /// Scans left out after each one, 0 to 9.
    pub skip: u8,
    /// Steps that are merged to one range, the smallest of theirs, 1 to 99.
    pub cluster: u8,
    /// Bit rate of a serial line; without effect over USB [bit/s].
    pub bit_rate: u32,
    /// Asks for identification and parameters only: the laser stays off, and no model is refused.
    pub identify_only: bool,
}

impl ScannerConfig {
    /// The usual configuration of a scanner at a place.
    pub fn new(place: ScannerPlace) -> Self {
        let coding = Coding::Three;
        let beams = ScanGeometry::URG_04LX;
        Self {
            place,
            rate_hz: None,
            beams,
            coding,
            skip: 0,
            cluster: 1,
            bit_rate: 115_200,
            identify_only: false,
        }
    }
}
