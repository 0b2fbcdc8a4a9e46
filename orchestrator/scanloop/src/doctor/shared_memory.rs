//! The file system of the bus: that it is there, in memory, and large enough.

use runtime::Reserve;
use rustix::fs::statvfs;

use super::check::{Check, size};
use super::root::Root;

const NAME: &str = "shared_memory";
const FOLDER: &str = "/dev/shm";
/// Scan periods of a usual and of the fastest system [ns].
const PERIODS_NS: [u64; 2] = [100_000_000, 1_000_000];

/// Room of a file system; `None` where it has no limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Room {
    free: u64,
    total: u64,
    /// Files that can be made; `u64::MAX` without a limit.
    files: u64,
}

impl Room {
    /// That of the bus, in its file system.
    pub(super) fn now() -> Option<Self> {
        let status = statvfs(FOLDER).ok().filter(|status| status.f_blocks > 0)?;
        let [free, total] = [status.f_bavail, status.f_blocks].map(|blocks| blocks * status.f_frsize);
        Some(Self { free, total, files: if status.f_files == 0 { u64::MAX } else { status.f_favail } })
    }
}

/// The mount of the bus, and whether a system finds room there.
pub(super) fn shared_memory(root: &Root, room: Option<Room>) -> Check {
    let [at_10_hz, at_1_khz] = PERIODS_NS.map(Reserve::of_a_system);
    let mounts = root.read("proc/self/mountinfo").unwrap_or_default();
    let mount = mounts.lines().filter_map(Mount::of).rfind(|mount| mount.place == FOLDER);
    let make = "`mount -t tmpfs -o size=256m tmpfs /dev/shm` as root";
    if !root.join(FOLDER).is_dir() {
        return Check::fail(NAME, format!("there is no {FOLDER}"), format!("make the folder, then {make}"));
    }
    if mount.as_ref().is_some_and(|mount| mount.is_read_only) {
        let fix = "`mount -o remount,rw /dev/shm` as root";
        return Check::fail(NAME, format!("{FOLDER} can't be written to: it is mounted read-only"), fix);
    }
    let kind = mount.map_or_else(|| "no mount of its own".to_owned(), |mount| mount.kind);
    let found = room.map_or_else(
        || format!("{FOLDER} ({kind}), without a limit"),
        |Room { free, total, .. }| format!("{} of {} are free in {FOLDER} ({kind})", size(free), size(total)),
    );
    let needs = format!("a system takes {} at 10 Hz, {} at 1 kHz", size(at_10_hz), size(at_1_khz));
    let detail = format!("{found}; {needs}");
    let larger = "`mount -o remount,size=256m /dev/shm` as root; for a container `--shm-size 256m`";
    match room {
        Some(Room { files, .. }) if files < Reserve::FILES_OF_A_SYSTEM => Check::fail(
            NAME,
            format!("{files} more files can be made in {FOLDER}, {} are needed", Reserve::FILES_OF_A_SYSTEM),
            "`mount -o remount,nr_inodes=10000 /dev/shm` as root",
        ),
        Some(room) if room.free < at_10_hz => Check::fail(NAME, detail, larger),
        Some(room) if room.free < at_1_khz => Check::warn(NAME, detail, larger),
        _ if kind != "tmpfs" => Check::warn(NAME, format!("{detail}; samples may reach a disk"), make),
        _ => Check::ok(NAME, detail),
    }
}

/// One line of `/proc/PID/mountinfo`.
struct Mount {
    place: String,
    kind: String,
    is_read_only: bool,
}

impl Mount {
    /// `36 35 98:0 / /dev/shm rw,nosuid - tmpfs tmpfs rw,size=65536k`, with any number of fields before the hyphen.
    fn of(line: &str) -> Option<Self> {
        let (of_mount, of_file_system) = line.split_once(" - ")?;
        let mut words = of_mount.split(' ').skip(4);
        let (place, options) = (words.next()?, words.next()?);
        let (kind, of_system) = (of_file_system.split(' ').next()?, of_file_system.split(' ').nth(2)?);
        let is_read_only =
            [options, of_system].iter().any(|list| list.split(',').any(|option| option == "ro"));
        Some(Self { place: place.to_owned(), kind: kind.to_owned(), is_read_only })
    }
}

#[cfg(test)]
mod tests {
    use super::super::check::State;
    use super::super::root::made_up::Machine;
    use super::*;

    const MOUNT: &str = "22 1 0:21 / /proc rw - proc proc rw\n\
                         36 35 0:98 / /dev/shm rw,nosuid shared:4 - tmpfs tmpfs rw,size=65536k\n";

    fn machine(name: &str, mounts: &str) -> Machine {
        Machine::new(name, &[("proc/self/mountinfo", mounts), ("dev/shm/.keep", "")])
    }

    fn room(free: u64) -> Option<Room> {
        Some(Room { free, total: 64 << 20, files: u64::MAX })
    }

    #[test]
    fn room_that_suffices_for_no_system_or_a_slow_one_only_is_named_with_the_fix() {
        let machine = machine("shm-room", MOUNT);
        let state = |free| shared_memory(&machine.root, room(free)).state;
        let [slow, fast] = PERIODS_NS.map(Reserve::of_a_system);
        assert!(slow < fast);
        assert_eq!([slow - 1, slow, fast].map(state), [State::Fail, State::Warn, State::Ok]);
        assert_eq!(shared_memory(&machine.root, None).state, State::Ok);
        let few = Room { free: fast, total: fast, files: Reserve::FILES_OF_A_SYSTEM - 1 };
        assert_eq!(shared_memory(&machine.root, Some(few)).state, State::Fail);
        let failed = shared_memory(&machine.root, room(1 << 20));
        assert!(failed.detail.starts_with("1 MiB of 64 MiB are free in /dev/shm (tmpfs); a system takes "));
        assert!(failed.fix.is_some_and(|fix| fix.contains("--shm-size")));
    }

    #[test]
    fn a_missing_mount_one_on_a_disk_and_one_that_can_only_be_read_are_told_apart() {
        let empty = Machine::new("shm-none", &[("proc/self/mountinfo", MOUNT)]);
        assert_eq!(shared_memory(&empty.root, None).detail, "there is no /dev/shm");
        let on_disk = machine("shm-disk", "1 0 8:1 / / rw - ext4 /dev/sda rw\n");
        let found = shared_memory(&on_disk.root, None);
        assert_eq!(found.state, State::Warn);
        assert!(found.detail.contains("no mount of its own") && found.detail.ends_with("may reach a disk"));
        let fixed = machine("shm-fixed", &MOUNT.replace("rw,nosuid", "ro,nosuid"));
        assert_eq!(shared_memory(&fixed.root, room(60 << 20)).state, State::Fail);
    }
}
