//! Compares two samples byte for byte, but for what depends on the clock and on the process.

use serde::Serialize;
use shared_types::{Field, Kind, Role, Sample, Topic};

/// Fields that are not compared, by topic: stamps of the own stage, durations, and the identity of the process.
///
/// `chain` stands for the stamps of the role that writes the topic; those of the stages before it are compared.
pub const NOT_COMPARED: [(Topic, &[&str]); 7] = [
    (Topic::Scan, &["header.layout", "header.incarnation", "header.sequence", "chain"]),
    (Topic::Odometry, &["header.layout", "header.incarnation", "header.sequence", "chain"]),
    (Topic::Truth, &["header.layout", "header.incarnation", "header.sequence", "chain"]),
    (Topic::Pose, &["header.layout", "header.incarnation", "header.sequence", "chain"]),
    (Topic::Obstacles, &["header.layout", "header.incarnation", "header.sequence", "chain"]),
    (Topic::Command, &["header.layout", "header.incarnation", "header.sequence", "chain", "solve_ns"]),
    (Topic::Actuation, &["header.layout", "header.incarnation", "header.sequence", "chain"]),
];

/// The first field in which a replayed sample differs from the recorded one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FieldDifference {
    /// The topic.
    pub topic: &'static str,
    /// The scan.
    pub scan: u64,
    /// The field, `plan.3.x_m`.
    pub field: String,
    /// Its recorded value.
    pub recorded: String,
    /// Its replayed value.
    pub replayed: String,
}

impl std::fmt::Display for FieldDifference {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { topic, scan, field, recorded, replayed } = self;
        write!(formatter, "scan {scan}, {topic}: {field} was {recorded}, is {replayed}")
    }
}

impl FieldDifference {
    /// There is no output where one was recorded.
    pub(crate) fn missing<S: Sample>(recorded: &S) -> Self {
        let scan = recorded.header().scan_id;
        let [field, recorded, replayed] = ["sample", "valid", "none"].map(str::to_owned);
        Self { topic: S::TOPIC.name(), scan, field, recorded, replayed }
    }
}

/// The first difference of an output of a role to the recorded one, but for what is not compared.
pub(crate) fn difference_to<S: Sample>(recorded: &S, mut replayed: S, role: Role) -> Option<FieldDifference> {
    take_over(recorded, &mut replayed, role);
    difference(recorded, &replayed)
}

/// Gives `replayed` what is not compared from `recorded`.
pub(crate) fn take_over<S: Sample>(recorded: &S, replayed: &mut S, role: Role) {
    let (from, to) = (recorded.header(), replayed.header_mut());
    (to.layout, to.incarnation, to.sequence) = (from.layout, from.incarnation, from.sequence);
    to.chain[role.index()] = from.chain[role.index()];
    let names = NOT_COMPARED.iter().filter(|(topic, _)| *topic == S::TOPIC).flat_map(|(_, names)| *names);
    for field in names.filter_map(|name| S::FIELDS.iter().find(|field| field.name == *name)) {
        let place = field.offset..field.offset + field.kind.size();
        bytemuck::bytes_of_mut(replayed)[place.clone()].copy_from_slice(&bytemuck::bytes_of(recorded)[place]);
    }
}

/// The first difference; `None` for equal bytes.
pub(crate) fn difference<S: Sample>(recorded: &S, replayed: &S) -> Option<FieldDifference> {
    let (one, other) = (bytemuck::bytes_of(recorded), bytemuck::bytes_of(replayed));
    if one == other {
        return None;
    }
    let (field, recorded_value, replayed_value) = first(S::FIELDS, "", one, other)?;
    Some(FieldDifference {
        topic: S::TOPIC.name(),
        scan: recorded.header().scan_id,
        field,
        recorded: recorded_value,
        replayed: replayed_value,
    })
}

fn first(fields: &[Field], around: &str, one: &[u8], other: &[u8]) -> Option<(String, String, String)> {
    fields.iter().find_map(|field| {
        let name = format!("{around}{}", field.name);
        of_kind(&field.kind, name, &one[field.offset..], &other[field.offset..])
    })
}

fn of_kind(kind: &Kind, name: String, one: &[u8], other: &[u8]) -> Option<(String, String, String)> {
    let size = kind.size();
    if one[..size] == other[..size] {
        return None;
    }
    match kind {
        Kind::Struct(_, fields) => first(fields, &format!("{name}."), one, other),
        Kind::Array(element, length) => (0..*length).find_map(|index| {
            let at = index * element.size();
            of_kind(element, format!("{name}.{index}"), &one[at..], &other[at..])
        }),
        Kind::Scalar(scalar) => {
            let [was, is] = [one, other].map(|bytes| recording::export::number(scalar, bytes));
            Some((name, was, is))
        }
    }
}

#[cfg(test)]
mod tests {
    use shared_types::{Actuation, Command, Obstacles, Odometry, Pose, Scan, Truth};

    use super::*;

    /// The bytes in which a flipped bit is not found, of all bits of a sample.
    fn blind_bytes<S: Sample>(role: Role) -> Vec<usize> {
        let recorded = S::zeroed();
        let is_found = |byte: usize, bit: u32| {
            let mut flipped = recorded;
            bytemuck::bytes_of_mut(&mut flipped)[byte] ^= 1 << bit;
            take_over(&recorded, &mut flipped, role);
            difference(&recorded, &flipped).is_some()
        };
        (0..size_of::<S>()).filter(|byte| (0..8).any(|bit| !is_found(*byte, bit))).collect()
    }

    #[test]
    fn every_flipped_bit_of_a_compared_field_of_every_output_is_found() {
        // Layout, incarnation, sequence, the four stamps of one stage.
        let header = 4 + 4 + 8 + 32;
        for (topic, blind, more) in [
            (Topic::Scan, blind_bytes::<Scan>(Role::Robot), 0),
            (Topic::Odometry, blind_bytes::<Odometry>(Role::Robot), 0),
            (Topic::Truth, blind_bytes::<Truth>(Role::Robot), 0),
            (Topic::Pose, blind_bytes::<Pose>(Role::Estimator), 0),
            (Topic::Obstacles, blind_bytes::<Obstacles>(Role::Obstacles), 0),
            // The time of the solution.
            (Topic::Command, blind_bytes::<Command>(Role::Controller), 8),
            (Topic::Actuation, blind_bytes::<Actuation>(Role::Actuator), 0),
        ] {
            assert_eq!(blind.len(), header + more, "{topic}: {blind:?}");
        }
    }

    #[test]
    fn the_first_difference_is_named() {
        let recorded = Pose { x_m: 1.5, ..Pose::default() };
        let mut replayed = recorded;
        replayed.covariance[4] = 0.25;
        let found = difference(&recorded, &replayed).unwrap();
        assert_eq!(found.to_string(), "scan 0, pose: covariance.4 was 0, is 0.25");
    }

    #[test]
    fn what_is_not_compared_is_stamps_durations_and_the_process() {
        for (topic, fields) in NOT_COMPARED {
            assert!(topic.writer().is_some());
            for field in fields {
                let is_clock = *field == "chain" || field.ends_with("_ns");
                let is_process = ["header.layout", "header.incarnation", "header.sequence"].contains(field);
                assert!(is_clock || is_process, "{topic} {field}");
            }
        }
    }
}
