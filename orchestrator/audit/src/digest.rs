//! One hash over all samples of a topic: equal runs have equal hashes.
//!
//! What is hashed are values by their names, not the bytes of a sample: a list of fields for each topic of the loop
//! (`digest/values.txt`), which stays as it is when layouts change. So a digest is also the same before and after a change
//! that moves, widens or adds fields, if the values are. Of lists with a count, only elements that are used are hashed.
//! The process that published a sample, and when, is no part of it: a run with a swap between processes that publish the
//! same values has the same digests.

use std::collections::BTreeMap;
use std::rc::Rc;

use shared_types::{Field, Kind, Sample};

/// Topics of the loop with the values of each sample, in the order in which they are hashed; for each the name of the
/// topic stands alone in the first line. `items[count].x_m` is a field of the first `count` elements of `items`.
const VALUES: &str = include_str!("digest/values.txt");
/// Fields of a type of your own that are no values: who published a sample, and when.
const NOT_VALUES: [&str; 2] = ["header", "stage"];

/// The hash of nothing.
const START: u64 = 0xcbf2_9ce4_8422_2325;

/// Running 64-bit FNV-1a hashes, one per topic, over the values of all samples in their order, each with eight bytes.
#[derive(Debug, Clone, Default)]
pub struct Digests {
    hashes: BTreeMap<String, u64>,
    values: BTreeMap<String, Rc<[Values]>>,
}

impl Digests {
    /// Adds a sample.
    pub fn add<S: Sample>(&mut self, sample: &S) {
        self.add_bytes(S::TOPIC.name(), S::FIELDS, bytemuck::bytes_of(sample));
    }

    /// Adds a sample of any topic, with the fields of its type.
    pub fn add_bytes(&mut self, topic: &str, fields: &[Field], sample: &[u8]) {
        if !self.values.contains_key(topic) {
            self.values.insert(topic.to_owned(), values(topic, fields).into());
            self.hashes.insert(topic.to_owned(), START);
        }
        let (Some(values), Some(hash)) = (self.values.get(topic), self.hashes.get_mut(topic)) else { return };
        *hash =
            values.iter().flat_map(|values| values.of(sample)).flat_map(u64::to_le_bytes).fold(*hash, step);
    }

    /// One hash over all topics, as a text of 16 digits.
    pub fn whole(&self) -> String {
        let bytes = self.hashes.iter().flat_map(|(topic, hash)| topic.bytes().chain(hash.to_le_bytes()));
        format!("{:016x}", bytes.fold(START, step))
    }

    /// The hashes as texts of 16 digits, by topic.
    pub fn texts(&self) -> BTreeMap<String, String> {
        self.hashes.iter().map(|(topic, hash)| (topic.clone(), format!("{hash:016x}"))).collect()
    }
}

/// One digest of several, in their order.
pub fn digest_of_texts<'a>(texts: impl Iterator<Item = &'a str>) -> String {
    format!("{:016x}", texts.flat_map(str::bytes).fold(START, step))
}

/// One step of 64-bit FNV-1a.
fn step(hash: u64, byte: u8) -> u64 {
    (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
}

/// Where a sample has the values of one name: one, or one of each element of a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Values {
    kind: &'static str,
    /// Of the first one [bytes].
    offset: usize,
    /// From one element to the next [bytes], and how many there are.
    elements: (usize, usize),
    /// Values that follow each other in each element.
    length: usize,
    /// Where the number of used elements stands [bytes].
    count: Option<usize>,
}

impl Values {
    /// The values, as bits of an `f64` or as whole numbers of 64 bits.
    fn of<'a>(&'a self, sample: &'a [u8]) -> impl Iterator<Item = u64> + 'a {
        let (stride, all) = self.elements;
        let used = self.count.map_or(all, |offset| number("u32", &sample[offset..]) as usize);
        let size = Kind::Scalar(self.kind).size();
        let offsets = (0..used.min(all)).flat_map(move |element| {
            (0..self.length).map(move |index| self.offset + element * stride + index * size)
        });
        offsets.map(|offset| number(self.kind, &sample[offset..]))
    }
}

/// The number of a kind that the bytes begin with.
fn number(kind: &'static str, bytes: &[u8]) -> u64 {
    let (size, mut eight) = (Kind::Scalar(kind).size(), [0; 8]);
    eight[..size].copy_from_slice(&bytes[..size]);
    let number = u64::from_le_bytes(eight);
    if kind == "i32" { i64::from(number as u32 as i32).cast_unsigned() } else { number }
}

/// The values of a topic: those of the list, or all of a topic that is not in it.
fn values(topic: &str, fields: &[Field]) -> Vec<Values> {
    let named = VALUES.split("\n\n").filter_map(|part| part.trim().split_once('\n'));
    match named.into_iter().find(|(name, _)| *name == topic) {
        Some((_, names)) => names.split_whitespace().filter_map(|name| find(fields, name)).collect(),
        None => {
            let own = fields.iter().filter(|field| !NOT_VALUES.contains(&field.name));
            let identity = ["header.scan_id", "header.acquired_ns"].into_iter();
            identity.chain(own.map(|field| field.name)).filter_map(|name| find(fields, name)).collect()
        }
    }
}

/// The values of the field `name`, like `x_m`, `scanner.state` or `items[count].x_m`.
fn find(fields: &[Field], name: &str) -> Option<Values> {
    let (mut within, mut offset, mut elements, mut count) = (fields, 0, (0, 1), None);
    let mut parts = name.split('.').peekable();
    loop {
        let part = parts.next()?;
        let (part, counted_by) = part
            .strip_suffix(']')
            .and_then(|part| part.split_once('['))
            .map_or((part, None), |(a, b)| (a, Some(b)));
        let field = within.iter().find(|field| field.name == part)?;
        offset += field.offset;
        match (field.kind, counted_by) {
            (Kind::Array(element @ Kind::Struct(_, inner), length), Some(by)) => {
                (elements, within) = ((element.size(), length), inner);
                count = Some(fields.iter().find(|field| field.name == by)?.offset);
            }
            (Kind::Array(element @ Kind::Scalar(kind), length), Some(by)) => {
                let count = Some(fields.iter().find(|field| field.name == by)?.offset);
                return Some(Values { kind, offset, elements: (element.size(), length), length: 1, count });
            }
            (Kind::Struct(_, inner), None) => within = inner,
            (Kind::Array(Kind::Scalar(kind), length), None) => {
                return Some(Values { kind, offset, elements, length, count });
            }
            (Kind::Scalar(kind), None) => return Some(Values { kind, offset, elements, length: 1, count }),
            _ => return None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::{Command, Header, Obstacle, Obstacles, PlanNode, Pose, Topic};

    fn digest<S: Sample>(sample: S) -> String {
        let mut digests = Digests::default();
        digests.add(&sample);
        digests.texts()[S::TOPIC.name()].clone()
    }

    #[test]
    fn a_single_bit_changes_the_digest_of_its_topic() {
        assert_ne!(digest(Pose::default()), digest(Pose { x_m: f64::from_bits(1), ..Pose::default() }));
        let mut pose = Pose::default();
        pose.covariance[8] = f64::from_bits(1);
        assert_ne!(digest(Pose::default()), digest(pose));
        assert_ne!(digest(Command::default()), digest(Command { side: -1, ..Command::default() }));
    }

    #[test]
    fn who_published_a_sample_and_when_is_no_part_of_the_digest_but_its_scan_is() {
        let mut pose = Pose::default();
        (pose.header.incarnation, pose.header.sequence, pose.header.layout) = (9, 4, 7);
        pose.header.chain[1].published_ns = 5;
        assert_eq!(digest(pose), digest(Pose::default()));
        pose.header = Header { scan_id: 2, ..Header::default() };
        assert_ne!(digest(pose), digest(Pose::default()));
    }

    #[test]
    fn elements_of_a_list_count_as_far_as_they_are_used() {
        let mut obstacles = Obstacles { count: 1, ..Obstacles::default() };
        let one = digest(obstacles);
        obstacles.items[1] = Obstacle { x_m: 3.0, ..Obstacle::default() };
        assert_eq!(digest(obstacles), one, "not used");
        obstacles.items[0].velocity_covariance[2] = 1.0;
        assert_ne!(digest(obstacles), one);
        let mut command = Command { plan_length: 25, ..Command::default() };
        let all = digest(command);
        command.plan[24] = PlanNode { steering_rad: 1.0, ..PlanNode::default() };
        assert_ne!(digest(command), all, "the last one is used");
        // A count beyond the list ends with it.
        assert_ne!(digest(Command { plan_length: u32::MAX, ..command }), all);
    }

    #[test]
    fn a_hash_is_that_of_a_hand_calculation() {
        // FNV-1a over the eight bytes of 1, then those of 2, for a topic with two numbers of other widths.
        let fields = [("a", 0, "u16"), ("b", 2, "i32")].map(|(name, offset, kind)| Field {
            name,
            doc: "",
            offset,
            kind: Kind::Scalar(kind),
        });
        let mut digests = Digests::default();
        digests.add_bytes("own", &fields, &[1, 0, 0xfe, 0xff, 0xff, 0xff]);
        let bytes = [1_u64, (-2_i64).cast_unsigned()].map(u64::to_le_bytes).concat();
        let hash = bytes.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3)
        });
        assert_eq!(digests.texts()["own"], format!("{hash:016x}"));
    }

    #[test]
    fn every_name_of_the_list_is_a_field_and_the_list_is_as_it_was() {
        let mut count = 0;
        for part in VALUES.split("\n\n") {
            let (topic, names) = part.trim().split_once('\n').unwrap();
            let topic: Topic = topic.parse().unwrap();
            for name in names.split_whitespace() {
                assert!(find(topic.fields(), name).is_some(), "{topic}: {name}");
                count += 1;
            }
        }
        // Another list makes other digests of all drives: what was recorded before can't be compared any more.
        assert_eq!(count, 146);
        let sum = VALUES.bytes().fold(0_u32, |sum, byte| sum.wrapping_mul(31).wrapping_add(u32::from(byte)));
        assert_eq!(sum, 960_756_552);
    }
}
