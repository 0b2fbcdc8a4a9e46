//! A node in a domain of ROS 2: its topics, and who else is there.

use anyhow::Context as _;
use driver::ros2::Ros2Config;
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    Context, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile, Subscription,
};
use rustdds::DomainParticipantBuilder;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::message::Named;
use crate::watch::End;

/// Messages that wait to be read or sent.
const DEPTH: usize = 10;

/// A node.
pub(crate) struct RosNode {
    context: Context,
    node: Node,
}

impl RosNode {
    /// Joins the domain of the settings.
    ///
    /// # Errors
    /// A network interface that is not there, and a domain without a free port.
    pub(crate) fn open(config: &Ros2Config, name: &str) -> anyhow::Result<Self> {
        let mut builder = DomainParticipantBuilder::new(config.domain as u16);
        if let Ok(address) = config.interface.parse::<std::net::IpAddr>() {
            builder = builder.with_only_networks([address]);
        }
        let domain = || format!("domain {}", config.domain);
        let context = Context::from_domain_participant(builder.build().map_err(told).with_context(domain)?);
        let context = context.map_err(told).with_context(domain)?;
        let namespace = if config.namespace.is_empty() { "/" } else { &config.namespace };
        let name = NodeName::new(namespace, name).map_err(told)?;
        // No log goes out and no parameter comes in.
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let node = context.new_node(name, options).map_err(told)?;
        Ok(Self { context, node })
    }

    /// Reads a topic. A reader that takes what comes matches every publisher.
    ///
    /// # Errors
    /// Those of DDS.
    pub(crate) fn subscribe<M>(&mut self, topic: &str, qos: QosProfile) -> anyhow::Result<Subscription<M>>
    where
        M: Named + DeserializeOwned + 'static,
    {
        let topic = self.topic::<M>(topic, &qos)?;
        self.node.create_subscription(&topic, Some(qos)).map_err(told)
    }

    /// Writes a topic.
    ///
    /// # Errors
    /// Those of DDS.
    pub(crate) fn advertise<M>(&mut self, topic: &str, qos: QosProfile) -> anyhow::Result<Publisher<M>>
    where
        M: Named + Serialize,
    {
        let topic = self.topic::<M>(topic, &qos)?;
        self.node.create_publisher(&topic, Some(qos)).map_err(told)
    }

    fn topic<M: Named>(&self, topic: &str, qos: &QosProfile) -> anyhow::Result<rustdds::Topic> {
        let [package, name] = M::TYPE;
        let parsed = Name::parse(topic).map_err(told).with_context(|| topic.to_owned())?;
        self.node.create_topic(&parsed, MessageTypeName::new(package, name), qos).map_err(told)
    }

    /// The clock of nodes without a simulated one, for stamps of messages that only tools read [s].
    pub(crate) fn now_s(&self) -> f64 {
        self.node.time_now_not_simulated().to_nanos() as f64 * 1e-9
    }

    /// All publishers of other nodes.
    pub(crate) fn writers(&self) -> Vec<End> {
        let writers = self.context.domain_participant().discovered_writers();
        let end = |data: &rustdds::discovery::DiscoveredWriterData| End {
            topic: data.publication_topic_data.topic_name().clone(),
            type_name: data.publication_topic_data.type_name.clone(),
        };
        writers.iter().map(end).collect()
    }

    /// All readers of other nodes.
    pub(crate) fn readers(&self) -> Vec<End> {
        let readers = self.context.domain_participant().discovered_readers();
        let end = |data: &rustdds::discovery::DiscoveredReaderData| End {
            topic: data.subscription_topic_data.topic_name().clone(),
            type_name: data.subscription_topic_data.type_name().clone(),
        };
        readers.iter().map(end).collect()
    }
}

/// Takes what comes, loses what is lost.
pub(crate) fn best_effort() -> QosProfile {
    QosProfile::subscription_default().history(History::KeepLast { depth: DEPTH })
}

/// Sends again what is lost, and never waits.
pub(crate) fn reliable() -> QosProfile {
    QosProfile::publisher_default()
        .reliability_reliable(WhenFull::Fail)
        .history(History::KeepLast { depth: DEPTH })
}

/// Also what was sent before this reader was there: static transforms.
pub(crate) fn latched() -> QosProfile {
    reliable().durability(Durability::TransientLocal).history(History::KeepLast { depth: 100 })
}

/// An error of another library, as one of ours.
fn told(error: impl std::fmt::Display) -> anyhow::Error {
    anyhow::anyhow!("{error}")
}
