//! Points in time within samples: what a sample needs when it goes to a host with another clock.

use crate::SampleType;
use crate::describe::{Field, Kind};

/// Fields that hold a point in time of the clock of their host; zero means that it is not known.
const TIMES: [&str; 11] = [
    "woken_ns",
    "taken_ns",
    "computed_ns",
    "published_ns",
    "acquired_ns",
    "issued_ns",
    "looked_ns",
    "since_ns",
    "predicted_ns",
    "plan_start_ns",
    "given_ns",
];

/// The same in the state of a checkpoint, in addition.
const STATE_TIMES: [&str; 11] = [
    "actuated_ns",
    "own_block_ns",
    "from_ns",
    "valid_ns",
    "told_ns",
    "started_ns",
    "rested_ns",
    "origin_ns",
    "rolls_until_ns",
    "seen_ns",
    "moved_ns",
];

/// Moves all points in time of a sample by `by_ns`, except those that are zero. The state in a checkpoint is bytes and
/// stays as it is.
///
/// # Panics
/// When the bytes are fewer than those of the type.
pub fn shift_times(of: &SampleType, sample: &mut [u8], by_ns: i64) {
    shift_fields(of.fields, sample, &is_time, by_ns);
}

/// Moves all points in time of the state in a checkpoint by `by_ns`, except those that are zero.
///
/// # Panics
/// When the bytes are fewer than those of the type.
pub fn shift_state(of: &Kind, state: &mut [u8], by_ns: i64) {
    if let Kind::Struct(_, fields) = of {
        shift_fields(fields, state, &is_state_time, by_ns);
    }
}

/// Whether a field of a sample of this name is a point in time.
fn is_time(name: &str) -> bool {
    TIMES.contains(&name)
}

/// Whether a field of a state of this name is a point in time of the clock of its host.
pub fn is_state_time(name: &str) -> bool {
    is_time(name) || STATE_TIMES.contains(&name)
}

fn shift_fields(fields: &[Field], bytes: &mut [u8], is_time: &impl Fn(&str) -> bool, by_ns: i64) {
    for field in fields {
        match field.kind {
            Kind::Scalar("u64") if is_time(field.name) => shift(&mut bytes[field.offset..], by_ns),
            Kind::Struct(_, inner) => shift_fields(inner, &mut bytes[field.offset..], is_time, by_ns),
            Kind::Array(element @ Kind::Struct(_, inner), count) => {
                for index in 0..count {
                    let start = field.offset + index * element.size();
                    shift_fields(inner, &mut bytes[start..], is_time, by_ns);
                }
            }
            Kind::Scalar(_) | Kind::Array(..) => {}
        }
    }
}

fn shift(bytes: &mut [u8], by_ns: i64) {
    let Some(time) = bytes.first_chunk_mut::<8>() else { return };
    let before = u64::from_ne_bytes(*time);
    if before != 0 {
        // Never zero, which would mean unknown.
        *time = before.saturating_add_signed(by_ns).max(1).to_ne_bytes();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Heartbeat, Pose, Role, Sample, TOPICS};

    /// Fields that end with `_ns` and hold no point in time, or one of a clock that they name.
    const SPANS: [&str; 7] =
        ["solve_ns", "sweep_ns", "period_ns", "bound_ns", "common_ns", "host_ns", "saved_ns"];

    fn names(fields: &[Field], found: &mut Vec<&'static str>) {
        for field in fields {
            match field.kind {
                Kind::Struct(_, inner) => names(inner, found),
                Kind::Array(Kind::Struct(_, inner), _) => names(inner, found),
                _ => found.push(field.name),
            }
        }
    }

    #[test]
    fn every_field_in_nanoseconds_is_a_point_in_time_or_a_span() {
        let mut found = Vec::new();
        TOPICS.iter().for_each(|topic| names(topic.fields(), &mut found));
        for name in found.iter().filter(|name| name.ends_with("_ns")) {
            assert!(TIMES.contains(name) != SPANS.contains(name), "{name}");
        }
        assert!(TIMES.iter().chain(&SPANS).all(|name| found.contains(name)));
    }

    #[test]
    fn all_times_of_a_sample_move_and_moving_back_gives_the_same_bytes() {
        let mut pose = Pose { predicted_ns: 5_000, yaw_rad: 0.5, ..Pose::default() };
        pose.header.acquired_ns = 1_000;
        pose.header.stage_mut(Role::Estimator).computed_ns = 3_000;
        let before = pose;
        shift_times(Pose::TYPE, bytemuck::bytes_of_mut(&mut pose), -900);
        assert_eq!((pose.header.acquired_ns, pose.predicted_ns, pose.yaw_rad), (100, 4_100, 0.5));
        let stage = pose.header.stage(Role::Estimator);
        assert_eq!((stage.computed_ns, stage.woken_ns), (2_100, 0), "what is not known stays unknown");
        shift_times(Pose::TYPE, bytemuck::bytes_of_mut(&mut pose), 900);
        assert_eq!(bytemuck::bytes_of(&pose), bytemuck::bytes_of(&before));
        let mut heartbeat = Heartbeat { issued_ns: 7, ..Heartbeat::default() };
        heartbeat.device.since_ns = 9;
        shift_times(Heartbeat::TYPE, bytemuck::bytes_of_mut(&mut heartbeat), 86_400_000_000_000);
        assert_eq!(
            (heartbeat.issued_ns, heartbeat.device.since_ns),
            (86_400_000_000_007, 86_400_000_000_009)
        );
    }
}
