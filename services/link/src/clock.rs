//! The clock of another host: its offset to ours, from probes of four stamps.
//!
//! A probe leaves here at `sent_ns`, reaches the other host at `received_ns` of its clock, leaves it at
//! `answered_ns` and is back at `returned_ns` of ours. If both ways took equally long, the offset is the mean of the two
//! differences; it is wrong by half of the round trip at most. Of the last [`PROBES`] the one with the shortest round
//! trip counts. Its bound grows by [`DRIFT`] with its age, because two clocks drift apart.
//!
//! The offset in use never steps: it is slewed by [`SLEW`] at most, and the distance that is still to go counts in the
//! bound. A measured rate difference is compensated. A clock that stood still (a suspended machine) does not fit the
//! bound any more: then the clock is lost, and is locked anew.
//!
//! Where this fails: a way that always takes longer than the other one is not seen, and lies within the bound.

#[cfg(test)]
mod tests;

/// Probes of which the shortest counts.
pub(crate) const PROBES: usize = 32;
/// Probes after which the clock is locked.
const LOCKED_AFTER: usize = 8;
/// Drift of two clocks whose rate difference is compensated, which the bound allows for.
const DRIFT: f64 = 50e-6;
/// Drift that the bound allows for until the rate difference is known: each clock may be wrong by 100 ppm.
const UNKNOWN_DRIFT: f64 = 200e-6;
/// Largest rate at which the offset is moved to the measured one.
const SLEW: f64 = 500e-6;
/// Time over which the rate difference is measured [ns].
const RATE_NS: u64 = 20_000_000_000;
/// Largest rate difference that is believed.
const MAX_RATE: f64 = 300e-6;
/// Probes in a row that do not fit the bound, after which the clock is lost.
const MISFITS: u32 = 3;

/// The four stamps of a probe [ns].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Probe {
    /// When it left, by our clock.
    pub(crate) sent_ns: u64,
    /// When it reached the other host, by the other clock.
    pub(crate) received_ns: u64,
    /// When the answer left there, by the other clock.
    pub(crate) answered_ns: u64,
    /// When the answer was here, by our clock.
    pub(crate) returned_ns: u64,
}

/// One probe as measured.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Measured {
    at_ns: u64,
    offset_ns: f64,
    round_trip_ns: f64,
}

/// Our belief about the clock of another host.
#[derive(Debug, Clone, Default)]
pub(crate) struct HostClock {
    recent: Vec<Measured>,
    next: usize,
    /// The offset in use at `moved_ns`: what is to be added to our time.
    offset_ns: f64,
    moved_ns: u64,
    rate: Option<f64>,
    /// Where the measurement of the rate began.
    anchor: Option<Measured>,
    misfits: u32,
    is_locked: bool,
    lost: u64,
}

/// The offset at one time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Offset {
    /// What is to be added to our time to get the other one [ns].
    pub(crate) offset_ns: i64,
    /// How wrong it may be [ns].
    pub(crate) bound_ns: u64,
}

impl Offset {
    /// In place of one that is not known.
    pub(crate) const UNKNOWN: Self = Self { offset_ns: 0, bound_ns: u64::MAX };
}

impl HostClock {
    /// A clock of which nothing is known.
    pub(crate) fn new() -> Self {
        Self { recent: Vec::with_capacity(PROBES), ..Self::default() }
    }

    /// Takes in a probe. One whose stamps contradict each other is ignored.
    pub(crate) fn probe(&mut self, stamps: Probe) {
        let Some(measured) = measure(stamps) else { return };
        if self.is_locked && !self.fits(&measured) {
            self.misfits += 1;
            if self.misfits >= MISFITS {
                *self = Self { lost: self.lost + 1, ..Self::new() };
            }
            return;
        }
        self.misfits = 0;
        // Before the probe counts: until now the offset went to where the others point.
        self.move_to(measured.at_ns);
        match self.recent.len() {
            PROBES => self.recent[self.next] = measured,
            _ => self.recent.push(measured),
        }
        self.next = (self.next + 1) % PROBES;
        self.measure_rate();
        if !self.is_locked && self.recent.len() >= LOCKED_AFTER {
            (self.offset_ns, self.moved_ns) = (self.target(measured.at_ns).unwrap_or(0.0), measured.at_ns);
            self.is_locked = true;
        }
    }

    /// The offset now; `None` while the clock is not locked.
    pub(crate) fn offset(&self, now_ns: u64) -> Option<Offset> {
        if !self.is_locked {
            return None;
        }
        let (offset_ns, best) = (self.offset_at(now_ns), self.best()?);
        let drift = if self.rate.is_some() { DRIFT } else { UNKNOWN_DRIFT };
        let to_go_ns = (self.target(now_ns)? - offset_ns).abs();
        let bound_ns = 0.5 * best.round_trip_ns + drift * elapsed_ns(best.at_ns, now_ns) + to_go_ns;
        Some(Offset { offset_ns: offset_ns.round() as i64, bound_ns: bound_ns.ceil() as u64 })
    }

    /// The shortest round trip of the probes in use [ns].
    pub(crate) fn round_trip_ns(&self) -> Option<u64> {
        self.best().map(|best| best.round_trip_ns as u64)
    }

    /// How often the other clock, or ours, did not fit its bound and was lost.
    pub(crate) fn lost(&self) -> u64 {
        self.lost
    }

    fn best(&self) -> Option<&Measured> {
        self.recent.iter().min_by(|one, other| one.round_trip_ns.total_cmp(&other.round_trip_ns))
    }

    /// The offset that the best probe gives now.
    fn target(&self, now_ns: u64) -> Option<f64> {
        let best = self.best()?;
        Some(best.offset_ns + self.rate.unwrap_or(0.0) * elapsed_ns(best.at_ns, now_ns))
    }

    /// The offset in use now.
    fn offset_at(&self, now_ns: u64) -> f64 {
        // A question about a moment before the last move: nothing was slewed since.
        let elapsed_ns = elapsed_ns(self.moved_ns, now_ns).max(0.0);
        let carried_ns = self.offset_ns + self.rate.unwrap_or(0.0) * elapsed_ns;
        let to_go_ns = self.target(now_ns).unwrap_or(carried_ns) - carried_ns;
        carried_ns + to_go_ns.clamp(-SLEW * elapsed_ns, SLEW * elapsed_ns)
    }

    fn move_to(&mut self, now_ns: u64) {
        self.offset_ns = self.offset_at(now_ns);
        self.moved_ns = now_ns;
    }

    /// Compares the best probe with one of long before.
    fn measure_rate(&mut self) {
        let Some(best) = self.best().copied() else { return };
        let Some(anchor) = self.anchor else {
            self.anchor = (self.recent.len() == PROBES).then_some(best);
            return;
        };
        let elapsed_ns = elapsed_ns(anchor.at_ns, best.at_ns);
        if elapsed_ns >= RATE_NS as f64 {
            let rate = ((best.offset_ns - anchor.offset_ns) / elapsed_ns).clamp(-MAX_RATE, MAX_RATE);
            // Half of what is new: two short round trips may differ in their ways.
            self.rate = Some(self.rate.map_or(rate, |before| 0.5 * (before + rate)));
            self.anchor = Some(best);
        }
    }

    fn fits(&self, measured: &Measured) -> bool {
        let Some(known) = self.offset(measured.at_ns) else { return true };
        let distance_ns = (measured.offset_ns - known.offset_ns as f64).abs();
        distance_ns <= 0.5 * measured.round_trip_ns + known.bound_ns as f64 + 1e6
    }
}

fn measure(stamps: Probe) -> Option<Measured> {
    let Probe { sent_ns, received_ns, answered_ns, returned_ns } = stamps;
    let away_ns = returned_ns.checked_sub(sent_ns)?;
    let there_ns = answered_ns.checked_sub(received_ns)?;
    // A clock that runs faster there may make a very short round trip negative.
    let round_trip_ns = away_ns as f64 - there_ns as f64;
    let forth_ns = received_ns.wrapping_sub(sent_ns).cast_signed() as f64;
    let back_ns = answered_ns.wrapping_sub(returned_ns).cast_signed() as f64;
    let offset_ns = 0.5 * (forth_ns + back_ns);
    (round_trip_ns >= 0.0).then_some(Measured { at_ns: returned_ns, offset_ns, round_trip_ns })
}

fn elapsed_ns(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.wrapping_sub(from_ns).cast_signed() as f64
}
