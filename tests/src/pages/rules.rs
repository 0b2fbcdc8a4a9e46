//! How each command of the pages is tried.

/// How a command is tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum How {
    /// As it stands, with these words before its comment; exit codes that are right.
    Alone(&'static str, &'static [i32]),
    /// While `run endless --allow-inject` drives, with these words.
    Beside(&'static str),
    /// With this command in its place, because it takes long.
    As(&'static str),
    /// Its words are read, and it is not run, for this reason.
    Read(&'static str),
    /// Not at all, for this reason.
    Not(&'static str),
}

use How::{Alone, As, Beside, Not, Read};

const DONE: &[i32] = &[0];
const LONG: &str = "takes minutes; the tests of this command run it with less";
const TERMINAL: &str = "draws on a terminal until a key is pressed; tested in processes/top.rs";
const REAL_TIME: &str = "drives in real time; the same drive is tested in lock-step";
const FILES: &str = "reads files that the reader has";
const OWN: &str = "names a program of the reader";
const DEVICE: &str = "needs a device";
const HOSTS: &str = "needs another host; tested in processes/hosts.rs";
const BUILD: &str = "builds or tests the repository";
const PEERS: &str = "needs programs of others, which setup.sh builds";
const INSTALL: &str = "installs packages; tried by packaging/try";
const CONTAINER: &str = "needs containers";
const PERSON: &str = "lets a person drive; tested in processes/person.rs";
const FOREVER: &str = "runs until it is ended; tested in processes/view.rs";

/// How commands that begin so are tried; the first that fits counts.
const RULES: &[(&str, How)] = &[
    // Which build and install.
    ("cargo ", Not(BUILD)),
    ("packaging/", Not(BUILD)),
    ("sudo dpkg ", Not(INSTALL)),
    ("dpkg ", Not(INSTALL)),
    // Files alone: names at PyPI belong to others.
    ("pip install ./", Not(INSTALL)),
    ("python3 -m venv", Not(INSTALL)),
    ("environment/bin/pip install ./", Not(INSTALL)),
    ("sha256sum ", Not(INSTALL)),
    ("tar ", Not(INSTALL)),
    ("scanloop-0.1.0-", Not(INSTALL)),
    ("podman ", Not(CONTAINER)),
    ("export PATH", Not(BUILD)),
    ("make ", Not(BUILD)),
    ("examples/python/setup.sh", Not(BUILD)),
    ("benches/peers/", Not(PEERS)),
    ("tests/digests", Not(BUILD)),
    ("diff before after", Not(BUILD)),
    ("target/dist/scanloop", Not(LONG)),
    ("SCANLOOP_HOST_", Not(BUILD)),
    ("SCANLOOP_WRITE_PAGES", Not(BUILD)),
    ("tests/pages", Not(BUILD)),
    ("tests/", Not(BUILD)),
    ("benches/", Not(BUILD)),
    // Other machines and devices.
    ("scp ", Not(HOSTS)),
    ("cp services/", Not(BUILD)),
    ("services/link/target/release/examples/round-trip", Not(HOSTS)),
    ("chmod 600 agent.toml", Not(HOSTS)),
    ("ip ", Not(HOSTS)),
    ("nsenter ", Not(HOSTS)),
    ("scanloop-link ", Not(HOSTS)),
    ("scanloop agent", Read(HOSTS)),
    ("scanloop check two-hosts.toml", Read(HOSTS)),
    ("scanloop run corridor --system two-hosts.toml", Read(HOSTS)),
    ("scanloop swap controller --to nmpc@", Read(HOSTS)),
    ("scanloop urg", Read(DEVICE)),
    ("scanloop check --live", Read(DEVICE)),
    ("target/release/scanloop", Not(BUILD)),
    ("curl ", Not(FOREVER)),
    ("scanloop pause", Read(PERSON)),
    ("scanloop resume", Read(PERSON)),
    ("scanloop teleop", Read(PERSON)),
    ("my-program", Not(OWN)),
    // Programs and files of the reader.
    ("scanloop swap controller -- ./my-controller", Read(OWN)),
    ("scanloop swap controller -- target/python", Read(OWN)),
    ("scanloop swap controller --watch", Read(OWN)),
    ("scanloop swap obstacles -- examples/c/obstacles", Read(OWN)),
    ("scanloop shadow controller -- ./my-controller", Read(OWN)),
    ("scanloop conformance controller -- python3", Read(OWN)),
    ("scanloop conformance robot -- ./my-driver", Read(OWN)),
    ("scanloop types --rust", Read(FILES)),
    ("scanloop types --c      --layout", Read(FILES)),
    ("scanloop types --python --layout", Read(FILES)),
    ("scanloop types", Read("writes into the examples; tested in processes/languages.rs")),
    ("scanloop calibrate velocity --drive", Alone("", DONE)),
    ("scanloop calibrate steering --drive", Alone("", DONE)),
    ("scanloop calibrate drift    --drive", Alone("", DONE)),
    ("scanloop calibrate", Read(FILES)),
    ("scanloop run first.toml", Read(FILES)),
    ("scanloop run --lockstep out/campaign", Read(FILES)),
    // Drives.
    ("scanloop run imperfect-robot --calibration", Alone("--lockstep", DONE)),
    ("scanloop run free --lockstep", Alone("", &[0, 1])),
    ("scanloop run corridor --lockstep", Alone("", &[0, 1])),
    ("scanloop run slalom --view", Read(FOREVER)),
    ("scanloop run slalom", Alone("--lockstep", &[0, 1])),
    ("scanloop run corridor --set", Alone("--lockstep", DONE)),
    ("scanloop run walls --record=drive.mcap", Alone("--lockstep", DONE)),
    ("scanloop run walls --record", Alone("--lockstep", DONE)),
    ("scanloop run --set", Alone("--lockstep", &[0, 1])),
    ("scanloop run --system examples/rust/imu", Read("is run by processes/imu.rs")),
    (
        "scanloop check --system examples/ros2",
        Read("needs the program scanloop-ros2 for nothing, and is tested in commands"),
    ),
    ("scanloop run --system examples/ros2", Read("needs a robot of ROS 2; tested by tests/ros2/run")),
    ("scanloop run --system examples/player", Read("needs a Player server; tested in processes/player.rs")),
    ("scanloop run --realtime", Read("needs the right to real-time priorities")),
    ("scanloop run --top", Read(TERMINAL)),
    ("scanloop run endless --allow-inject", Read("the run that the other commands of its block need")),
    ("scanloop run SCENARIO", Not("a place to fill in")),
    ("scanloop run --adopt-or-start SCENARIO", Not("a place to fill in")),
    ("scanloop restart ROLE", As("scanloop restart estimator")),
    (
        "scanloop run && cat out/corridor/report.json",
        As("scanloop run --lockstep && cat out/corridor/report.json"),
    ),
    ("scanloop run s-curve --lockstep --record", Alone("", DONE)),
    ("scanloop run", Read(REAL_TIME)),
    ("scanloop recording export out/s-curve", Read(FILES)),
    ("scanloop recording import", Read(FILES)),
    ("scanloop record drive.mcap", As("scanloop record own.mcap --duration 0.5")),
    ("scanloop replay drive.mcap --with", Read(OWN)),
    ("scanloop replay drive.mcap --speed 1", Read(REAL_TIME)),
    ("scanloop replay drive.mcap --set", Alone("", &[0, 1])),
    ("scanloop replay drive.mcap", Alone("", DONE)),
    ("scanloop why drive.mcap", Alone("", DONE)),
    ("scanloop why 57", Read(REAL_TIME)),
    ("scanloop fork drive.mcap", Alone("", &[0, 1])),
    // Which watch and change a running system.
    ("scanloop status", Beside("")),
    ("scanloop latency", As("scanloop latency --duration 0.5")),
    ("scanloop topic", Beside("")),
    ("scanloop swap", Beside("")),
    ("scanloop set", Beside("")),
    (
        "scanloop shadow estimator --for 30s",
        As("scanloop shadow estimator --for 1s -- target/release/dead-reckoning"),
    ),
    ("scanloop shadow estimator --to ekf", As("scanloop shadow estimator --to ekf --for 1s --json")),
    ("scanloop inject --list", Beside("")),
    ("scanloop inject obstacles-late-5ms", As("scanloop inject obstacles-late-5ms --for 0.2s")),
    ("scanloop inject scanner-dead", As("scanloop inject scanner-dead --for 0.2s")),
    ("scanloop inject", Read("disturbs the commands after it; tested in processes/inject.rs")),
    ("scanloop stop", Read("ends the system; tested in processes/stop.rs")),
    ("scanloop adopt", Read("needs an orchestrator that died; tested in processes/adoption.rs")),
    ("scanloop top", Read(TERMINAL)),
    ("scanloop view", Read(FOREVER)),
    // Which measure.
    ("scanloop check --migrate", Read(FILES)),
    ("scanloop check", Alone("", DONE)),
    ("scanloop reference", Alone("", DONE)),
    ("scanloop conformance", Read("half a minute; tested in conformance.rs")),
    ("scanloop demo", Read("is run by processes/demo.rs")),
    ("scanloop bench", Read(LONG)),
    ("scanloop campaign", Read(LONG)),
    ("scanloop faults", Read(LONG)),
    ("scanloop price", Read(LONG)),
];

/// How a command is tried; `None` for one that has no rule yet.
pub fn how(command: &str) -> Option<How> {
    RULES.iter().find(|(begin, _)| command.starts_with(begin)).map(|(_, how)| *how)
}
