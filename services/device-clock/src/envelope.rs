//! The smallest values of arrival minus stamp over the last minutes, and the line under them.

/// Length of a block: at 10 Hz it has 50 samples, some of which arrive with little delay [ns].
const BLOCK_NS: u64 = 5_000_000_000;
/// Blocks that are kept: 160 s, long enough to see a drift of 5 ppm through a jitter of 1 ms.
const BLOCKS: usize = 32;
/// Shorter spans do not show the drift: it is taken as it was before [ns].
const MIN_SPAN_NS: f64 = 60e9;
/// After a longer time without samples, new ones count only when there are [`SETTLED`] [ns].
const MAX_GAP_NS: u64 = 2 * BLOCK_NS;
/// Samples among which some have arrived almost without delay, even if delays are spread over 50 ms: 30 s at 10 Hz.
pub(crate) const SETTLED: u32 = 300;
/// A minimum this close above the line counts as one without additional delay [ns].
const NEAR_NS: f64 = 300_000.0;
/// Error of the line, in mean heights of the minima above it.
const SPREAD: f64 = 2.0;

/// The smallest value of one block.
#[derive(Debug, Clone, Copy, Default)]
struct Minimum {
    block: u64,
    arrived_ns: u64,
    offset_ns: i64,
}

/// Arrival minus stamp as a line in time, with the age of the sample that it goes through.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Smallest arrival minus stamp at the asked time [ns].
    pub offset_ns: i64,
    /// Time since the sample that gives it [ns].
    pub age_ns: u64,
    /// Additional delay that even the fastest samples may have [ns].
    pub spread_ns: u64,
}

/// Block minima of arrival minus stamp, with a fixed size.
#[derive(Debug, Clone)]
pub struct Envelope {
    minima: [Minimum; BLOCKS],
    count: usize,
    /// Growth of the offset; 0.0001 is 100 ppm.
    drift: f64,
    max_drift: f64,
    /// Index of the newest minimum close to the line.
    newest: usize,
    /// Index of the oldest minimum close to the line.
    oldest: usize,
    /// Index of the first minimum after the last gap.
    stretch: usize,
    /// Samples since the last gap.
    samples: u32,
    /// Additional delay that even the fastest samples may have [ns].
    spread_ns: u64,
}

impl Envelope {
    /// Empty, for clocks that differ by at most `max_drift_ppm`.
    pub fn new(max_drift_ppm: f64) -> Self {
        Self {
            minima: [Minimum::default(); BLOCKS],
            count: 0,
            drift: 0.0,
            max_drift: max_drift_ppm * 1e-6,
            newest: 0,
            oldest: 0,
            stretch: 0,
            samples: 0,
            spread_ns: 0,
        }
    }

    /// Forgets all samples, but not the drift: it belongs to the crystals.
    pub fn clear(&mut self) {
        (self.count, self.stretch, self.samples) = (0, 0, 0);
    }

    /// Growth of the offset per time [ppm].
    pub fn drift_ppm(&self) -> f64 {
        self.drift * 1e6
    }

    /// Adds one value of arrival minus stamp. Arrivals must not go back in time.
    pub fn add(&mut self, arrived_ns: u64, offset_ns: i64) {
        self.begin_stretch(arrived_ns);
        let block = arrived_ns / BLOCK_NS;
        let minimum = Minimum { block, arrived_ns, offset_ns };
        match self.minima[..self.count].last_mut().filter(|last| last.block >= block) {
            Some(last) if offset_ns < last.offset_ns => *last = minimum,
            Some(_) if self.samples == SETTLED => {}
            Some(_) => return,
            None => self.append(minimum),
        }
        self.choose();
    }

    /// Smallest arrival minus stamp at a time, from the newest sample that shows it; `None` without samples.
    pub fn at(&self, time_ns: u64) -> Option<Line> {
        self.line(self.newest, time_ns)
    }

    /// The same from the oldest sample that shows it: for times before the first sample.
    pub fn at_start(&self, time_ns: u64) -> Option<Line> {
        self.line(self.oldest, time_ns)
    }

    fn line(&self, index: usize, time_ns: u64) -> Option<Line> {
        let minimum = self.kept().get(index)?;
        let age_ns = time_ns.wrapping_sub(minimum.arrived_ns).cast_signed();
        let grown = (age_ns as f64 * self.drift) as i64;
        Some(Line {
            offset_ns: minimum.offset_ns.saturating_add(grown),
            age_ns: age_ns.unsigned_abs(),
            spread_ns: self.spread_ns,
        })
    }

    /// Counts a sample; the first one after a gap begins a stretch.
    fn begin_stretch(&mut self, arrived_ns: u64) {
        let last_ns = self.kept().last().map_or(arrived_ns, |last| last.block * BLOCK_NS);
        if arrived_ns.saturating_sub(last_ns) > MAX_GAP_NS {
            (self.stretch, self.samples) = (self.count, 0);
        }
        self.samples = self.samples.saturating_add(1);
    }

    fn append(&mut self, minimum: Minimum) {
        if self.count == BLOCKS {
            self.minima.copy_within(1.., 0);
            self.count -= 1;
            self.stretch = self.stretch.saturating_sub(1);
        }
        self.minima[self.count] = minimum;
        self.count += 1;
    }

    fn kept(&self) -> &[Minimum] {
        &self.minima[..self.count]
    }

    /// Indices of the minima that may be used: none from after a gap until there are enough.
    fn usable(&self) -> std::ops::Range<usize> {
        match self.stretch {
            0 => 0..self.count,
            _ if self.samples < SETTLED => 0..self.stretch,
            stretch => stretch..self.count,
        }
    }

    /// Estimates the drift and chooses the newest and the oldest minimum close to the line.
    fn choose(&mut self) {
        let mut points = [(0.0, 0.0); BLOCKS];
        for (point, minimum) in points.iter_mut().zip(self.kept()) {
            *point = self.point(minimum);
        }
        let points = &points[..self.count];
        if points.last().is_some_and(|last| last.0 - points[0].0 >= MIN_SPAN_NS) {
            self.drift = slope_below(points).clamp(-self.max_drift, self.max_drift);
        }
        let usable = self.usable();
        let height = |point: &(f64, f64)| point.1 - self.drift * point.0;
        let used = &points[usable.clone()];
        let lowest = used.iter().map(height).fold(f64::INFINITY, f64::min);
        let mean = used.iter().map(height).sum::<f64>() / used.len().max(1) as f64;
        self.spread_ns = (SPREAD * (mean - lowest)) as u64;
        let is_near = |point: &(f64, f64)| height(point) <= lowest + NEAR_NS;
        self.newest = usable.start + used.iter().rposition(is_near).unwrap_or(0);
        self.oldest = usable.start + used.iter().position(is_near).unwrap_or(0);
    }

    /// A minimum relative to the oldest one [ns, ns].
    fn point(&self, minimum: &Minimum) -> (f64, f64) {
        let oldest = &self.minima[0];
        let time = minimum.arrived_ns.wrapping_sub(oldest.arrived_ns).cast_signed();
        (time as f64, minimum.offset_ns.saturating_sub(oldest.offset_ns) as f64)
    }
}

/// Slope of the line that lies below all points and is nearest to them on average: the edge of their lower hull below
/// their mean time. (Moon, Skelly, Towsley: Estimation and removal of clock skew from network delay measurements, 1999.)
fn slope_below(points: &[(f64, f64)]) -> f64 {
    let mut hull = [(0.0, 0.0); BLOCKS];
    let mut count = 0;
    for point in points {
        while count >= 2 && slope(hull[count - 2], *point) <= slope(hull[count - 2], hull[count - 1]) {
            count -= 1;
        }
        hull[count] = *point;
        count += 1;
    }
    let mean = points.iter().map(|point| point.0).sum::<f64>() / points.len() as f64;
    let edge = hull[..count].windows(2).find(|edge| edge[1].0 >= mean);
    edge.map_or(0.0, |edge| slope(edge[0], edge[1]))
}

fn slope(from: (f64, f64), to: (f64, f64)) -> f64 {
    (to.1 - from.1) / (to.0 - from.0).max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_samples_change_neither_line_nor_drift() {
        let mut envelope = Envelope::new(200.0);
        for step in 0..1000_u64 {
            let arrived_ns = step * 100_000_000;
            let drifted = (arrived_ns as f64 * 80e-6) as i64;
            let delay = if step % 50 == 7 { 0 } else { 40_000_000 };
            envelope.add(arrived_ns, 5_000 + drifted + delay);
        }
        let line = envelope.at(100_000_000_000).unwrap();
        assert!((envelope.drift_ppm() - 80.0).abs() < 0.1, "{}", envelope.drift_ppm());
        assert!((line.offset_ns - 5_000 - 8_000_000).abs() < 1_000, "{line:?}");
        assert!(line.age_ns < BLOCK_NS, "{line:?}");
    }

    #[test]
    fn the_newest_of_equal_minima_is_used() {
        let mut envelope = Envelope::new(200.0);
        (0..8).for_each(|block| envelope.add(block * BLOCK_NS, 1_000));
        assert_eq!(envelope.at(7 * BLOCK_NS).unwrap(), Line { offset_ns: 1_000, age_ns: 0, spread_ns: 0 });
    }
}
