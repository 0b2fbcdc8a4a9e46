//! Samples of which each one counts, not only the newest: journals. Each is sent in three messages in a row, so that it
//! arrives if one of them does, and in order.

use std::collections::VecDeque;

/// Messages that contain a sample.
const MESSAGES: u32 = 3;
/// Bytes in front of a sample: its length, little-endian.
const LENGTH_BYTES: usize = 4;

/// What is to be sent.
#[derive(Debug, Default)]
pub(crate) struct Batch {
    /// Frames, oldest first, and how often each was sent.
    frames: VecDeque<(Vec<u8>, u32)>,
    /// Frames that are not in use.
    spare: Vec<Vec<u8>>,
}

impl Batch {
    /// Adds a frame, which `fill` writes. Where there are `most` already, the oldest goes; returns whether it was never sent.
    pub(crate) fn add(&mut self, most: usize, fill: impl FnOnce(&mut Vec<u8>)) -> bool {
        let mut oldest = if self.frames.len() >= most { self.frames.pop_front() } else { None };
        let is_lost = oldest.as_ref().is_some_and(|(_, sent)| *sent == 0);
        self.spare.extend(oldest.take().map(|(frame, _)| frame));
        let mut frame = self.spare.pop().unwrap_or_default();
        frame.clear();
        fill(&mut frame);
        self.frames.push_back((frame, 0));
        is_lost
    }

    /// Writes the next message; returns how many frames it contains for the first time, `None` when there is nothing to send.
    pub(crate) fn take(&mut self, message: &mut Vec<u8>) -> Option<u64> {
        message.clear();
        let mut first = 0;
        for (frame, sent) in &mut self.frames {
            message.extend_from_slice(&(frame.len() as u32).to_le_bytes());
            message.extend_from_slice(frame);
            first += u64::from(*sent == 0);
            *sent += 1;
        }
        while let Some((frame, _)) = self.frames.pop_front_if(|(_, sent)| *sent >= MESSAGES) {
            self.spare.push(frame);
        }
        (!message.is_empty()).then_some(first)
    }
}

/// The frames of a message; it ends where the message is damaged.
pub(crate) fn frames(mut message: &[u8]) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || {
        let (length, rest) = message.split_first_chunk::<LENGTH_BYTES>()?;
        let (frame, others) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        message = others;
        Some(frame)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(message: &[u8]) -> Vec<u8> {
        frames(message).map(|frame| frame[0]).collect()
    }

    #[test]
    fn each_frame_is_in_three_messages_in_a_row() {
        let (mut batch, mut message, mut sent) = (Batch::default(), Vec::new(), Vec::new());
        assert_eq!(batch.take(&mut message), None);
        for number in 1..=2 {
            assert!(!batch.add(8, |frame| frame.extend([number; 5])));
            sent.push((batch.take(&mut message).unwrap(), numbers(&message)));
        }
        while let Some(first) = batch.take(&mut message) {
            sent.push((first, numbers(&message)));
        }
        assert_eq!(sent, [(1, vec![1]), (1, vec![1, 2]), (0, vec![1, 2]), (0, vec![2])]);
        assert_eq!(batch.spare.len(), 2, "their memory is used again");
    }

    #[test]
    fn of_too_many_frames_the_oldest_goes_and_is_lost_if_it_was_never_sent() {
        let (mut batch, mut message) = (Batch::default(), Vec::new());
        let lost: Vec<bool> = (1..=4).map(|number| batch.add(2, |frame| frame.push(number))).collect();
        assert_eq!(lost, [false, false, true, true]);
        assert_eq!((batch.take(&mut message), numbers(&message)), (Some(2), vec![3, 4]));
        assert!(!batch.add(2, |frame| frame.push(5)));
    }

    #[test]
    fn a_damaged_message_ends_early() {
        let (mut batch, mut message) = (Batch::default(), Vec::new());
        (1..=2).for_each(|number| _ = batch.add(8, |frame| frame.extend([number; 9])));
        batch.take(&mut message);
        assert_eq!(numbers(&message[..message.len() - 1]), [1]);
        assert_eq!(numbers(&[3, 0]), [0; 0]);
    }
}
