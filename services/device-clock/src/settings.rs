//! What is known of a device's clock beforehand.

/// What a device's clock is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockSettings {
    /// Length of a tick of the stamps [ns].
    pub tick_ns: u64,
    /// Ticks after which the stamps are zero again; `None` if they never are.
    pub wrap_ticks: Option<u64>,
    /// Largest difference between a stamp and the time of what it stamps [ns].
    pub resolution_ns: u64,
    /// Largest drift between the clocks; the error bound grows by it with age [ppm].
    pub max_drift_ppm: f64,
    /// A message with an older stamp than others before it is no longer under way than they were by more; 0 on lines that
    /// keep the order [ns].
    pub max_overtaken_ns: u64,
    /// Larger deviations from the expected stamp count as a jump of the device's clock [ns].
    pub jump_ns: u64,
    /// Smallest delay from stamp to arrival, while no round trip has shown it [ns].
    pub delay_ns: u64,
    /// Error bound of `delay_ns` [ns].
    pub delay_error_ns: u64,
    /// Added to the error bound of the first 300 samples, without a round trip: the largest usual delay beyond the smallest one [ns].
    pub jitter_ns: u64,
}

impl ClockSettings {
    /// A counter of milliseconds with 24 bits: Hokuyo scanners, whose lines keep the order.
    pub fn milliseconds_of_24_bits() -> Self {
        let tick_ns = 1_000_000;
        let wrap_ticks = Some(1 << 24);
        Self { tick_ns, wrap_ticks, resolution_ns: tick_ns, max_overtaken_ns: 0, ..Self::nanoseconds() }
    }

    /// Stamps in nanoseconds that never wrap: drivers that stamp with a system clock.
    pub fn nanoseconds() -> Self {
        Self {
            tick_ns: 1,
            wrap_ticks: None,
            resolution_ns: 1_000_000,
            max_drift_ppm: 200.0,
            max_overtaken_ns: 1_000_000_000,
            jump_ns: 20_000_000,
            delay_ns: 0,
            delay_error_ns: 0,
            jitter_ns: 100_000_000,
        }
    }
}
