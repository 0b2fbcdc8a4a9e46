//! Numbers and checksums of SCIP 2.0: six bits per character.

/// The character of six zero bits.
const ZERO: u8 = 0x30;

/// The checksum of a line: the low six bits of the sum of its bytes, as a character.
pub fn checksum(line: &[u8]) -> u8 {
    let sum = line.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte));
    (sum & 0x3f) + ZERO
}

/// The line without its checksum, which is its last byte; `None` if that is wrong.
pub fn verified(line: &[u8]) -> Option<&[u8]> {
    let (sum, text) = line.split_last()?;
    (checksum(text) == *sum).then_some(text)
}

/// The number of some characters, most significant first; `None` for a character that codes no six bits.
pub fn decode(characters: &[u8]) -> Option<u32> {
    characters.iter().try_fold(0_u32, |value, character| append(value, *character))
}

/// A number with one more character.
#[inline]
pub(crate) fn append(value: u32, character: u8) -> Option<u32> {
    let bits = character.checked_sub(ZERO).filter(|bits| *bits < 64)?;
    Some(value << 6 | u32::from(bits))
}

/// The low 6 `N` bits of a number as characters.
pub fn encode<const N: usize>(value: u32) -> [u8; N] {
    std::array::from_fn(|index| (value >> (6 * (N - 1 - index)) & 0x3f) as u8 + ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_coded_as_in_the_examples_of_the_specification() {
        assert_eq!((decode(b"1Dh"), encode::<3>(5432)), (Some(5432), *b"1Dh"));
        assert_eq!((decode(b"m2@0"), encode::<4>(16_000_000)), (Some(16_000_000), *b"m2@0"));
        assert_eq!((decode(b"CB"), encode::<2>(1234)), (Some(1234), *b"CB"));
        assert_eq!((decode(b"0 1"), decode(b"0p"), decode(b"0/")), (None, None, None));
    }

    #[test]
    fn checksums_are_those_of_the_specification() {
        assert_eq!([b"00", b"99", b"02"].map(|status| checksum(status)), *b"PbR");
        assert_eq!((verified(b"00P"), verified(b"00Q"), verified(b"")), (Some(&b"00"[..]), None, None));
    }
}
