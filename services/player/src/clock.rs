//! The clock of the server, mapped to CLOCK_MONOTONIC.

/// Stand-in until the crate of device clocks is there.
#[derive(Debug, Default)]
pub struct ServerClock {
    offset_ns: Option<i64>,
}

impl ServerClock {
    /// Maps a stamp whose message has arrived.
    pub fn arrival(&mut self, time_s: f64, arrived_ns: u64) -> u64 {
        let stamp_ns = ticks(time_s);
        let offset_ns = arrived_ns as i64 - stamp_ns;
        let offset_ns = self.offset_ns.map_or(offset_ns, |known| {
            if (offset_ns - known).abs() > 500_000_000 { offset_ns } else { known.min(offset_ns) }
        });
        self.offset_ns = Some(offset_ns);
        (stamp_ns + offset_ns) as u64
    }

    /// Maps a stamp.
    pub fn map(&self, time_s: f64, arrived_ns: u64) -> Option<u64> {
        Some((ticks(time_s).saturating_add(self.offset_ns?)).clamp(0, arrived_ns as i64) as u64)
    }
}

fn ticks(time_s: f64) -> i64 {
    (time_s.clamp(0.0, 4e9) * 1e9) as i64
}
