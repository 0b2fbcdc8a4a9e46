//! Identification and parameters of a scanner.

use std::f64::consts::TAU;

use shared_types::{ScanGeometry, WINDOW};

use crate::UrgError;
use crate::coding::checksum;

/// The rate of a scanner may differ by this fraction from that of the system.
const RATE_TOLERANCE: f64 = 0.05;

/// The parameters of a model, from the reply to `PP`.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorParameters {
    /// Name of the model.
    pub model: String,
    /// Shortest range; smaller values are error codes [mm].
    pub min_mm: u32,
    /// Longest range [mm].
    pub max_mm: u32,
    /// Steps of a full turn.
    pub steps: u32,
    /// First step that is measured.
    pub first: u32,
    /// Last step that is measured.
    pub last: u32,
    /// The step that looks straight ahead.
    pub front: u32,
    /// Turns per minute.
    pub rpm: u32,
}

impl SensorParameters {
    /// Reads the lines of a reply to `PP`.
    ///
    /// # Errors
    /// A line that is missing, is no number, or has an impossible value.
    pub fn of_text(text: &[u8]) -> Result<Self, UrgError> {
        let lines: Vec<(String, String)> = fields(text).collect();
        let number = |key: &'static str, allowed: std::ops::RangeInclusive<u32>| {
            let value = lines.iter().find(|(name, _)| name == key).map(|(_, value)| value.as_str());
            let parsed = value.and_then(|value| value.trim().parse().ok());
            parsed.filter(|value| allowed.contains(value)).ok_or_else(|| UrgError::Parameter {
                key,
                value: value.unwrap_or("nothing").to_owned(),
                allowed: format!("{} to {}", allowed.start(), allowed.end()),
            })
        };
        let steps = number("ARES", 16..=100_000)?;
        let last = number("AMAX", 1..=9999)?;
        let model = lines.iter().find(|(name, _)| name == "MODL").map(|(_, value)| value.clone());
        Ok(Self {
            model: model.unwrap_or_else(|| "unknown model".to_owned()),
            min_mm: number("DMIN", 0..=10_000)?,
            max_mm: number("DMAX", 100..=262_143)?,
            steps,
            first: number("AMIN", 0..=last - 1)?,
            last,
            front: number("AFRT", 0..=9999)?,
            rpm: number("SCAN", 1..=60_000)?,
        })
    }

    /// Angle of a step from straight ahead, counter-clockwise [rad].
    pub fn yaw_rad(&self, step: f64) -> f64 {
        (step - f64::from(self.front)) * TAU / f64::from(self.steps)
    }

    /// Duration of a turn [ns].
    pub fn turn_ns(&self) -> u64 {
        60_000_000_000 / u64::from(self.rpm)
    }

    /// Time from the stamp of a scan, which is taken at step 0, to a step [ns].
    pub fn step_ns(&self, step: u32) -> u64 {
        self.turn_ns() * u64::from(step) / u64::from(self.steps)
    }

    /// Scans per second, when `skip` scans are left out after each one.
    pub fn rate_hz(&self, skip: u8) -> f64 {
        f64::from(self.rpm) / 60.0 / f64::from(skip + 1)
    }

    /// First and last step that these beams need and the scanner measures.
    pub fn steps_of_beams(&self, beams: &ScanGeometry) -> (u16, u16) {
        let step = |beam: usize| f64::from(self.front) + beams.yaw_rad(beam) * f64::from(self.steps) / TAU;
        let first = step(0).round().max(f64::from(self.first));
        (first as u16, step(beams.count - 1).round().min(f64::from(self.last)) as u16)
    }

    /// Passes when the scanner sees all that the stages analyse, as often as they expect it.
    ///
    /// # Errors
    /// The value that does not fit, and what is allowed.
    pub fn require_fit(&self, rate_hz: Option<f64>, skip: u8) -> Result<(), UrgError> {
        let half_step = std::f64::consts::PI / f64::from(self.steps);
        let [right, left] = [self.first, self.last].map(|step| self.yaw_rad(f64::from(step)));
        let [window_right, window_left] =
            [*WINDOW.start(), *WINDOW.end()].map(|beam| ScanGeometry::URG_04LX.yaw_rad(beam));
        if right > window_right + half_step || left < window_left - half_step {
            return Err(UrgError::Coverage {
                model: self.model.clone(),
                right_deg: right.to_degrees(),
                left_deg: left.to_degrees(),
                allowed_right_deg: window_right.to_degrees(),
                allowed_left_deg: window_left.to_degrees(),
            });
        }
        let Some(rate_hz) = rate_hz else { return Ok(()) };
        let (low_hz, high_hz) = (rate_hz * (1.0 - RATE_TOLERANCE), rate_hz * (1.0 + RATE_TOLERANCE));
        let scanner_hz = self.rate_hz(skip);
        if !(low_hz..=high_hz).contains(&scanner_hz) {
            return Err(UrgError::Rate { model: self.model.clone(), scanner_hz, low_hz, high_hz, rate_hz });
        }
        Ok(())
    }
}

/// Whether the checksums of all lines `KEY:value;S` are right.
pub(crate) fn has_valid_sums(text: &[u8]) -> bool {
    let mut lines = text.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
    lines.all(|line| matches!(line, [text @ .., b';', sum] if checksum(text) == *sum))
}

/// Keys and values of the lines `KEY:value;S` of a reply, without control characters. Lines of another form are left
/// out, and checksums are not verified: some models send wrong ones.
pub fn fields(text: &[u8]) -> impl Iterator<Item = (String, String)> {
    text.split(|byte| *byte == b'\n').filter_map(|line| {
        let line = match line {
            // The checksum may be a semicolon, too.
            [text @ .., b';', _] => text,
            _ => line.iter().rposition(|byte| *byte == b';').map_or(line, |end| &line[..end]),
        };
        let colon = line.iter().position(|byte| *byte == b':')?;
        let readable = |bytes: &[u8]| -> String {
            bytes.iter().filter(|byte| (b' '..=b'~').contains(*byte)).map(|byte| *byte as char).collect()
        };
        Some((readable(&line[..colon]), readable(&line[colon + 1..])))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const URG_04LX: &[u8] = b"MODL:URG-04LX(emulated);[\nDMIN:20;4\nDMAX:5600;_\nARES:1024;\\\nAMIN:44;7\nAMAX:725;o\nAFRT:384;6\nSCAN:600;e\n";

    #[test]
    fn a_checksum_may_be_any_of_its_letters_and_a_value_may_have_semicolons() {
        let sums: Vec<u8> = (44..=625)
            .map(|step| {
                let line = format!("AMAX:{step}");
                let sum = checksum(line.as_bytes());
                let text = [line.as_bytes(), &[b';', sum, b'\n']].concat();
                let found: Vec<_> = fields(&text).collect();
                assert_eq!(found, [("AMAX".to_owned(), step.to_string())], "{}", text.escape_ascii());
                assert!(has_valid_sums(&text));
                sum
            })
            .collect();
        assert!(sums.contains(&b';'));
        for (text, value) in
            [("FIRM:1;2;;", "1;2"), ("FIRM:1;2;x", "1;2"), ("FIRM:12;", "12"), ("FIRM:12", "12")]
        {
            let found: Vec<_> = fields(text.as_bytes()).collect();
            assert_eq!(found, [("FIRM".to_owned(), value.to_owned())], "{text}");
        }
    }

    #[test]
    fn the_parameters_of_the_usual_model_fit() {
        let parameters = SensorParameters::of_text(URG_04LX).unwrap();
        assert_eq!((parameters.first, parameters.last, parameters.front), (44, 725, 384));
        assert_eq!((parameters.turn_ns(), parameters.step_ns(384)), (100_000_000, 37_500_000));
        parameters.require_fit(Some(10.0), 0).unwrap();
        parameters.require_fit(Some(10.5), 0).unwrap();
    }

    #[test]
    fn a_model_that_does_not_fit_is_refused_with_value_and_range() {
        let parameters = SensorParameters::of_text(URG_04LX).unwrap();
        let refused = |parameters: &SensorParameters, rate_hz, skip| {
            parameters.require_fit(Some(rate_hz), skip).unwrap_err().to_string()
        };
        assert_eq!(
            refused(&parameters, 20.0, 0),
            "URG-04LX(emulated) measures 10.00 scans a second; rate_hz = 20 allows 19.00 to 21.00"
        );
        assert_eq!(
            refused(&parameters, 10.0, 1),
            "URG-04LX(emulated) measures 5.00 scans a second; rate_hz = 10 allows 9.50 to 10.50"
        );
        let narrow = SensorParameters { first: 215, ..parameters };
        assert_eq!(
            refused(&narrow, 10.0, 0),
            "URG-04LX(emulated) measures from -59.4 to 119.9 deg; at least -59.8 to 60.1 deg are allowed"
        );
    }

    #[test]
    fn a_wrong_digit_is_seen_by_its_checksum() {
        assert!(has_valid_sums(URG_04LX));
        for at in (0..URG_04LX.len()).filter(|at| URG_04LX[*at].is_ascii_digit()) {
            let mut text = URG_04LX.to_vec();
            text[at] ^= 1;
            assert!(!has_valid_sums(&text), "{}", String::from_utf8_lossy(&text));
        }
    }

    #[test]
    fn an_impossible_parameter_is_named() {
        for (line, message) in [
            ("AMIN:44;7", "PP of the scanner: AMIN = 900 is not allowed: 0 to 724"),
            ("ARES:1024;\\", "PP of the scanner: ARES = 900x is not allowed: 16 to 100000"),
        ] {
            let value = if line.starts_with("AMIN") { "AMIN:900;7" } else { "ARES:900x;7" };
            let text = String::from_utf8(URG_04LX.to_vec()).unwrap().replace(line, value);
            assert_eq!(SensorParameters::of_text(text.as_bytes()).unwrap_err().to_string(), message);
        }
    }
}
