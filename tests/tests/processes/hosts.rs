//! A system on two hosts: two buses on this machine, joined over the loopback by `scanloop-link` and `scanloop agent`.
//!
//! The tests need the program of `services/link`, which the workspace does not build. Without it they print that they are
//! skipped.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod network;
mod person;
mod refusals;
mod replay;
mod robot;
mod swap;

use scanloop_tests::machine::repeat_when_late;
use std::net::UdpSocket;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use emulator::Outcome;
use runtime::{Domain, LinkStatus};
use rustix::process::{Pid, Signal, kill_process};
use scanloop_tests::{SHORT_FREE, TestSystem, processes_of, system_file};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Folder of the link that was built last.
fn link_folder() -> Option<PathBuf> {
    let built = Path::new(env!("CARGO_MANIFEST_DIR")).join("../services/link/target");
    let profiles = ["debug", "release"].map(|profile| built.join(profile));
    let age =
        |folder: &PathBuf| folder.join("scanloop-link").metadata().and_then(|meta| meta.modified()).ok();
    profiles.into_iter().filter(|folder| age(folder).is_some()).max_by_key(age)
}

/// A system on several hosts, and the agents of the others.
struct TwoHosts {
    system: TestSystem,
    path: String,
    /// Names of the other hosts.
    names: Vec<String>,
    agents: Vec<(String, Child)>,
}

impl TwoHosts {
    /// Estimator, obstacles and controller in the lab; `None` where the link was not built.
    fn new(test: &str) -> Option<Self> {
        let lab = [Role::Estimator, Role::Obstacles, Role::Controller].map(|role| (role, "lab"));
        Self::with(test, &lab)
    }

    /// Roles on other hosts; `None` where the link was not built.
    fn with(test: &str, places: &[(Role, &str)]) -> Option<Self> {
        let Some(folder) = link_folder() else {
            println!("skipped: {test}: scanloop-link is not built");
            return None;
        };
        let path = format!("{}:{}", folder.display(), std::env::var("PATH").unwrap_or_default());
        let system = TestSystem::new(EXECUTABLE);
        let mut text = system_file(10, &[], "", &[]).replace("restart = \"never\"\n", "");
        text = text.replace("role = \"robot\"\n", "role = \"robot\"\nrestart = \"never\"\n");
        let mut names: Vec<String> = places.iter().map(|(_, host)| (*host).to_owned()).collect();
        names.dedup();
        for (role, host) in places {
            let row = format!("role = \"{role}\"\n");
            text = text.replace(&row, &format!("{row}host = \"{host}\"\n"));
        }
        for name in &names {
            let port = free_port();
            text += &format!(
                "[[host]]\nname = \"{name}\"\naddress = \"127.0.0.1:{port}\"\ntransport = \"udp\"\n"
            );
            let mut file = format!("name = \"{name}\"\nlisten = \"127.0.0.1:{port}\"\ntransport = \"udp\"\n");
            file += match name == "lab" {
                true => "implementations = [\"ekf\", \"ellipses\", \"nmpc\"]\n",
                false => "implementations = [\"emulator\", \"actuation\", \"nmpc\"]\n",
            };
            write_private(&system.folder().join(agent_file(name)), &file);
        }
        std::fs::write(system.folder().join("system.toml"), text).unwrap();
        Some(Self { system, path, names, agents: Vec::new() })
    }

    /// Makes certificates in a folder, and has a file use those of a host.
    fn trust(&self, folder: &str, host: &str, file: &str) {
        if !self.system.folder().join(folder).join("lab").exists() {
            let made = self
                .system
                .command(&["agent", "pair", "lab", "127.0.0.1", "--out", folder])
                .env("PATH", &self.path)
                .output();
            let made = made.unwrap();
            assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        }
        let path = self.system.folder().join(file);
        let text = std::fs::read_to_string(&path).unwrap().replace("transport = \"udp\"\n", "");
        write_private(&path, &format!("credentials = \"{folder}/{host}\"\n{text}"));
    }

    /// [`TwoHosts::new`] with an agent that runs; the clock of the lab is a day ahead. `None` also without root.
    fn ahead(test: &str) -> Option<Self> {
        const AHEAD: [&str; 6] = ["unshare", "-T", "--monotonic", "86400", "--boottime", "86400"];
        let made = Command::new(AHEAD[0]).args(&AHEAD[1..]).arg("true").status();
        if !made.is_ok_and(|status| status.success()) {
            println!("skipped: {test}: no time namespace can be made; it needs root");
            return None;
        }
        let mut hosts = Self::new(test)?;
        hosts.start_agent_by(&AHEAD);
        Some(hosts)
    }

    fn start_agent(&mut self) {
        self.start_agent_by(&[]);
    }

    /// Starts the agents by a command that becomes each.
    fn start_agent_by(&mut self, by: &[&str]) {
        for name in self.names.clone() {
            let log = std::fs::File::create(self.system.folder().join(format!("{name}.txt"))).unwrap();
            let file = agent_file(&name);
            let all = [by, &[EXECUTABLE, "agent", &file]].concat();
            let mut command = Command::new(all[0]);
            command.args(&all[1..]).current_dir(self.system.folder()).env("PATH", &self.path);
            self.agents.push((name, command.stdin(Stdio::null()).stderr(log).spawn().unwrap()));
        }
        self.system.wait_until("the agents listen", |_| {
            self.messages().matches("listens at ").count() == self.names.len()
        });
    }

    fn start(&mut self, scenario: &[&str]) {
        let arguments = [&["run", "--quiet", "--out", "out", "--system", "system.toml"], scenario].concat();
        let path = self.path.clone();
        self.system.launch(&arguments, &[("PATH", &path)]);
    }

    fn messages(&self) -> String {
        let of = |name: &String| std::fs::read_to_string(self.system.folder().join(format!("{name}.txt")));
        self.names.iter().filter_map(|name| of(name).ok()).collect()
    }

    /// Id of the system on the first other host.
    fn other_id(&self) -> String {
        self.id_on(&self.names[0])
    }

    /// Id of the system on another host.
    fn id_on(&self, host: &str) -> String {
        format!("{}-{host}", self.system.id())
    }

    /// The status of the link, as its file has it.
    fn link(&self) -> Option<LinkStatus> {
        LinkStatus::read(&self.system.find()?).ok().flatten()
    }

    /// Ends the agents by a signal, and checks that nothing of the system is left on any host.
    fn end(&mut self) {
        self.system.assert_nothing_left();
        for (name, mut agent) in std::mem::take(&mut self.agents) {
            kill_process(Pid::from_child(&agent), Signal::TERM).unwrap();
            assert_eq!(agent.wait().unwrap().code(), Some(0), "{}", self.messages());
            assert_eq!(processes_of(&self.id_on(&name)), [0; 0]);
            assert!(Domain::find(&self.id_on(&name)).unwrap().is_none(), "a directory is left");
        }
    }
}

impl Drop for TwoHosts {
    fn drop(&mut self) {
        for (_, mut agent) in std::mem::take(&mut self.agents) {
            let _ = agent.kill();
            let _ = agent.wait();
        }
        for id in self.names.iter().map(|name| self.id_on(name)) {
            for pid in processes_of(&id).into_iter().filter_map(Pid::from_raw) {
                let _ = kill_process(pid, Signal::KILL);
            }
            if let Ok(Some(domain)) = Domain::find(&id) {
                let _ = domain.remove();
            }
        }
    }
}

/// The file of the agent of a host; `agent` reads the one of the lab unless told otherwise.
fn agent_file(name: &str) -> String {
    if name == "lab" { "agent.toml".to_owned() } else { format!("{name}.toml") }
}

fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn write_private(path: &Path, text: &str) {
    std::fs::write(path, text).unwrap();
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600)).unwrap();
}

/// The process of a role on the other host, by its environment.
fn process_of(id: &str, role: Role) -> Option<Pid> {
    let is_role = |pid: &i32| {
        let environment = std::fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
        let wanted = format!("{}={role}", runtime::ROLE_VARIABLE);
        environment.split(|byte| *byte == 0).any(|text| text == wanted.as_bytes())
    };
    processes_of(id).into_iter().find(is_role).and_then(Pid::from_raw)
}

#[test]
fn estimator_obstacles_and_controller_drive_the_robot_from_another_host() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::new("a drive over two hosts") else { return };
        hosts.start_agent();
        hosts.start(&SHORT_FREE);
        hosts.system.wait_until_driving();
        for role in [Role::Estimator, Role::Obstacles, Role::Controller] {
            assert!(process_of(&hosts.other_id(), role).is_some(), "{role} does not run there");
        }
        for role in [Role::Robot, Role::Actuator] {
            assert_eq!(process_of(&hosts.other_id(), role), None, "{role} runs there");
        }
        let link = hosts.link().unwrap();
        let lab = link.host("lab").unwrap();
        // Both hosts have one clock here.
        assert!(lab.is_connected && lab.is_locked && lab.offset_ns.unsigned_abs() <= lab.bound_ns, "{lab:?}");
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let report = hosts.system.report();
        assert_eq!(report.outcome, Outcome::Reached);
        assert_eq!(report.scans.unaccounted, 0, "{:?}", report.scans);
        hosts.end();
    });
}

#[test]
fn empty_datagrams_to_the_port_of_an_agent_keep_no_drive_from_it() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::new("empty datagrams") else { return };
        hosts.start_agent();
        let file = std::fs::read_to_string(hosts.system.folder().join(agent_file("lab"))).unwrap();
        let address = file.split('"').find(|text| text.starts_with("127.0.0.1:")).unwrap();
        let is_sending = AtomicBool::new(true);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let (socket, started) = (UdpSocket::bind("127.0.0.1:0").unwrap(), Instant::now());
                socket.set_read_timeout(Some(Duration::from_millis(2))).unwrap();
                while is_sending.load(Ordering::Relaxed) && started.elapsed() < Duration::from_secs(120) {
                    let _ = socket.send_to(&[], address);
                    // Waits for an answer that does not come.
                    let _ = socket.recv(&mut [0; 1]);
                }
            });
            hosts.start(&SHORT_FREE);
            let code = hosts.system.wait().code();
            is_sending.store(false, Ordering::Relaxed);
            assert_eq!(code, Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        });
        assert_eq!(hosts.system.report().outcome, Outcome::Reached);
        let messages = hosts.messages();
        assert!(
            messages.contains("were dropped: they were empty") && !messages.contains("starting anew"),
            "{messages}"
        );
        hosts.end();
    });
}

#[test]
fn a_host_whose_clock_is_a_day_ahead_drives_the_robot_with_stamps_that_add_up() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::ahead("a clock that is a day ahead") else { return };
        hosts.start_recorded(&SHORT_FREE);
        hosts.system.wait_until_driving();
        let lab = hosts.link().unwrap().host("lab").unwrap().clone();
        assert!(lab.offset_ns.abs_diff(-86_400_000_000_000) <= lab.bound_ns, "{lab:?}");
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let report = hosts.system.report();
        assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Reached, 0));
        // No stage took a day, nor less than nothing.
        let latency = &report.latency_us.scan_to_actuation;
        assert!(latency.count > 20 && latency.max < 1e6, "{latency:?}");
        hosts.assert_replayed();
        hosts.end();
    });
}

#[test]
fn a_controller_that_is_killed_on_another_host_is_started_there_again() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::new("a kill on another host") else { return };
        hosts.start_agent();
        hosts.start(&SHORT_FREE);
        hosts.system.wait_until_driving();
        let killed = process_of(&hosts.other_id(), Role::Controller).unwrap();
        kill_process(killed, Signal::KILL).unwrap();
        hosts.system.wait_until("another controller runs there", |_| {
            process_of(&hosts.other_id(), Role::Controller).is_some_and(|pid| pid != killed)
        });
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let report = hosts.system.report();
        let restarts =
            |role: &str| report.processes.iter().find(|process| process.role == role).unwrap().restarts;
        assert_eq!((restarts("controller"), restarts("estimator"), restarts("robot")), (1, 0, 0));
        hosts.end();
    });
}

#[test]
fn without_its_link_the_wheels_are_blocked_and_the_drive_continues_when_it_is_back() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::new("a kill of the link") else { return };
        hosts.start_agent();
        hosts.start(&SHORT_FREE);
        hosts.system.wait_until_driving();
        let link = processes_of_link(hosts.system.id());
        kill_process(link, Signal::KILL).unwrap();
        hosts
            .system
            .wait_until("it is started again", |system| system.stderr().contains("scanloop-link ended"));
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        let report = hosts.system.report();
        assert_eq!((report.outcome, report.scans.unaccounted), (Outcome::Reached, 0), "{:?}", report.scans);
        assert!(report.scans.lost > 0, "the outage cost no scan: {:?}", report.scans);
        let restarts: Vec<u32> = report.processes.iter().map(|process| process.restarts).collect();
        assert_eq!(restarts, [0; 5], "an outage is no hang");
        hosts.end();
    });
}

/// The link of the orchestrator, by its command line.
fn processes_of_link(system_id: &str) -> Pid {
    let is_link = |pid: &i32| {
        let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        line.ends_with(format!("hub\0{system_id}\0").as_bytes())
    };
    let entries = std::fs::read_dir("/proc").unwrap().flatten();
    let pids = entries.filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
    pids.filter(is_link).find_map(Pid::from_raw).expect("a link")
}

#[test]
fn a_host_without_an_agent_is_named_with_its_address() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::new("a host without an agent") else { return };
        hosts.start(&SHORT_FREE);
        assert_eq!(hosts.system.wait().code(), Some(4), "{}", hosts.system.stderr());
        let stderr = hosts.system.stderr();
        assert!(stderr.contains("host lab: no agent answers at udp/127.0.0.1:"), "{stderr}");
        hosts.system.assert_nothing_left();
    });
}

#[test]
fn hosts_that_trust_each_other_drive_over_an_encrypted_link() {
    repeat_when_late(|| {
        let Some(mut hosts) = TwoHosts::new("a drive over quic") else { return };
        hosts.trust("keys", "orchestrator", "system.toml");
        // The certificates of a second call have the same authority.
        hosts.trust("keys", "lab", "agent.toml");
        hosts.start_agent();
        assert!(hosts.messages().contains("listens at quic/"), "{}", hosts.messages());
        hosts.start_recorded(&SHORT_FREE);
        assert_eq!(hosts.system.wait().code(), Some(0), "{} {}", hosts.system.stderr(), hosts.messages());
        assert_eq!(hosts.system.report().scans.unaccounted, 0);
        hosts.assert_replayed();
        hosts.end();
    });
}

#[test]
fn an_agent_file_that_others_can_read_is_refused() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let file = system.folder().join("agent.toml");
        std::fs::write(&file, "name = \"lab\"\n").unwrap();
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o644)).unwrap();
        let output = system.run(&["agent"]);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        assert!(stderr.contains("agent.toml: mode 644 is not allowed: 600"), "{stderr}");
    });
}

#[test]
fn hosts_and_lock_step_exclude_each_other() {
    repeat_when_late(|| {
        let Some(hosts) = TwoHosts::new("lock-step over two hosts") else { return };
        let output = hosts.system.run(&["run", "--lockstep", "free", "--system", "system.toml"]);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        assert!(stderr.contains("process.host = lab is not allowed: with --lockstep"), "{stderr}");
    });
}
