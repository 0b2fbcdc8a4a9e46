//! Whether a topic works: who publishes it, and since when nothing has come.

/// A topic with its newest messages; `P` names a publisher.
#[derive(Debug)]
pub(crate) struct Watch<P> {
    /// Name, beginning with `/`.
    pub(crate) topic: String,
    silence_ns: u64,
    /// The publisher of the newest message, and when it came [ns].
    newest: Option<(P, u64)>,
    /// The one before it, and when its newest message came [ns].
    other: Option<(P, u64)>,
    /// When two were last seen in turns [ns].
    two_ns: Option<u64>,
    /// What is wrong with the newest message, if anything.
    pub(crate) fault: Option<String>,
}

impl<P: Copy + PartialEq> Watch<P> {
    /// A topic on which nothing has come yet; `silence_ns` without a message is a fault.
    pub(crate) fn new(topic: String, silence_ns: u64) -> Self {
        Self { topic, silence_ns, newest: None, other: None, two_ns: None, fault: None }
    }

    /// Notes a message. A publisher that comes again after another one has come is no restart: there are two.
    pub(crate) fn note(&mut self, publisher: P, now_ns: u64) {
        if let Some((before, before_ns)) = self.newest.filter(|(before, _)| *before != publisher) {
            let is_back = self.other.is_some_and(|(other, other_ns)| {
                other == publisher && now_ns.saturating_sub(other_ns) < self.silence_ns
            });
            self.two_ns = is_back.then_some(now_ns).or(self.two_ns);
            self.other = Some((before, before_ns));
        }
        self.newest = Some((publisher, now_ns));
    }

    /// Whether a message has come.
    pub(crate) fn has_come(&self) -> bool {
        self.newest.is_some()
    }

    /// What is wrong now.
    pub(crate) fn wrong(&self, now_ns: u64) -> Option<String> {
        let Self { topic, silence_ns, .. } = self;
        let since = |at_ns: u64| now_ns.saturating_sub(at_ns);
        if self.two_ns.is_some_and(|at_ns| since(at_ns) < *silence_ns) {
            return Some(format!("{topic} has two publishers"));
        }
        match self.newest {
            None => Some(format!("{topic}: no message yet")),
            Some((_, at_ns)) if since(at_ns) > *silence_ns => {
                Some(format!("{topic}: no message for {:.1} s", *silence_ns as f64 * 1e-9))
            }
            Some(_) => self.fault.clone(),
        }
    }
}

/// Topics that every node has.
const OF_EVERY_NODE: [&str; 2] = ["/parameter_events", "/rosout"];

/// An end of a topic in the domain: names of topic and type as DDS has them.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct End {
    /// Name of the topic, `rt/scan`.
    pub(crate) topic: String,
    /// Name of the type, `sensor_msgs::msg::dds_::LaserScan_`.
    pub(crate) type_name: String,
}

/// Why nothing comes on a topic, or why no node takes what is sent there. `None` when an end with the type is there.
pub(crate) fn missing(topic: &str, [package, name]: [&str; 2], ends: &[End], what: &str) -> Option<String> {
    let wanted = format!("{package}::msg::dds_::{name}_");
    let here = |end: &&End| end.topic == format!("rt{topic}");
    if ends.iter().filter(here).any(|end| end.type_name == wanted) {
        return None;
    }
    if let Some(other) = ends.iter().find(here) {
        let is = other.type_name.replace("::msg::dds_::", "/").trim_end_matches('_').to_owned();
        return Some(format!("{topic} is {is}, but {package}/{name} is needed"));
    }
    let mut topics: Vec<&str> = ends
        .iter()
        .filter_map(|end| end.topic.strip_prefix("rt"))
        .filter(|topic| !OF_EVERY_NODE.contains(topic))
        .collect();
    topics.sort_unstable();
    topics.dedup();
    let others = if topics.is_empty() {
        "there is none of any topic".to_owned()
    } else {
        format!("there is {}", topics.join(", "))
    };
    Some(format!("{topic} has no {what}; {others}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    #[test]
    fn silence_and_two_publishers_are_told_from_a_restart() {
        let mut watch = Watch::new("/scan".to_owned(), S);
        assert_eq!(watch.wrong(0).unwrap(), "/scan: no message yet");
        watch.note('a', S);
        assert_eq!(watch.wrong(2 * S), None);
        assert_eq!(watch.wrong(2 * S + 1).unwrap(), "/scan: no message for 1.0 s");
        // A restart: another one comes, the first does not come again.
        watch.note('b', 2 * S);
        watch.note('b', 2 * S + S / 10);
        assert_eq!(watch.wrong(2 * S + S / 10), None);
        watch.note('c', 2 * S + S / 5);
        watch.note('b', 2 * S + S / 4);
        assert_eq!(watch.wrong(2 * S + S / 4).unwrap(), "/scan has two publishers");
        watch.note('b', 3 * S + S / 2);
        assert_eq!(watch.wrong(3 * S + S / 2), None, "one has ended");
    }

    #[test]
    fn a_topic_without_an_end_a_wrong_type_and_a_right_one() {
        let end =
            |topic: &str, type_name: &str| End { topic: topic.to_owned(), type_name: type_name.to_owned() };
        let scan = ["sensor_msgs", "LaserScan"];
        assert_eq!(
            missing("/scan", scan, &[], "publisher").unwrap(),
            "/scan has no publisher; there is none of any topic"
        );
        let others =
            [end("rt/odom", "x"), end("rt/front/scan", "y"), end("rt/rosout", "z"), end("rt/odom", "x")];
        assert_eq!(
            missing("/scan", scan, &others, "publisher").unwrap(),
            "/scan has no publisher; there is /front/scan, /odom"
        );
        let wrong = [end("rt/scan", "sensor_msgs::msg::dds_::PointCloud2_")];
        assert_eq!(
            missing("/scan", scan, &wrong, "publisher").unwrap(),
            "/scan is sensor_msgs/PointCloud2, but sensor_msgs/LaserScan is needed"
        );
        let right = [end("rt/scan", "sensor_msgs::msg::dds_::LaserScan_")];
        assert_eq!(missing("/scan", scan, &right, "publisher"), None);
    }
}
