//! State that a restarted or swapped process resumes from.

use bytemuck::Pod;

use crate::describe::{Described, FNV_OFFSET, fingerprint};
use crate::sample::sample;
use crate::{Fault, Header, Role, shift_state};

/// How many bytes of state a checkpoint can hold.
pub const CHECKPOINT_BYTES: usize = 12800;

sample! {
    /// The state of one stateful process after a scan, as bytes of a type that both ends know.
    pub struct Checkpoint(13120, Checkpoint, 0x8789_a79e, "scanloop.Checkpoint.v4", check) {
        /// Identity: the scan after which the state was taken
        pub header: Header,
        /// Slot of the process; the first five are those of a `Role`
        pub role: u32,
        /// Fingerprint of the type of the state
        pub state_layout: u32,
        /// How many of `bytes` are used
        pub length: u32,
        /// Unused, zero
        pub reserved: u32,
        /// When it was published [ns]
        pub issued_ns: u64,
        /// The same on the clock that the times of the state are of, also on another host; 0 when it is not known [ns]
        pub saved_ns: u64,
        /// The state
        pub bytes: [u8; CHECKPOINT_BYTES],
    }
}

/// Why a checkpoint can't be resumed from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CheckpointError {
    /// The state is of a type that this process does not know.
    UnknownState {
        /// Fingerprint of the state in the checkpoint.
        found: u32,
        /// Fingerprint that this process knows.
        expected: u32,
    },
    /// The state is longer or shorter than its type.
    Length {
        /// Bytes in the checkpoint.
        found: usize,
        /// Bytes of the type.
        expected: usize,
    },
}

impl std::fmt::Display for CheckpointError {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::UnknownState { found, expected } => {
                write!(formatter, "state of layout {found:#010x} where {expected:#010x} was expected")
            }
            Self::Length { found, expected } => {
                write!(formatter, "state of {found} bytes instead of {expected}")
            }
        }
    }
}

impl std::error::Error for CheckpointError {}

impl Checkpoint {
    /// A checkpoint of a state of another language; `state_layout` is the number by which both ends know it.
    ///
    /// # Errors
    /// [`CheckpointError::Length`] when it does not fit.
    pub fn of_bytes(role: Role, state_layout: u32, state: &[u8]) -> Result<Self, CheckpointError> {
        let mut checkpoint =
            Self { role: role.wire(), state_layout, length: state.len() as u32, ..Self::default() };
        let room = checkpoint.bytes.get_mut(..state.len());
        let room = room.ok_or(CheckpointError::Length { found: state.len(), expected: CHECKPOINT_BYTES })?;
        room.copy_from_slice(state);
        Ok(checkpoint)
    }

    /// The state as bytes, where both ends know it by the same number.
    ///
    /// # Errors
    /// [`CheckpointError::UnknownState`] when they do not.
    pub fn state_bytes(&self, state_layout: u32) -> Result<&[u8], CheckpointError> {
        if self.state_layout != state_layout {
            return Err(CheckpointError::UnknownState { found: self.state_layout, expected: state_layout });
        }
        Ok(&self.bytes[..(self.length as usize).min(CHECKPOINT_BYTES)])
    }

    /// A checkpoint of `state`; the header is filled when it is published.
    pub fn of<S: Pod + Described>(role: Role, state: &S) -> Self {
        const { assert!(size_of::<S>() <= CHECKPOINT_BYTES, "the state does not fit a checkpoint") };
        let mut checkpoint = Self {
            role: role.wire(),
            state_layout: const { fingerprint(&S::KIND, FNV_OFFSET) },
            length: size_of::<S>() as u32,
            ..Self::default()
        };
        checkpoint.bytes[..size_of::<S>()].copy_from_slice(bytemuck::bytes_of(state));
        checkpoint
    }

    /// What the clock of this host is ahead by of the one that the times of the state are of [ns].
    pub fn moved_ns(&self) -> i64 {
        if self.saved_ns == 0 { 0 } else { self.issued_ns.wrapping_sub(self.saved_ns).cast_signed() }
    }

    /// The state with its times on the clock of this host, where both ends know its type.
    ///
    /// # Errors
    /// As [`Checkpoint::state`].
    pub fn state_here<S: Pod + Described>(&self) -> Result<S, CheckpointError> {
        let mut state = self.state::<S>()?;
        shift_state(&S::KIND, bytemuck::bytes_of_mut(&mut state), self.moved_ns());
        Ok(state)
    }

    /// The state as it was saved, where both ends know its type.
    ///
    /// # Errors
    /// [`CheckpointError`] when the type or its length differs.
    pub fn state<S: Pod + Described>(&self) -> Result<S, CheckpointError> {
        let bytes = self.state_bytes(const { fingerprint(&S::KIND, FNV_OFFSET) })?;
        bytemuck::try_pod_read_unaligned(bytes)
            .map_err(|_| CheckpointError::Length { found: bytes.len(), expected: size_of::<S>() })
    }
}

fn check(checkpoint: &Checkpoint) -> Result<(), Fault> {
    checkpoint.header.check::<Checkpoint>()?;
    Role::try_from(checkpoint.role)?;
    if checkpoint.length as usize > CHECKPOINT_BYTES {
        return Err(Fault::OutOfRange { field: "length", value: f64::from(checkpoint.length) });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Sample, SampleType, StageStamps, shift_times};

    #[test]
    fn a_state_is_read_back_only_as_its_own_type() {
        let state = StageStamps { woken_ns: 1, taken_ns: 2, computed_ns: 3, published_ns: 4 };
        let checkpoint = Checkpoint::of(Role::Estimator, &state);
        assert_eq!(checkpoint.state::<StageStamps>(), Ok(state));
        assert!(matches!(checkpoint.state::<Header>(), Err(CheckpointError::UnknownState { .. })));
    }

    #[test]
    fn on_another_host_the_times_of_a_state_are_those_of_its_clock() {
        const OF: &SampleType = Checkpoint::TYPE;
        let state = StageStamps { woken_ns: 0, taken_ns: 5_002, computed_ns: 5_003, published_ns: 5_004 };
        let mut checkpoint = Checkpoint::of(Role::Estimator, &state);
        (checkpoint.issued_ns, checkpoint.saved_ns) = (5_010, 5_010);
        assert_eq!(checkpoint.state_here(), Ok(state));
        shift_times(OF, bytemuck::bytes_of_mut(&mut checkpoint), -5_000);
        let here = StageStamps { woken_ns: 0, taken_ns: 2, computed_ns: 3, published_ns: 4 };
        assert_eq!((checkpoint.moved_ns(), checkpoint.state_here()), (-5_000, Ok(here)));
        checkpoint.saved_ns = 0;
        assert_eq!(checkpoint.state_here(), Ok(state), "of a program that does not tell");
    }
}
