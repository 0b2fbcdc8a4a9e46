//! Samples without their zeros: most of the places for obstacles, plan nodes and state are unused.
//!
//! Bytes are cut into words of eight. For each 64 words a mask says which are not zero; these follow the mask. A
//! checkpoint of 13,016 bytes so becomes a few datagrams instead of a dozen, and what is not sent is neither
//! encrypted nor waits in front of a sample that drives.

/// Bytes of a word.
const WORD: usize = 8;
/// Words of one mask.
const WORDS: usize = 64;

/// Appends `bytes` without their zeros. Bytes beyond the last whole word are not packed.
pub(crate) fn pack(bytes: &[u8], packed: &mut Vec<u8>) {
    let (words, rest) = bytes.as_chunks::<WORD>();
    for block in words.chunks(WORDS) {
        let at = packed.len();
        packed.extend_from_slice(&[0; WORD]);
        let mut mask = 0_u64;
        for (bit, word) in block.iter().enumerate().filter(|(_, word)| **word != [0; WORD]) {
            mask |= 1 << bit;
            packed.extend_from_slice(word);
        }
        packed[at..at + WORD].copy_from_slice(&mask.to_le_bytes());
    }
    packed.extend_from_slice(rest);
}

/// Fills `bytes` with what was packed; `false` when it is not as much as they hold.
pub(crate) fn unpack(mut packed: &[u8], bytes: &mut [u8]) -> bool {
    let (words, rest) = bytes.as_chunks_mut::<WORD>();
    for block in words.chunks_mut(WORDS) {
        let Some((mask, others)) = packed.split_first_chunk::<WORD>() else { return false };
        packed = others;
        let mask = u64::from_le_bytes(*mask);
        if block.len() < WORDS && mask >> block.len() != 0 {
            return false;
        }
        for (bit, word) in block.iter_mut().enumerate() {
            if mask & (1 << bit) == 0 {
                *word = [0; WORD];
                continue;
            }
            let Some((next, others)) = packed.split_first_chunk::<WORD>() else { return false };
            (*word, packed) = (*next, others);
        }
    }
    if packed.len() == rest.len() {
        rest.copy_from_slice(packed);
    }
    packed.len() == rest.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes of which most words are zero, from a seed.
    fn sparse(length: usize, seed: u64) -> Vec<u8> {
        let mut random = seed;
        let mut next = move || {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (random >> 56) as u8
        };
        let mut bytes = vec![0; length];
        for word in bytes.chunks_mut(WORD) {
            if next() < 60 {
                word.iter_mut().for_each(|byte| *byte = next());
            }
        }
        bytes
    }

    #[test]
    fn what_was_packed_is_unpacked_to_the_same_bytes() {
        for (seed, length) in (0..200).zip([0, 5, 8, 64, 512, 520, 1576, 13016].into_iter().cycle()) {
            let bytes = sparse(length, seed);
            let (mut packed, mut unpacked) = (vec![9], vec![7; length]);
            pack(&bytes, &mut packed);
            assert!(unpack(&packed[1..], &mut unpacked));
            assert_eq!(unpacked, bytes);
        }
    }

    #[test]
    fn zeros_cost_one_bit_in_64() {
        let mut packed = Vec::new();
        pack(&[0; 12_800], &mut packed);
        assert_eq!(packed.len(), 12_800 / 64);
        packed.clear();
        pack(&[1; 1024], &mut packed);
        assert_eq!(packed.len(), 1024 + 2 * 8);
    }

    #[test]
    fn too_few_and_too_many_bytes_are_refused() {
        let (mut packed, mut bytes) = (Vec::new(), [0; 256]);
        pack(&[3; 256], &mut packed);
        for end in 0..packed.len() {
            assert!(!unpack(&packed[..end], &mut bytes), "{end}");
        }
        packed.push(0);
        assert!(!unpack(&packed, &mut bytes));
        assert!(!unpack(&[0xff; 8 * 65], &mut bytes), "a mask of more words than there are");
    }
}
