//! The clock of another host, scan by scan: by it a replay maps the times of recorded samples back.

use crate::sample::sample;
use crate::{Fault, Header};

/// Longest name of a host in a [`ClockOffset`] [bytes].
pub const HOST_NAME_BYTES: usize = 16;

sample! {
    /// Which offset another host has used for the times of all samples of one scan, in both directions.
    pub struct ClockOffset(328, Clock, 0x9445_9935, "scanloop.ClockOffset.v2", check) {
        /// Identity: the scan; the chain is unused
        pub header: Header,
        /// Name of the host in ASCII, padded with zeros
        pub host: [u8; HOST_NAME_BYTES],
        /// A moment on the clock of the orchestrator's host, as in all samples that were recorded there [ns]
        pub common_ns: u64,
        /// The same moment on the clock of the other host [ns]
        pub host_ns: u64,
        /// What the two may be apart by in truth [ns]
        pub bound_ns: u64,
    }
}

impl ClockOffset {
    /// The offset of a host for a scan: at `common_ns` of the orchestrator's clock, what that clock is ahead by [ns].
    ///
    /// A name that is too long is cut off.
    pub fn new(host: &str, scan_id: u64, common_ns: u64, offset_ns: i64, bound_ns: u64) -> Self {
        let mut name = [0; HOST_NAME_BYTES];
        name.iter_mut().zip(host.bytes()).for_each(|(place, letter)| *place = letter);
        let header = Header { scan_id, ..Header::default() };
        Self {
            header,
            host: name,
            common_ns,
            host_ns: common_ns.wrapping_add_signed(offset_ns.wrapping_neg()),
            bound_ns,
        }
    }

    /// What the orchestrator's clock is ahead of that of the host by [ns].
    pub fn offset_ns(&self) -> i64 {
        self.common_ns.wrapping_sub(self.host_ns).cast_signed()
    }

    /// Name of the host; empty when it is not readable.
    pub fn host_name(&self) -> &str {
        let length = self.host.iter().position(|letter| *letter == 0).unwrap_or(HOST_NAME_BYTES);
        std::str::from_utf8(&self.host[..length]).unwrap_or_default()
    }
}

fn check(offset: &ClockOffset) -> Result<(), Fault> {
    offset.header.check::<ClockOffset>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_offset_of_either_sign_is_read_back_exactly() {
        for offset_ns in [0, -1, 86_400_000_000_001, -86_400_000_000_001] {
            let offset = ClockOffset::new("lab", 7, 5_000_000_000, offset_ns, 9);
            assert_eq!(
                (offset.host_name(), offset.offset_ns(), offset.header.scan_id),
                ("lab", offset_ns, 7)
            );
        }
    }
}
