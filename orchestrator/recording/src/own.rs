//! Topics that a system adds to those of the loop, as channels of a recording.

use runtime::OwnTopics;
use shared_types::{Field, OwnType};

use crate::mcap::Schema;
use crate::schema::{ROS2MSG, schema_of};

/// A topic of the system, and the type of its samples.
#[derive(Debug, Clone)]
pub(crate) struct OwnTopic {
    name: String,
    own: OwnType,
}

impl OwnTopic {
    /// The topics in a table, in its order; one whose layout is not allowed is left out.
    pub(crate) fn all(table: &OwnTopics) -> Vec<Self> {
        let of = |row: &runtime::TopicRow| {
            let own = row.layout.own_type().ok()?;
            Some(Self { name: row.name.clone(), own })
        };
        table.topic.iter().filter_map(of).collect()
    }

    /// Its name.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// Name and version of its type, as samples of the loop have them.
    pub(crate) fn type_name(&self) -> String {
        self.own.type_name()
    }

    /// The fields of its samples.
    pub(crate) fn fields(&self) -> &'static [Field] {
        self.own.fields()
    }

    /// Length of its samples [bytes].
    pub(crate) fn size(&self) -> usize {
        self.own.size()
    }

    /// Its schema. The package has the name of the topic: two topics may have types of one name.
    pub(crate) fn schema(&self) -> Schema {
        let package = self.name.replace('-', "_");
        Schema {
            name: format!("scanloop_{package}/msg/{}", self.own.name()),
            encoding: ROS2MSG.to_owned(),
            text: schema_of(self.own.fields()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_schema_of_a_topic_of_the_system_has_its_fields_between_header_and_stamps() {
        let layout =
            "name = \"Imu\"\n[[field]]\nname = \"rate\"\ntype = \"f64[3]\"\ndoc = \"Rates [rad/s]\"\n";
        let layout: runtime::LayoutFile = layout.parse().unwrap();
        let topic = OwnTopic { name: "imu-left".into(), own: layout.own_type().unwrap() };
        let Schema { name, text, .. } = topic.schema();
        assert_eq!((name.as_str(), topic.size()), ("scanloop_imu_left/msg/Imu", 288 + 24 + 32));
        assert!(text.contains("scanloop_msgs/Header header\n"), "{text}");
        assert!(text.contains("# Rates [rad/s]\nfloat64[3] rate\n"), "{text}");
        assert!(text.contains("MSG: scanloop_msgs/StageStamps\n"), "{text}");
    }
}
