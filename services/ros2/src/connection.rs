//! The connection to the robot: a thread that reads its topics, and says when they can be used.

use std::time::Duration;

use driver::event::RobotEvent;
use driver::feed::Outlet;
use driver::guard::Held;
use driver::order::GuardOrder;
use driver::ros2::{Ros2Config, ScannerPose};
use ros2_client::{Gid, Subscription};
use runtime::monotonic_ns;
use rustdds::mio1::{Events, Interest, Poll, Token};
use vehicle::ScannerDescription;

use crate::base::{Base, wrong_frame};
use crate::command::{CommandWriter, type_of};
use crate::guard;
use crate::message::{LaserScan, Named, Odometry, TFMessage};
use crate::node::{RosNode, best_effort, latched};
use crate::offset::Offset;
use crate::sweep::Resampler;
use crate::transforms::{Frames, Mounting, Rays};
use crate::watch::{Watch, missing};

/// Longest sleep of the thread.
const SLEEP: Duration = Duration::from_millis(20);
/// Other nodes are looked for this often while something is missing [ns].
const LOOK_NS: u64 = 100_000_000;
/// A guard that failed is started anew after this time [ns].
const PAUSE_NS: u64 = 500_000_000;

/// What the thread has to know.
pub(crate) struct Wanted {
    /// The settings.
    pub(crate) config: Ros2Config,
    /// Where the scanner is by `[vehicle]`.
    pub(crate) mounting: Mounting,
    /// What it measures by `[vehicle]`.
    pub(crate) scanner: ScannerDescription,
    /// The wheels are stopped after this time without an order: two scan periods [ns].
    pub(crate) timeout_ns: u64,
}

/// Serves the robot until the driver ends.
///
/// # Errors
/// A node that can't be made.
pub(crate) fn serve(wanted: &Wanted, outlet: &Outlet<RobotEvent>) -> anyhow::Result<()> {
    let mut connection = Connection::open(wanted)?;
    let mut poll = Poll::new()?;
    let mut events = Events::with_capacity(16);
    connection.register(&mut poll)?;
    while !outlet.is_ended() {
        match poll.poll(&mut events, Some(SLEEP)) {
            Err(error) if error.kind() != std::io::ErrorKind::Interrupted => return Err(error.into()),
            _ => connection.turn(outlet),
        }
    }
    Ok(())
}

/// The thread with its topics.
struct Connection<'a> {
    wanted: &'a Wanted,
    /// Scans of the robot; `None` for a scanner at this computer.
    scans: Option<Subscription<LaserScan>>,
    odometries: Subscription<Odometry>,
    statics: Option<Subscription<TFMessage>>,
    scan_watch: Watch<Gid>,
    base_watch: Watch<Gid>,
    resampler: Resampler,
    base: Base,
    offset: Offset,
    frames: Frames,
    /// Frames of the newest scan and of the newest odometry.
    frame_ids: [String; 2],
    guard: Option<Held>,
    /// When the guard failed [ns].
    failed_ns: u64,
    /// Why no node takes commands.
    unheard: Option<String>,
    /// When readers were looked for, and publishers [ns].
    listened_ns: u64,
    looked_ns: u64,
    /// Stops the wheels in place of a guard that does not.
    stopper: CommandWriter,
    is_connected: bool,
    /// The newest reason why not.
    reason: String,
    node: RosNode,
}

impl<'a> Connection<'a> {
    fn open(wanted: &'a Wanted) -> anyhow::Result<Self> {
        let config = &wanted.config;
        let mut node = RosNode::open(config, "scanloop")?;
        let silence_ns = ((config.silence_s * 1e9) as u64).max(wanted.timeout_ns);
        let topics = ["scan", "odom"].map(|name| config.topic(name));
        let reads_scans = !config.has_scanner();
        let scans = reads_scans.then(|| node.subscribe(&topics[0], best_effort())).transpose()?;
        let odometries = node.subscribe(&topics[1], best_effort())?;
        let is_wanted = config.scanner_pose == ScannerPose::Tf;
        let statics = is_wanted.then(|| node.subscribe(&config.topic("tf_static"), latched())).transpose()?;
        let [scan_watch, base_watch] = topics.map(|topic| Watch::new(topic, silence_ns));
        let stopper = CommandWriter::open(&mut node, config)?;
        Ok(Self {
            wanted,
            scans,
            odometries,
            statics,
            scan_watch,
            base_watch,
            resampler: Resampler::new(wanted.scanner),
            base: Base::default(),
            offset: Offset::default(),
            frames: Frames::default(),
            frame_ids: [String::new(), String::new()],
            guard: None,
            failed_ns: 0,
            unheard: Some(format!("{} has no reader", config.topic("cmd_vel"))),
            listened_ns: 0,
            looked_ns: 0,
            stopper,
            is_connected: false,
            reason: String::new(),
            node,
        })
    }

    fn register(&mut self, poll: &mut Poll) -> std::io::Result<()> {
        let registry = poll.registry();
        self.scans.iter_mut().try_for_each(|scans| registry.register(scans, Token(0), Interest::READABLE))?;
        registry.register(&mut self.odometries, Token(1), Interest::READABLE)?;
        self.statics
            .iter_mut()
            .try_for_each(|statics| registry.register(statics, Token(2), Interest::READABLE))
    }

    /// Takes what has come, and says what has changed.
    fn turn(&mut self, outlet: &Outlet<RobotEvent>) {
        let now_ns = monotonic_ns();
        self.take_transforms();
        // States first: a sweep needs the one of its time.
        self.take_odometry(now_ns, outlet);
        self.take_scans(now_ns, outlet);
        let guard = self.keep_guard(now_ns);
        match (self.is_connected, self.wrong(now_ns).or(guard)) {
            (false, None) => self.connect(outlet),
            (true, Some(reason)) => {
                self.guard.iter().for_each(|guard| guard.give(GuardOrder::Stop));
                self.is_connected = false;
                self.say(reason, outlet);
            }
            (false, Some(reason)) if reason != self.reason => self.say(reason, outlet),
            _ => {}
        }
    }

    fn say(&mut self, reason: String, outlet: &Outlet<RobotEvent>) {
        self.reason.clone_from(&reason);
        outlet.put(RobotEvent::Lost(reason));
    }

    fn connect(&mut self, outlet: &Outlet<RobotEvent>) {
        if let Some(orders) = self.guard.as_ref().and_then(|guard| guard.orders().ok()) {
            self.is_connected = outlet.put(RobotEvent::Connected(orders));
            self.reason.clear();
        }
    }

    fn take_transforms(&mut self) {
        while let Some(Ok(Some((message, _)))) = self.statics.as_ref().map(Subscription::take) {
            self.frames.add(message);
        }
    }

    fn take_odometry(&mut self, now_ns: u64, outlet: &Outlet<RobotEvent>) {
        let config = &self.wanted.config;
        while let Ok(Some((message, info))) = self.odometries.take() {
            self.base_watch.note(info.publisher_gid(), now_ns);
            let topic = &self.base_watch.topic;
            let frames = [
                wrong_frame(topic, "frame_id", &config.odometry_frame, &message.header.frame_id),
                wrong_frame(topic, "child_frame_id", &config.base_frame, &message.child_frame_id),
            ];
            self.base_watch.fault = frames.into_iter().flatten().next();
            self.frame_ids[1].clone_from(&message.child_frame_id);
            let (state, time_s) = (self.base.state(config, &message), message.header.stamp.seconds());
            if let Some(seconds) = self.offset.note(time_s, now_ns) {
                self.stopper.offset_s = Some(seconds);
                self.guard.iter().for_each(|guard| guard.give(GuardOrder::Offset(seconds)));
            }
            if self.is_connected && self.base_watch.fault.is_none() {
                outlet.offer(RobotEvent::State { state, time_s, arrived_ns: now_ns });
            }
        }
    }

    fn take_scans(&mut self, now_ns: u64, outlet: &Outlet<RobotEvent>) {
        let config = &self.wanted.config;
        while let Some(Ok(Some((message, info)))) = self.scans.as_ref().map(Subscription::take) {
            self.scan_watch.note(info.publisher_gid(), now_ns);
            let topic = &self.scan_watch.topic;
            let frame = wrong_frame(topic, "frame_id", &config.scan_frame, &message.header.frame_id);
            self.frame_ids[0].clone_from(&message.header.frame_id);
            let sweep = self.rays().and_then(|rays| {
                let sweep = self.resampler.sweep(config.sweep_s, rays, &message);
                sweep.map_err(|unusable| format!("{topic}: {unusable}"))
            });
            match sweep {
                _ if frame.is_some() => self.scan_watch.fault = frame,
                Err(fault) => self.scan_watch.fault = Some(fault),
                Ok(sweep) => {
                    self.scan_watch.fault = None;
                    if self.is_connected {
                        outlet.offer(RobotEvent::Sweep {
                            ranges_mm: sweep.ranges_mm,
                            time_s: sweep.front_s,
                            sweep_ns: Some(sweep.sweep_ns),
                            arrived_ns: now_ns,
                        });
                    }
                }
            }
        }
    }

    /// Starts the guard when somebody takes its commands; what is wrong with it, or why it can't be started.
    fn keep_guard(&mut self, now_ns: u64) -> Option<String> {
        if let Some(guard) = &mut self.guard {
            let Err(fault) = guard.check(now_ns) else {
                return (!guard.is_ready()).then(|| "the guard of the wheels is being started".to_owned());
            };
            // The process of the guard does not; the next one will.
            let _ = self.stopper.send([0.0; 2]);
            (self.guard, self.failed_ns) = (None, now_ns);
            return Some(fault.to_string());
        }
        if self.unheard.is_some() && now_ns >= self.listened_ns + LOOK_NS {
            self.listened_ns = now_ns;
            let config = &self.wanted.config;
            let readers = self.node.readers();
            self.unheard = missing(&config.topic("cmd_vel"), type_of(config.command), &readers, "reader");
        }
        if self.unheard.is_some() {
            return self.unheard.clone();
        }
        if now_ns < self.failed_ns + PAUSE_NS {
            return Some(self.reason.clone());
        }
        match guard::start(&self.wanted.config, self.wanted.timeout_ns) {
            Ok(guard) => {
                self.offset.known_s().into_iter().for_each(|seconds| guard.give(GuardOrder::Offset(seconds)));
                self.guard = Some(guard);
                Some("the guard of the wheels is being started".to_owned())
            }
            Err(fault) => {
                self.failed_ns = now_ns;
                Some(fault.to_string())
            }
        }
    }

    /// What is wrong with the topics.
    fn wrong(&mut self, now_ns: u64) -> Option<String> {
        let kinds = [Odometry::TYPE, LaserScan::TYPE];
        let watched = if self.scans.is_some() { 2 } else { 1 };
        for (watch, kind) in [&self.base_watch, &self.scan_watch].into_iter().zip(kinds).take(watched) {
            if let Some(wrong) = watch.wrong(now_ns) {
                let is_silent = !watch.has_come() && now_ns >= self.looked_ns + LOOK_NS;
                if !is_silent {
                    return Some(if watch.has_come() || self.reason.is_empty() {
                        wrong
                    } else {
                        self.reason.clone()
                    });
                }
                self.looked_ns = now_ns;
                return Some(missing(&watch.topic, kind, &self.node.writers(), "publisher").unwrap_or(wrong));
            }
        }
        None
    }

    /// Where the rays of the newest scan point: by the settings, or by `/tf_static`.
    fn rays(&self) -> Result<Rays, String> {
        let config = &self.wanted.config;
        if self.statics.is_none() {
            return Ok(Rays { yaw_rad: config.scan_yaw_rad, sign: config.scan_sign });
        }
        let [scan, base] = &self.frame_ids;
        let transform = self.frames.pose(scan, base).ok_or_else(|| {
            format!("/tf_static does not connect `{scan}`, the frame of the scans, with `{base}`, that of the base")
        })?;
        self.wanted.mounting.rays(&transform)
    }
}
