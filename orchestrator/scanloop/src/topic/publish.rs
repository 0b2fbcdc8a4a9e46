//! `scanloop topic pub`: a sample by hand, on a topic whose writer is the operator.

use std::time::Duration;

use console::answer;
use console::exit::Failure;
use runtime::{Bus, OPERATOR, OwnPublisher, OwnTopics};
use serde_json::{Map, Value};
use shared_types::{Field, Kind, Topic};

/// Readers make their end of the connection within this time, and take the sample: a process wakes ten times a second.
const READER_PAUSE: Duration = Duration::from_millis(250);

/// Publishes one sample with the fields of `json`; fields that it does not name are zero.
///
/// # Errors
/// A topic of the loop, a topic that a companion writes, a field or a value that does not fit; exit code 2.
pub(crate) fn publish(system_id: &str, topic: &str, json: &str) -> anyhow::Result<()> {
    if topic.parse::<Topic>().is_ok() {
        let message = format!("topic {topic} belongs to the loop: only the process of its role publishes it");
        return Err(Failure::bad_input(message));
    }
    let domain = supervision::runs::existing(system_id)?;
    let table = OwnTopics::of(&domain)?;
    let unknown =
        || Failure::bad_input(format!("unknown topic `{topic}`: system {system_id} does not have it"));
    let table = table.filter(|table| table.find(topic).is_some()).ok_or_else(unknown)?;
    if let Some(row) = table.find(topic).filter(|row| row.writer != OPERATOR) {
        let message = format!(
            "topic {topic} is written by companion {}: `topic pub` needs `writer = \"{OPERATOR}\"`",
            row.writer
        );
        return Err(Failure::bad_input(message));
    }
    let values: Map<String, Value> = serde_json::from_str(json)
        .map_err(|error| Failure::bad_input(format!("JSON = {json} is not allowed: an object, {error}")))?;
    let bus = Bus::open(&domain, OPERATOR)?;
    let publisher = OwnPublisher::new(&bus, &table, topic)?;
    let own = publisher.own_type();
    // Of words, so that the header in front is aligned.
    let mut words = vec![0_u64; own.size() / size_of::<u64>()];
    let sample: &mut [u8] = bytemuck::cast_slice_mut(&mut words);
    fill(own.fields(), &values, sample)
        .map_err(|reason| Failure::bad_input(format!("topic {topic}: {reason}")))?;
    std::thread::sleep(READER_PAUSE);
    publisher.publish(sample, std::process::id(), 1)?;
    std::thread::sleep(READER_PAUSE);
    answer!(false, "published on {topic}").map(drop)
}

/// Writes the values into a sample.
fn fill(fields: &[Field], values: &Map<String, Value>, sample: &mut [u8]) -> Result<(), String> {
    let own: Vec<&Field> = fields.iter().filter(|field| !matches!(field.kind, Kind::Struct(..))).collect();
    for (name, value) in values {
        let Some(field) = own.iter().find(|field| field.name == name) else {
            let names: Vec<&str> = own.iter().map(|field| field.name).collect();
            return Err(format!("{name} = {value} is not allowed: one of {}", names.join(", ")));
        };
        let place = &mut sample[field.offset..field.offset + field.kind.size()];
        let refuse = |allowed: String| format!("{name} = {value} is not allowed: {allowed}");
        match (&field.kind, value) {
            (Kind::Array(element, length), Value::Array(items)) => {
                if items.len() != *length {
                    return Err(refuse(format!("{length} values")));
                }
                for (place, item) in place.chunks_exact_mut(element.size()).zip(items) {
                    put(element, item, place).map_err(&refuse)?;
                }
            }
            (Kind::Array(_, length), _) => return Err(refuse(format!("a list of {length} values"))),
            (kind, value) => put(kind, value, place).map_err(&refuse)?,
        }
    }
    Ok(())
}

/// Writes one number; the error says what is allowed.
fn put(kind: &Kind, value: &Value, place: &mut [u8]) -> Result<(), String> {
    let Kind::Scalar(name) = kind else { return Err("a number".to_owned()) };
    if *name == "f64" {
        let number = value.as_f64().filter(|number| number.is_finite()).ok_or("a number")?;
        place.copy_from_slice(&number.to_ne_bytes());
        return Ok(());
    }
    let (low, high) = match *name {
        "u8" => (0, i128::from(u8::MAX)),
        "u16" => (0, i128::from(u16::MAX)),
        "u32" => (0, i128::from(u32::MAX)),
        "u64" => (0, i128::from(u64::MAX)),
        _ => (i128::from(i32::MIN), i128::from(i32::MAX)),
    };
    let number = value.as_u64().map(i128::from).or(value.as_i64().map(i128::from));
    let number = number.filter(|number| (low..=high).contains(number));
    let number = number.ok_or_else(|| format!("a whole number from {low} to {high}"))?;
    // Two's complement: the low bytes hold the number in each width.
    place.copy_from_slice(&number.to_le_bytes()[..place.len()]);
    Ok(())
}

#[cfg(test)]
mod tests {
    use shared_types::{OwnField, OwnType};

    use super::*;

    fn filled(json: &str) -> Result<Vec<u8>, String> {
        let field = |name, kind| OwnField { name, kind, doc: "" };
        let fields = [field("speed_mps", "f64"), field("pair", "i32[2]"), field("letters", "u8[8]")];
        let own = OwnType::new("Limit", &fields).unwrap();
        let mut sample = vec![0; own.size()];
        fill(own.fields(), &serde_json::from_str(json).unwrap(), &mut sample).map(|()| sample)
    }

    #[test]
    fn values_reach_their_fields() {
        let sample = filled("{\"speed_mps\": 0.5, \"pair\": [-1, 2]}").unwrap();
        assert_eq!(sample[288..296], 0.5_f64.to_ne_bytes());
        assert_eq!(
            (&sample[296..300], &sample[300..304]),
            (&(-1_i32).to_ne_bytes()[..], &2_i32.to_ne_bytes()[..])
        );
        assert!(sample[304..].iter().all(|byte| *byte == 0));
    }

    #[test]
    fn fields_and_values_that_do_not_fit_are_named() {
        let refused = |json| filled(json).unwrap_err();
        let unknown = refused("{\"speed\": 1}");
        assert_eq!(unknown, "speed = 1 is not allowed: one of speed_mps, pair, letters");
        assert_eq!(refused("{\"pair\": [1]}"), "pair = [1] is not allowed: 2 values");
        assert!(
            refused("{\"pair\": [1, 3000000000]}").ends_with("a whole number from -2147483648 to 2147483647")
        );
        assert!(refused("{\"speed_mps\": \"fast\"}").ends_with("is not allowed: a number"));
        assert!(refused("{\"letters\": 3}").ends_with("a list of 8 values"));
        assert!(refused("{\"header\": 3}").contains("is not allowed: one of"));
    }
}
