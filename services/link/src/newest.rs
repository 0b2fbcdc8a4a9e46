//! Which samples of a topic are new: by incarnation and sequence number of their publisher.

use shared_types::MAX_LATE;

/// Publishers of one topic that are told apart: those in charge, standbys and those that are ending.
const PUBLISHERS: usize = 16;

/// What the number of a sample says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Arrival {
    /// It is the first of its publisher.
    First,
    /// It is newer than all before of its publisher; so many numbers between were never seen.
    New {
        /// Numbers that were skipped.
        missing: u64,
    },
    /// It is the newest one once more.
    Repeated,
    /// A newer one was there before.
    Older,
}

/// The newest sample of each publisher of one topic.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Newest {
    /// Incarnation and sequence number; incarnations grow.
    publishers: [(u32, u64); PUBLISHERS],
    /// Those of the last sample that came after a newer one.
    late: (u32, u64),
}

impl Newest {
    /// Takes in the number of a sample. The second in a row far below the newest shows that the newest was wrong, as for
    /// [`shared_types::InputAccount`].
    pub(crate) fn arrive(&mut self, incarnation: u32, sequence: u64) -> Arrival {
        if let Some((_, newest)) =
            self.publishers.iter_mut().find(|(of, number)| *of == incarnation && *number > 0)
        {
            return match sequence.cmp(newest) {
                std::cmp::Ordering::Less => {
                    let (of, before) = self.late;
                    let goes_on = of == incarnation && before < sequence && sequence - before <= MAX_LATE;
                    self.late = (incarnation, sequence);
                    if !goes_on || *newest - sequence <= MAX_LATE {
                        return Arrival::Older;
                    }
                    *newest = sequence;
                    Arrival::New { missing: 0 }
                }
                std::cmp::Ordering::Equal => Arrival::Repeated,
                std::cmp::Ordering::Greater => {
                    let missing = sequence - *newest - 1;
                    *newest = sequence;
                    Arrival::New { missing }
                }
            };
        }
        if let Some(oldest) = self.publishers.iter_mut().min() {
            *oldest = (incarnation, sequence);
        }
        Arrival::First
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_wrong_number_costs_two_samples() {
        let mut newest = Newest::default();
        let arrivals = [4, 5, 1 << 40, 7, 8, 9].map(|sequence| newest.arrive(3, sequence));
        let (jump, next) = (Arrival::New { missing: (1 << 40) - 6 }, Arrival::New { missing: 0 });
        assert_eq!(arrivals, [Arrival::First, next, jump, Arrival::Older, next, next]);
    }

    #[test]
    fn copies_are_recognised_and_older_ones_never_count() {
        let mut newest = Newest::default();
        let arrivals = [4, 4, 5, 8, 7, 8, 9].map(|sequence| newest.arrive(3, sequence));
        let new = |missing| Arrival::New { missing };
        assert_eq!(
            arrivals,
            [Arrival::First, Arrival::Repeated, new(0), new(2), Arrival::Older, Arrival::Repeated, new(0)]
        );
    }

    #[test]
    fn publishers_are_told_apart_and_the_oldest_is_forgotten() {
        let mut newest = Newest::default();
        for incarnation in 1..=17 {
            assert_eq!(newest.arrive(incarnation, 5), Arrival::First);
        }
        assert_eq!(newest.arrive(17, 5), Arrival::Repeated);
        assert_eq!(newest.arrive(2, 4), Arrival::Older);
        assert_eq!(newest.arrive(1, 5), Arrival::First, "it was forgotten");
    }

    /// Whatever the way does to three copies of each sample, each sample counts once at most and in order.
    #[test]
    fn any_order_of_copies_gives_rising_numbers() {
        let mut random = 11_u64;
        for _ in 0..2_000 {
            let mut newest = Newest::default();
            let (mut admitted, mut copies): (Vec<u64>, Vec<u64>) =
                (Vec::new(), (1..=9).flat_map(|n| [n; 3]).collect());
            for index in (1..copies.len()).rev() {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                copies.swap(index, (random >> 33) as usize % (index + 1));
            }
            let mut missing_sum = 0;
            for sequence in copies {
                match newest.arrive(1, sequence) {
                    Arrival::First => admitted.push(sequence),
                    Arrival::New { missing } => {
                        admitted.push(sequence);
                        missing_sum += missing;
                    }
                    Arrival::Repeated | Arrival::Older => {}
                }
            }
            assert!(admitted.windows(2).all(|pair| pair[0] < pair[1]), "{admitted:?}");
            let skipped = 9 - (admitted[0] - 1) - admitted.len() as u64;
            assert_eq!(missing_sum, skipped);
        }
    }
}
