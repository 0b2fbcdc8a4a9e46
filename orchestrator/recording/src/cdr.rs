//! Encodes and decodes messages as CDR, little endian.

use crate::schema::ENCAPSULATION;

/// A message that is being encoded. Each number stands at a multiple of its size, counted behind the encapsulation.
pub(crate) struct Cdr(Vec<u8>);

impl Cdr {
    pub(crate) fn new() -> Self {
        Self(ENCAPSULATION.to_vec())
    }

    pub(crate) fn finish(self) -> Vec<u8> {
        self.0
    }

    pub(crate) fn u8(&mut self, value: u8) -> &mut Self {
        self.0.push(value);
        self
    }

    pub(crate) fn u32(&mut self, value: u32) -> &mut Self {
        self.align(4);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub(crate) fn f32(&mut self, value: f32) -> &mut Self {
        self.u32(value.to_bits())
    }

    pub(crate) fn f64(&mut self, value: f64) -> &mut Self {
        self.align(8);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub(crate) fn numbers(&mut self, values: &[f64]) -> &mut Self {
        values.iter().for_each(|value| _ = self.f64(*value));
        self
    }

    /// The length of a sequence, in front of its elements.
    pub(crate) fn length(&mut self, length: usize) -> &mut Self {
        self.u32(length as u32)
    }

    /// A text, with the zero behind it that CDR asks for.
    pub(crate) fn text(&mut self, text: &str) -> &mut Self {
        self.length(text.len() + 1);
        self.0.extend(text.as_bytes());
        self.u8(0)
    }

    /// Seconds and nanoseconds.
    pub(crate) fn time(&mut self, time_ns: u64) -> &mut Self {
        self.u32((time_ns / 1_000_000_000) as u32).u32((time_ns % 1_000_000_000) as u32)
    }

    /// A position, and a rotation about the vertical axis as a quaternion.
    pub(crate) fn pose(&mut self, [x_m, y_m]: [f64; 2], z_m: f64, yaw_rad: f64) -> &mut Self {
        let (sin, cos) = (yaw_rad / 2.0).sin_cos();
        self.numbers(&[x_m, y_m, z_m]).numbers(&[0.0, 0.0, sin, cos])
    }

    fn align(&mut self, size: usize) {
        let length = (self.0.len() - ENCAPSULATION.len()).next_multiple_of(size) + ENCAPSULATION.len();
        self.0.resize(length, 0);
    }
}

/// A message that is being decoded.
pub(crate) struct Decoder<'a> {
    content: &'a [u8],
    at: usize,
}

impl<'a> Decoder<'a> {
    /// Of what follows the encapsulation.
    pub(crate) fn new(content: &'a [u8]) -> Self {
        Self { content, at: 0 }
    }

    pub(crate) fn u8(&mut self) -> Option<u8> {
        self.take(1).map(|bytes| bytes[0])
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.at = self.at.next_multiple_of(4);
        self.take(4)?.try_into().ok().map(u32::from_le_bytes)
    }

    pub(crate) fn text(&mut self) -> Option<&'a str> {
        let length = self.u32()? as usize;
        std::str::from_utf8(self.take(length)?.strip_suffix(b"\0")?).ok()
    }

    pub(crate) fn f32(&mut self) -> Option<f32> {
        self.u32().map(f32::from_bits)
    }

    pub(crate) fn f64(&mut self) -> Option<f64> {
        self.at = self.at.next_multiple_of(8);
        self.take(8)?.try_into().ok().map(f64::from_le_bytes)
    }

    /// So many numbers.
    pub(crate) fn numbers<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.f64()?;
        }
        Some(numbers)
    }

    /// A sequence of numbers; none that is longer than the message takes memory.
    pub(crate) fn f32s(&mut self) -> Option<Vec<f32>> {
        let length = self.u32()? as usize;
        let numbers = self.take(length.checked_mul(4)?)?.chunks_exact(4);
        Some(numbers.map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])).collect())
    }

    /// Seconds and nanoseconds.
    pub(crate) fn time(&mut self) -> Option<[u32; 2]> {
        Some([self.u32()?, self.u32()?])
    }

    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let bytes = self.content.get(self.at..self.at.checked_add(length)?)?;
        self.at += length;
        Some(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_aligned_behind_the_encapsulation() {
        let mut cdr = Cdr::new();
        cdr.text("ab").f64(1.0);
        assert_eq!(cdr.finish(), b"\0\x01\0\0\x03\0\0\0ab\0\0\0\0\0\0\0\0\xf0\x3f".to_vec());
    }

    #[test]
    fn what_was_encoded_is_decoded_and_a_cut_message_is_not() {
        let mut cdr = Cdr::new();
        cdr.time(7_000_000_009).u8(3).text("late").text("robot");
        let data = cdr.finish().split_off(ENCAPSULATION.len());
        let decode = |data: &[u8]| {
            let mut cdr = Decoder::new(data);
            Some((cdr.time()?, cdr.u8()?, cdr.text()?.to_owned(), cdr.text()?.to_owned()))
        };
        assert_eq!(decode(&data), Some(([7, 9], 3, "late".to_owned(), "robot".to_owned())));
        for length in 0..data.len() {
            assert_eq!(decode(&data[..length]), None);
        }
    }
}
