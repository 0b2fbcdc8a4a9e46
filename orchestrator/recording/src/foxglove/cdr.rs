//! Encodes messages as CDR, little endian.

use crate::schema::ENCAPSULATION;

/// A message that is being encoded. Each number stands at a multiple of its size, counted behind the encapsulation.
pub(super) struct Cdr(Vec<u8>);

impl Cdr {
    pub(super) fn new() -> Self {
        Self(ENCAPSULATION.to_vec())
    }

    pub(super) fn finish(self) -> Vec<u8> {
        self.0
    }

    pub(super) fn u8(&mut self, value: u8) -> &mut Self {
        self.0.push(value);
        self
    }

    pub(super) fn u32(&mut self, value: u32) -> &mut Self {
        self.align(4);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub(super) fn f64(&mut self, value: f64) -> &mut Self {
        self.align(8);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub(super) fn numbers(&mut self, values: &[f64]) -> &mut Self {
        values.iter().for_each(|value| _ = self.f64(*value));
        self
    }

    /// The length of a sequence, in front of its elements.
    pub(super) fn length(&mut self, length: usize) -> &mut Self {
        self.u32(length as u32)
    }

    /// A text, with the zero behind it that CDR asks for.
    pub(super) fn text(&mut self, text: &str) -> &mut Self {
        self.length(text.len() + 1);
        self.0.extend(text.as_bytes());
        self.u8(0)
    }

    /// Seconds and nanoseconds.
    pub(super) fn time(&mut self, time_ns: u64) -> &mut Self {
        self.u32((time_ns / 1_000_000_000) as u32).u32((time_ns % 1_000_000_000) as u32)
    }

    /// A position, and a rotation about the vertical axis as a quaternion.
    pub(super) fn pose(&mut self, [x_m, y_m]: [f64; 2], z_m: f64, yaw_rad: f64) -> &mut Self {
        let (sin, cos) = (yaw_rad / 2.0).sin_cos();
        self.numbers(&[x_m, y_m, z_m]).numbers(&[0.0, 0.0, sin, cos])
    }

    fn align(&mut self, size: usize) {
        let length = (self.0.len() - ENCAPSULATION.len()).next_multiple_of(size) + ENCAPSULATION.len();
        self.0.resize(length, 0);
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
}
