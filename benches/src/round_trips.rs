//! A bus with two ends: one sends a pose, the other answers each with a command.
//!
//! The pose (480 bytes) goes out on its topic, the command (1704 bytes) comes back on its own, and both ends sleep
//! between samples as processes of the loop do. Half a round trip is the cost of one hop. The other end is a thread
//! with a node of its own, or a process.

use std::process::{Child, Command as Program, Stdio};
use std::thread::JoinHandle;

use runtime::{Bus, Domain, Observer, Publisher, RuntimeError};
use shared_types::{Command, Pose, Sample};

/// Tells the other end to end.
const END: u64 = u64::MAX;
/// A lost wake-up costs this much; a missing answer is requested again after it [ns].
const TIMEOUT_NS: u64 = 100_000_000;
/// The other end ends after so many time-outs without a request: ten seconds.
const LONELY: u32 = 100;

/// Where the other end runs.
pub enum Peer {
    /// In a thread of this process.
    Thread,
    /// In a process started from this program with its arguments; it must call [`echo_until_told`].
    Process(Program),
}

/// The asking end; ends the other one and removes the bus when dropped.
pub struct EchoClient {
    // Fields are dropped in this order: ports before the bus, the bus before its files.
    poses: Publisher<Pose>,
    commands: Observer<Command>,
    _bus: Bus,
    files: Files,
    other: Option<Other>,
    asked: u64,
}

enum Other {
    Thread(JoinHandle<Result<(), RuntimeError>>),
    Process(Child),
}

/// Files of a bus in shared memory and in the directory of its system; removed when dropped.
struct Files(Domain);

impl EchoClient {
    /// A new bus with its two ends connected.
    ///
    /// # Errors
    /// Errors of the bus, and of starting the process.
    pub fn start(system_id: &str, peer: Peer) -> Result<Self, Box<dyn std::error::Error>> {
        let files = Files(Domain::create(system_id)?);
        let bus = Bus::create(&files.0, TIMEOUT_NS)?;
        let mut echo = Self {
            poses: Publisher::new(&bus)?,
            commands: Observer::waking(&bus)?,
            _bus: bus,
            files,
            other: None,
            asked: 0,
        };
        echo.other = Some(match peer {
            Peer::Thread => {
                let id = system_id.to_owned();
                Other::Thread(std::thread::spawn(move || echo_until_told(&id)))
            }
            Peer::Process(mut program) => Other::Process(program.stdin(Stdio::null()).spawn()?),
        });
        // The first answer comes when both halves of both connections are made.
        echo.round_trip()?;
        Ok(echo)
    }

    /// Asks, sleeps, and returns when the answer is there; asks again when none has come for a tenth of a second.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn round_trip(&mut self) -> Result<(), RuntimeError> {
        self.asked += 1;
        let mut pose = Pose::default();
        pose.header.scan_id = self.asked;
        loop {
            self.poses.publish(&mut pose, true)?;
            let mut woken = true;
            while woken {
                woken = wait_on(&self.commands);
                let mut answered = false;
                self.commands.poll(|command| answered |= command.header.scan_id == self.asked)?;
                if answered {
                    return Ok(());
                }
            }
        }
    }

    /// Where the bus has its files.
    pub fn domain(&self) -> &Domain {
        &self.files.0
    }
}

impl Drop for EchoClient {
    fn drop(&mut self) {
        let mut end = Pose::default();
        end.header.scan_id = END;
        // Where this fails the other end ends after its time-outs.
        let _ = self.poses.publish(&mut end, true);
        match self.other.take() {
            Some(Other::Thread(thread)) => drop(thread.join()),
            Some(Other::Process(mut process)) => drop(process.wait()),
            None => {}
        }
    }
}

impl Drop for Files {
    fn drop(&mut self) {
        let _ = self.0.remove();
    }
}

/// The answering end: opens the bus of `system_id` and answers until it is told to end.
///
/// # Errors
/// Errors of the bus.
pub fn echo_until_told(system_id: &str) -> Result<(), RuntimeError> {
    let bus = Bus::open(&Domain::existing(system_id)?, "echo")?;
    let (poses, mut commands) = (Observer::<Pose>::waking(&bus)?, Publisher::<Command>::new(&bus)?);
    let mut lonely = 0;
    while lonely < LONELY {
        lonely = if wait_on(&poses) { 0 } else { lonely + 1 };
        let mut newest = None;
        poses.poll(|pose| newest = Some(pose.header))?;
        match newest {
            Some(header) if header.scan_id == END => return Ok(()),
            Some(header) => {
                commands.publish(&mut Command { header: header.answer(), ..Command::default() }, true)?
            }
            None => {}
        }
    }
    Ok(())
}

/// Sleeps until a sample may have come; false after the time-out.
fn wait_on<S: Sample>(observer: &Observer<S>) -> bool {
    observer.wait(TIMEOUT_NS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_trips_work_between_threads_and_leave_nothing_behind() {
        let mut echo = EchoClient::start(&format!("e{}", std::process::id()), Peer::Thread).unwrap();
        for _ in 0..100 {
            echo.round_trip().unwrap();
        }
        let domain = echo.domain().clone();
        drop(echo);
        let names = std::fs::read_dir("/dev/shm").unwrap().flatten().map(|file| file.file_name());
        let left = names.filter(|name| name.to_string_lossy().starts_with(domain.shared_memory_prefix()));
        assert_eq!(left.collect::<Vec<_>>(), [] as [std::ffi::OsString; 0]);
        assert!(!domain.directory().exists());
    }
}
