//! The beams that are compared from scan to scan: every so manieth of a scanner with more than the URG-04LX.
//!
//! So the kept scans fit a checkpoint, and a comparison costs no more than with the URG-04LX. Bodies are found with all beams.

use shared_types::{BEAMS, Scan};
use vehicle::ScannerDescription;

use crate::points::{Beams, Point};

/// Every `stride`th beam of the scans.
#[derive(Debug, Clone)]
pub(crate) struct Thin {
    stride: usize,
    beams: Beams,
    scan: Scan,
}

impl Thin {
    pub(crate) fn new(scanner: &ScannerDescription) -> Self {
        let stride = scanner.beams.div_ceil(BEAMS);
        let beams = Beams::new(scanner, stride);
        Self { stride, scan: Scan::of(beams.geometry), beams }
    }

    /// The beams.
    pub(crate) fn beams(&self) -> &Beams {
        &self.beams
    }

    /// One of so many beams of the scanner is one of them.
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// What they show of the scan last taken, which is `scan` itself where all are compared.
    pub(crate) fn of<'a>(&'a self, scan: &'a Scan) -> &'a Scan {
        if self.stride == 1 { scan } else { &self.scan }
    }

    /// Takes what they show of a scan, and of all its `points`.
    pub(crate) fn take(&mut self, scan: &Scan, points: &[Point], thinned: &mut Vec<Point>) {
        let stride = self.stride;
        if stride == 1 {
            thinned.clear();
            thinned.extend_from_slice(points);
            return;
        }
        thinned.clear();
        let kept = points.iter().filter(|point| point.beam % stride == 0);
        thinned.extend(kept.map(|point| Point { beam: point.beam / stride, ..*point }));
        (self.scan.header, self.scan.sweep_ns, self.scan.period_ns) =
            (scan.header, scan.sweep_ns, scan.period_ns);
        for (range, all) in self.scan.ranges_mut().iter_mut().zip(scan.ranges().chunks(stride)) {
            *range = all[0];
        }
    }
}
