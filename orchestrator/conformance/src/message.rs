//! A sample of any topic of the loop, and the mouths and ears that the stand has for all of them.

use runtime::{Bus, Observer, Publisher, RuntimeError, wait_for};
use shared_types::{
    Actuation, ActuationKind, Command, CommandKind, Fault, Header, Obstacles, Odometry, Pose, Role, Sample,
    Scan, Topic, Truth,
};

/// A sample of one of the topics of the loop.
#[derive(Debug, Clone, PartialEq)]
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

    /// What every reader checks.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        any!(self, sample => sample.check())
    }

    /// The bytes behind identity: what two runs with the same input have in common.
    pub(crate) fn content(&self) -> Vec<u8> {
        let mut same = self.clone();
        let header = same.header_mut();
        (header.incarnation, header.sequence) = (0, 0);
        any!(&same, sample => bytemuck::bytes_of(&**sample).to_vec())
    }

    /// Whether it is said because of a scan, and not by the actuator on its own account.
    pub(crate) fn is_answer(&self) -> bool {
        any!(self, sample => sample.is_answer())
    }

    /// Whether nothing moves because of it: a stop, a block.
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

    /// The same sample spoilt in several ways, each of which a reader must drop.
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

/// Publishers of all topics that processes of the loop read.
pub(crate) struct Publishers {
    scan: Publisher<Scan>,
    odometry: Publisher<Odometry>,
    pose: Publisher<Pose>,
    obstacles: Publisher<Obstacles>,
    command: Publisher<Command>,
    actuation: Publisher<Actuation>,
}

impl Publishers {
    pub(crate) fn new(bus: &Bus) -> Result<Self, RuntimeError> {
        Ok(Self {
            scan: Publisher::new(bus)?,
            odometry: Publisher::new(bus)?,
            pose: Publisher::new(bus)?,
            obstacles: Publisher::new(bus)?,
            command: Publisher::new(bus)?,
            actuation: Publisher::new(bus)?,
        })
    }

    /// Publishes; `exactly` leaves layout and sequence as they are, else they are filled and kept in the message.
    pub(crate) fn publish(&mut self, message: &mut Message, exactly: bool) -> Result<(), RuntimeError> {
        fn through<S: Sample>(
            voice: &mut Publisher<S>,
            sample: &mut S,
            exactly: bool,
        ) -> Result<(), RuntimeError> {
            if exactly { voice.publish_unchanged(sample, true) } else { voice.publish(sample, true) }
        }
        match message {
            Message::Scan(sample) => through(&mut self.scan, sample, exactly),
            Message::Odometry(sample) => through(&mut self.odometry, sample, exactly),
            Message::Pose(sample) => through(&mut self.pose, sample, exactly),
            Message::Obstacles(sample) => through(&mut self.obstacles, sample, exactly),
            Message::Command(sample) => through(&mut self.command, sample, exactly),
            Message::Actuation(sample) => through(&mut self.actuation, sample, exactly),
            // Nobody in the loop reads the truth.
            Message::Truth(_) => Ok(()),
        }
    }
}

/// Readers of all topics that a role writes.
pub(crate) struct Subscribers {
    scan: Option<Observer<Scan>>,
    odometry: Option<Observer<Odometry>>,
    truth: Option<Observer<Truth>>,
    pose: Option<Observer<Pose>>,
    obstacles: Option<Observer<Obstacles>>,
    command: Option<Observer<Command>>,
    actuation: Option<Observer<Actuation>>,
}

impl Subscribers {
    pub(crate) fn new(bus: &Bus, role: Role) -> Result<Self, RuntimeError> {
        fn of<S: Sample>(bus: &Bus, role: Role) -> Result<Option<Observer<S>>, RuntimeError> {
            let writes = role.writes().contains(&S::TOPIC) || S::TOPIC.writer() == Some(role);
            writes.then(|| Observer::waking(bus)).transpose()
        }
        Ok(Self {
            scan: of(bus, role)?,
            odometry: of(bus, role)?,
            truth: of(bus, role)?,
            pose: of(bus, role)?,
            obstacles: of(bus, role)?,
            command: of(bus, role)?,
            actuation: of(bus, role)?,
        })
    }

    /// Sleeps until the role may have said something on the last of its topics, or the time-out.
    pub(crate) fn wait(&self, timeout_ns: u64) -> bool {
        fn on<S: Sample>(ear: &Option<Observer<S>>, timeout_ns: u64) -> Option<bool> {
            ear.as_ref().map(|ear| ear.wait(timeout_ns))
        }
        on(&self.odometry, timeout_ns)
            .or_else(|| on(&self.pose, timeout_ns))
            .or_else(|| on(&self.obstacles, timeout_ns))
            .or_else(|| on(&self.command, timeout_ns))
            .or_else(|| on(&self.actuation, timeout_ns))
            .unwrap_or_else(|| wait_for(&[], timeout_ns))
    }

    /// Hands everything that was said since the last call to `each`.
    pub(crate) fn receive(&self, mut each: impl FnMut(Message)) -> Result<(), RuntimeError> {
        fn all<S: Sample>(ear: &Option<Observer<S>>, mut each: impl FnMut(S)) -> Result<(), RuntimeError> {
            let Some(ear) = ear else { return Ok(()) };
            while let Some((sample, _)) = ear.next()? {
                each(sample);
            }
            Ok(())
        }
        all(&self.truth, |sample| each(Message::Truth(Box::new(sample))))?;
        all(&self.scan, |sample| each(Message::Scan(Box::new(sample))))?;
        all(&self.odometry, |sample| each(Message::Odometry(Box::new(sample))))?;
        all(&self.pose, |sample| each(Message::Pose(Box::new(sample))))?;
        all(&self.obstacles, |sample| each(Message::Obstacles(Box::new(sample))))?;
        all(&self.command, |sample| each(Message::Command(Box::new(sample))))?;
        all(&self.actuation, |sample| each(Message::Actuation(Box::new(sample))))
    }
}
