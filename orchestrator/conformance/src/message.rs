//! A sample of any topic of the loop.

use std::any::Any;

use shared_types::{
    Actuation, ActuationKind, Command, CommandKind, Fault, Header, Obstacles, Odometry, Pose, Sample, Scan,
    Topic, Truth,
};

use super::trouble::{Trouble, failed};

/// Something that the candidate published.
#[derive(Debug, Clone)]
pub(crate) struct Received {
    pub(crate) message: Message,
    /// When the test bench received it [ns].
    pub(crate) at_ns: u64,
}

/// A sample of one of the topics of the loop.
#[derive(Debug, Clone)]
pub(crate) enum Message {
    Scan(Box<Scan>),
    Odometry(Box<Odometry>),
    Pose(Box<Pose>),
    Obstacles(Box<Obstacles>),
    Command(Box<Command>),
    Actuation(Box<Actuation>),
    Truth(Box<Truth>),
}

/// Runs the same expression on the sample of any message.
macro_rules! any {
    ($message:expr, $sample:ident => $value:expr) => {
        match $message {
            Message::Scan($sample) => $value,
            Message::Odometry($sample) => $value,
            Message::Pose($sample) => $value,
            Message::Obstacles($sample) => $value,
            Message::Command($sample) => $value,
            Message::Actuation($sample) => $value,
            Message::Truth($sample) => $value,
        }
    };
}

impl Message {
    /// The sample, which must be of this type.
    pub(crate) fn sample<S: Sample>(&self) -> Result<&S, Trouble> {
        let sample = any!(self, sample => (&**sample as &dyn Any).downcast_ref());
        sample.map_or_else(|| failed(format!("{} where {} was expected", self.topic(), S::TOPIC)), Ok)
    }

    /// The sample if it is of this type, to change it.
    pub(crate) fn sample_mut<S: Sample>(&mut self) -> Option<&mut S> {
        any!(self, sample => (&mut **sample as &mut dyn Any).downcast_mut())
    }

    /// Changes the sample if it is of this type.
    pub(crate) fn change<S: Sample>(&mut self, change: impl FnOnce(&mut S)) {
        if let Some(sample) = self.sample_mut() {
            change(sample);
        }
    }

    pub(crate) fn topic(&self) -> Topic {
        fn of<S: Sample>(_: &S) -> Topic {
            S::TOPIC
        }
        any!(self, sample => of(&**sample))
    }

    pub(crate) fn header(&self) -> &Header {
        any!(self, sample => &sample.header)
    }

    pub(crate) fn header_mut(&mut self) -> &mut Header {
        any!(self, sample => &mut sample.header)
    }

    pub(crate) fn scan_id(&self) -> u64 {
        self.header().scan_id
    }

    /// What every subscriber checks.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        any!(self, sample => sample.check())
    }

    /// The bytes without incarnation and sequence: two runs with the same input have them in common.
    pub(crate) fn content(&self) -> Vec<u8> {
        let mut same = self.clone();
        let header = same.header_mut();
        (header.incarnation, header.sequence) = (0, 0);
        any!(&same, sample => bytemuck::bytes_of(&**sample).to_vec())
    }

    /// Whether it answers a scan; an actuator also publishes without a command.
    pub(crate) fn is_answer(&self) -> bool {
        any!(self, sample => sample.is_answer())
    }

    /// Whether it moves nothing: a stop, a block.
    pub(crate) fn is_harmless(&self) -> bool {
        match self {
            Self::Command(command) => command.kind != CommandKind::Drive.wire(),
            Self::Actuation(actuation) => actuation.kind == ActuationKind::Block.wire(),
            _ => false,
        }
    }

    /// Moves all stamps of the machine's clock by `offset_ns`.
    pub(crate) fn shift(&mut self, offset_ns: u64) {
        let header = self.header_mut();
        header.acquired_ns += offset_ns;
        for stamps in header.chain.iter_mut().filter(|stamps| stamps.published_ns > 0) {
            stamps.woken_ns += offset_ns;
            stamps.taken_ns += offset_ns;
            stamps.computed_ns += offset_ns;
            stamps.published_ns += offset_ns;
        }
        match self {
            Self::Pose(pose) => pose.predicted_ns += offset_ns,
            Self::Command(command) => command.plan_start_ns += offset_ns,
            _ => {}
        }
    }

    /// The sample spoilt in several ways; a subscriber must drop each.
    pub(crate) fn spoilt(&self) -> Vec<Self> {
        let mut all = vec![self.clone()];
        all[0].header_mut().layout ^= 1;
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut message = self.clone();
            match &mut message {
                Self::Scan(scan) => (scan.sweep_ns, scan.period_ns) = (u64::MAX, 1),
                Self::Odometry(odometry) => odometry.x_m = bad,
                Self::Pose(pose) => pose.predicted_yaw_rad = bad,
                Self::Obstacles(obstacles) => {
                    obstacles.count = obstacles.count.max(1);
                    obstacles.items[0].x_m = bad;
                }
                Self::Command(command) => command.steering_rad = bad,
                Self::Actuation(actuation) => actuation.sent_velocity_mps = bad,
                Self::Truth(truth) => truth.x_m = bad,
            }
            all.push(message);
        }
        let mut message = self.clone();
        match &mut message {
            Self::Scan(scan) => scan.sweep_ns = 0,
            Self::Odometry(odometry) => odometry.yaw_rad = f64::NAN,
            Self::Pose(pose) => pose.y_m = f64::NAN,
            Self::Obstacles(obstacles) => obstacles.count = 1000,
            Self::Command(command) => command.kind = 77,
            Self::Actuation(actuation) => actuation.kind = 77,
            Self::Truth(truth) => truth.yaw_rad = f64::NAN,
        }
        all.push(message);
        all
    }
}
