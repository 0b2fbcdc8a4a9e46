//! Maps the stamps of a device to CLOCK_MONOTONIC.
//!
//! Data arrive later than they are stamped, so the smallest arrival minus stamp has the smallest delay. This is the
//! short form without an error bound.

/// Two crystals drift apart by less than one part in this many: 200 ppm.
const DRIFT: i64 = 5000;

/// The clock of one device. A restart of the device starts the mapping anew.
#[derive(Debug, Default)]
pub(crate) struct DeviceClock {
    /// Smallest arrival minus stamp [ns]
    offset_ns: Option<i64>,
    stamp_ns: u64,
    arrived_ns: u64,
    /// How often the stamps counted backwards: the device was restarted.
    pub(crate) restarts: u32,
}

impl DeviceClock {
    /// When data with this stamp would have arrived with the smallest delay, on CLOCK_MONOTONIC [ns].
    pub(crate) fn map(&mut self, stamp_ns: u64, arrived_ns: u64) -> u64 {
        let found_ns = arrived_ns.cast_signed() - stamp_ns.cast_signed();
        if stamp_ns < self.stamp_ns {
            self.restarts += 1;
            self.offset_ns = None;
        }
        let aged_ns = arrived_ns.saturating_sub(self.arrived_ns).cast_signed();
        let offset_ns = self.offset_ns.map_or(found_ns, |known_ns| found_ns.min(known_ns + aged_ns / DRIFT));
        (self.offset_ns, self.stamp_ns, self.arrived_ns) = (Some(offset_ns), stamp_ns, arrived_ns);
        stamp_ns.saturating_add_signed(offset_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_arrival_does_not_move_the_mapping_and_a_restart_begins_a_new_one() {
        let mut clock = DeviceClock::default();
        assert_eq!(clock.map(100, 1000), 1000);
        assert_eq!(clock.map(200, 1170), 1100, "70 ns late");
        assert_eq!(clock.map(300, 1190), 1190, "earlier than all before");
        assert_eq!((clock.map(5, 1300), clock.restarts), (1300, 1));
    }

    #[test]
    fn the_mapping_follows_a_slow_clock_by_200_ppm() {
        let mut clock = DeviceClock::default();
        clock.map(0, 1000);
        // The device counts 100 us less in a second.
        assert_eq!(clock.map(999_900_000, 1_000_001_000), 1_000_001_000);
    }
}
