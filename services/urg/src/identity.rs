//! What a scanner tells about itself.

use crate::model::{SensorParameters, fields};

/// Replies to the questions of the start.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScannerIdentity {
    /// Lines of `VV`: vendor, product, firmware, protocol, serial number.
    pub version: Vec<u8>,
    /// Lines of `II`: state of laser, motor and line.
    pub state: Vec<u8>,
    /// Parameters of the model, from `PP`.
    pub parameters: Option<SensorParameters>,
}

impl ScannerIdentity {
    /// All keys and values of `VV` and `II`, in their order.
    pub fn lines(&self) -> impl Iterator<Item = (String, String)> {
        fields(&self.version).chain(fields(&self.state))
    }

    /// The value of one key, such as `SERI`.
    pub fn value(&self, key: &str) -> Option<String> {
        self.lines().find(|(name, _)| name == key).map(|(_, value)| value)
    }
}
