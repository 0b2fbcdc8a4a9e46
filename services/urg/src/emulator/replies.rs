//! Texts and data of the replies.

use crate::coding::{checksum, encode};
use crate::command::{Coding, Measurement};
use crate::model::SensorParameters;
use crate::status::ScipStatus;

/// Characters of a line of ranges.
const LINE: usize = 64;

/// The parameters of the recorded device.
pub(crate) fn urg_04lx() -> SensorParameters {
    SensorParameters {
        model: "URG-04LX(emulated)".to_owned(),
        min_mm: 20,
        max_mm: 5600,
        steps: 1024,
        first: 44,
        last: 725,
        front: 384,
        rpm: 600,
    }
}

/// Those of a model with 40 scans per second, a quarter of a degree apart.
pub(crate) fn ust_10lx() -> SensorParameters {
    SensorParameters {
        model: "UST-10LX(emulated)".to_owned(),
        min_mm: 20,
        max_mm: 30_000,
        steps: 1440,
        first: 0,
        last: 1080,
        front: 540,
        rpm: 2400,
    }
}

/// Appends a whole reply.
pub(crate) fn append(output: &mut Vec<u8>, echo: &[u8], status: ScipStatus, lines: &[u8]) {
    output.extend(echo);
    output.push(b'\n');
    append_line(output, &status.0);
    output.extend(lines);
    output.push(b'\n');
}

fn append_line(output: &mut Vec<u8>, text: &[u8]) {
    output.extend(text);
    output.extend([checksum(text), b'\n']);
}

/// Lines `KEY:value;S`; the semicolon is not part of the sum.
fn lines(fields: &[(&str, String)]) -> Vec<u8> {
    let mut output = Vec::new();
    for (key, value) in fields {
        let text = format!("{key}:{value}");
        output.extend(text.as_bytes());
        output.extend([b';', checksum(text.as_bytes()), b'\n']);
    }
    output
}

pub(crate) fn version() -> Vec<u8> {
    let fields = [
        ("VEND", "emulated"),
        ("PROD", "SCIP emulator"),
        ("FIRM", "0.1"),
        ("PROT", "SCIP 2.0"),
        ("SERI", "E0000001"),
    ];
    lines(&fields.map(|(key, value)| (key, value.to_owned())))
}

pub(crate) fn parameters(parameters: &SensorParameters) -> Vec<u8> {
    let SensorParameters { model, min_mm, max_mm, steps, first, last, front, rpm } = parameters;
    lines(&[
        ("MODL", model.clone()),
        ("DMIN", min_mm.to_string()),
        ("DMAX", max_mm.to_string()),
        ("ARES", steps.to_string()),
        ("AMIN", first.to_string()),
        ("AMAX", last.to_string()),
        ("AFRT", front.to_string()),
        ("SCAN", rpm.to_string()),
    ])
}

pub(crate) fn state(
    parameters: &SensorParameters,
    is_laser_on: bool,
    measures: bool,
    stamp_ms: u32,
) -> Vec<u8> {
    lines(&[
        ("MODL", parameters.model.clone()),
        ("LASR", if is_laser_on { "ON" } else { "OFF" }.to_owned()),
        ("SCSP", format!("Initial({}[rpm])", parameters.rpm)),
        ("MESM", if measures { "Measuring" } else { "IDLE" }.to_owned()),
        ("SBPS", "115200[bps]".to_owned()),
        ("TIME", format!("{stamp_ms:06X}")),
        ("STAT", "Sensor works well.".to_owned()),
    ])
}

/// A line with a number of four characters.
pub(crate) fn number(value: u32) -> Vec<u8> {
    let mut output = Vec::new();
    append_line(&mut output, &encode::<4>(value));
    output
}

/// The lines of a scan: stamp and ranges.
pub(crate) fn scan(steps: &[u32], measurement: &Measurement, stamp_ms: u32) -> Vec<u8> {
    let mut characters = Vec::new();
    for group in steps.chunks(usize::from(measurement.cluster.max(1))) {
        let range = group.iter().min().copied().unwrap_or(0);
        match measurement.coding {
            Coding::Three => characters.extend(encode::<3>(range)),
            Coding::Two => characters.extend(encode::<2>(range.min(4095))),
        }
    }
    let mut output = number(stamp_ms);
    characters.chunks(LINE).for_each(|line| append_line(&mut output, line));
    output
}
