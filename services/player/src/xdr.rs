//! XDR, the encoding of numbers and arrays in Player's messages.
//!
//! All numbers are big-endian. Integers take four bytes, whatever their type. An array begins with its count, followed
//! by the length that XDR itself writes; both are equal.

/// Bytes that are no message of the expected kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Malformed {
    /// The payload ends too early.
    #[error("the payload ends {missing} bytes too early")]
    Short {
        /// How many bytes are missing.
        missing: usize,
    },
    /// The two lengths of an array differ.
    #[error("an array of {count} elements has the length {length}")]
    Lengths {
        /// The count before the array.
        count: u32,
        /// The length that XDR wrote.
        length: u32,
    },
    /// Bytes are left over.
    #[error("{0} bytes are left over")]
    Long(usize),
}

/// Reads a payload from its start to its end.
#[derive(Debug, Clone, Copy)]
pub struct XdrReader<'a> {
    bytes: &'a [u8],
}

impl<'a> XdrReader<'a> {
    /// A reader of a whole payload.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    /// The next `count` bytes.
    ///
    /// # Errors
    /// [`Malformed::Short`].
    pub fn take(&mut self, count: usize) -> Result<&'a [u8], Malformed> {
        let missing = count.saturating_sub(self.bytes.len());
        let (taken, rest) = self.bytes.split_at_checked(count).ok_or(Malformed::Short { missing })?;
        self.bytes = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        Ok(bytes)
    }

    /// An unsigned integer of any size.
    ///
    /// # Errors
    /// [`Malformed::Short`].
    pub fn u32(&mut self) -> Result<u32, Malformed> {
        self.array().map(u32::from_be_bytes)
    }

    /// A number of 32 bits.
    ///
    /// # Errors
    /// [`Malformed::Short`].
    pub fn f32(&mut self) -> Result<f64, Malformed> {
        self.array().map(|bytes| f64::from(f32::from_be_bytes(bytes)))
    }

    /// A number of 64 bits.
    ///
    /// # Errors
    /// [`Malformed::Short`].
    pub fn f64(&mut self) -> Result<f64, Malformed> {
        self.array().map(f64::from_be_bytes)
    }

    /// Several numbers of 64 bits.
    ///
    /// # Errors
    /// [`Malformed::Short`].
    pub fn f64s<const N: usize>(&mut self) -> Result<[f64; N], Malformed> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.f64()?;
        }
        Ok(numbers)
    }

    /// The bytes of an array whose elements take `size` bytes each, without padding.
    ///
    /// # Errors
    /// [`Malformed::Lengths`] and [`Malformed::Short`].
    pub fn elements(&mut self, size: usize) -> Result<&'a [u8], Malformed> {
        let (count, length) = (self.u32()?, self.u32()?);
        if count != length {
            return Err(Malformed::Lengths { count, length });
        }
        self.take((count as usize).saturating_mul(size))
    }

    /// An array of bytes, which is padded to four.
    ///
    /// # Errors
    /// As [`Self::elements`].
    pub fn text(&mut self) -> Result<&'a [u8], Malformed> {
        let bytes = self.elements(1)?;
        self.take(bytes.len().next_multiple_of(4) - bytes.len())?;
        Ok(bytes)
    }

    /// Passes when all bytes were read.
    ///
    /// # Errors
    /// [`Malformed::Long`].
    pub fn end(self) -> Result<(), Malformed> {
        if self.bytes.is_empty() { Ok(()) } else { Err(Malformed::Long(self.bytes.len())) }
    }
}

/// Appends an integer.
pub fn put_u32(bytes: &mut Vec<u8>, number: u32) {
    bytes.extend_from_slice(&number.to_be_bytes());
}

/// Appends numbers of 64 bits.
pub fn put_f64s(bytes: &mut Vec<u8>, numbers: &[f64]) {
    numbers.iter().for_each(|number| bytes.extend_from_slice(&number.to_be_bytes()));
}

/// Appends an array of bytes with both lengths and its padding.
pub fn put_text(bytes: &mut Vec<u8>, text: &[u8]) {
    put_u32(bytes, text.len() as u32);
    put_u32(bytes, text.len() as u32);
    bytes.extend_from_slice(text);
    bytes.extend(std::iter::repeat_n(0, text.len().next_multiple_of(4) - text.len()));
}

/// The numbers of an array, read where they are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Numbers<'a> {
    bytes: &'a [u8],
    /// Bytes of a number, 4 or 8.
    size: usize,
}

impl<'a> Numbers<'a> {
    /// Numbers of 64 bits.
    ///
    /// # Errors
    /// As [`XdrReader::elements`].
    pub fn f64s(reader: &mut XdrReader<'a>) -> Result<Self, Malformed> {
        Ok(Self { bytes: reader.elements(8)?, size: 8 })
    }

    /// Numbers of 32 bits.
    ///
    /// # Errors
    /// As [`XdrReader::elements`].
    pub fn f32s(reader: &mut XdrReader<'a>) -> Result<Self, Malformed> {
        Ok(Self { bytes: reader.elements(4)?, size: 4 })
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.bytes.len() / self.size
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// A number; NaN where there is none.
    pub fn get(&self, index: usize) -> f64 {
        let place = index.saturating_mul(self.size);
        let bytes = self.bytes.get(place..place.saturating_add(self.size)).unwrap_or_default();
        let mut reader = XdrReader::new(bytes);
        let number = if self.size == 4 { reader.f32() } else { reader.f64() };
        number.unwrap_or(f64::NAN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_padded_and_carries_its_length_twice() {
        let mut bytes = Vec::new();
        put_text(&mut bytes, b"stage\0");
        assert_eq!(bytes, *b"\0\0\0\x06\0\0\0\x06stage\0\0\0");
        let mut reader = XdrReader::new(&bytes);
        assert_eq!(reader.text(), Ok(&b"stage\0"[..]));
        assert_eq!(reader.end(), Ok(()));
    }

    #[test]
    fn wrong_lengths_are_told_apart() {
        let lengths = |count, length| {
            let mut bytes = Vec::new();
            put_u32(&mut bytes, count);
            put_u32(&mut bytes, length);
            put_f64s(&mut bytes, &[1.5]);
            Numbers::f64s(&mut XdrReader::new(&bytes)).map(|numbers| (numbers.len(), numbers.get(0)))
        };
        assert_eq!(lengths(1, 1), Ok((1, 1.5)));
        assert_eq!(lengths(1, 2), Err(Malformed::Lengths { count: 1, length: 2 }));
        assert_eq!(lengths(2, 2), Err(Malformed::Short { missing: 8 }));
        assert_eq!(
            lengths(u32::MAX, u32::MAX).map_err(|error| matches!(error, Malformed::Short { .. })),
            Err(true)
        );
        assert_eq!(XdrReader::new(&[0; 3]).end(), Err(Malformed::Long(3)));
    }

    #[test]
    fn a_number_that_is_not_there_is_no_number() {
        let bytes = [0, 0, 0, 1, 0, 0, 0, 1, 0x3f, 0x80, 0, 0];
        let numbers = Numbers::f32s(&mut XdrReader::new(&bytes)).unwrap();
        assert_eq!(numbers.get(0), 1.0);
        assert!(numbers.get(1).is_nan() && numbers.get(usize::MAX).is_nan());
    }
}
