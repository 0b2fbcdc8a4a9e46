//! Reads the fields of a record one after the other.

use std::borrow::Cow;

use super::Damage;

/// The rest of a record.
pub(super) struct Fields<'a>(pub(super) &'a [u8]);

impl<'a> Fields<'a> {
    pub(super) fn take(&mut self, length: usize) -> Result<&'a [u8], Damage> {
        let (taken, rest) = self.0.split_at_checked(length).ok_or(Damage::Short)?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Damage> {
        self.take(N)?.try_into().map_err(|_| Damage::Short)
    }

    pub(super) fn u8(&mut self) -> Result<u8, Damage> {
        self.array().map(u8::from_le_bytes)
    }

    pub(super) fn u16(&mut self) -> Result<u16, Damage> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, Damage> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Result<u64, Damage> {
        self.array().map(u64::from_le_bytes)
    }

    pub(super) fn str(&mut self) -> Result<Cow<'a, str>, Damage> {
        let length = self.u32()?;
        Ok(String::from_utf8_lossy(self.take(length as usize)?))
    }

    pub(super) fn text(&mut self) -> Result<String, Damage> {
        self.str().map(Cow::into_owned)
    }

    pub(super) fn map(&mut self) -> Result<Vec<(String, String)>, Damage> {
        let length = self.u32()?;
        let mut fields = Fields(self.take(length as usize)?);
        let mut map = Vec::new();
        while !fields.0.is_empty() {
            map.push((fields.text()?, fields.text()?));
        }
        Ok(map)
    }
}
