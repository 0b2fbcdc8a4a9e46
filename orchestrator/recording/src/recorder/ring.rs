//! The last seconds of a drive in memory, as compressed chunks that are written to a file when something happens.

use std::collections::VecDeque;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use console::new_file::{Existing, NewFile};
use console::out_folder::OutFolder;

use super::opening::Opening;
use crate::mcap::{Chunk, OpenChunk};
use crate::running::ASKED;
use crate::tape::TapeTarget;

/// The ring holds no more than this [bytes].
const MAX_BYTES: usize = 256 << 20;
/// As many files of incidents are kept in a folder.
const MAX_FILES: usize = 5;

/// The newest chunks of a recording.
pub(super) struct Ring {
    opening: Opening,
    folder: PathBuf,
    span_ns: u64,
    open: OpenChunk,
    /// Each with the samples that were lost before its end.
    chunks: VecDeque<(u64, Chunk)>,
    bytes: usize,
    lost: u64,
}

impl Ring {
    /// An empty ring for so many seconds; files are made in `folder`.
    pub(super) fn new(opening: Opening, folder: &Path, seconds: f64) -> Self {
        let (folder, span_ns) = (folder.to_owned(), (seconds * 1e9) as u64);
        let (open, chunks) = (OpenChunk::default(), VecDeque::new());
        Self { opening, folder, span_ns, open, chunks, bytes: 0, lost: 0 }
    }

    /// Time that it holds [ns].
    pub(super) fn span_ns(&self) -> u64 {
        self.span_ns
    }

    /// Notes how many samples of the drive were lost until now.
    pub(super) fn set_lost(&mut self, lost: u64) {
        self.lost = lost;
    }

    /// Writes all that it holds into `incident-SCAN.mcap` and returns its path, or `None` if it holds nothing. The oldest
    /// of more than five such files is removed. Files that no run has written stay: another name is taken.
    ///
    /// # Errors
    /// Those of the file system. The file that was there remains.
    pub(super) fn save(&mut self, scan_id: u64) -> io::Result<Option<PathBuf>> {
        self.save_as(&["", "-a", "-b", "-c"].map(|more| format!("incident-{scan_id}{more}.mcap")))
    }

    /// Writes all that it holds for somebody who asks for it, into [`ASKED`], and replaces what was written for that before.
    ///
    /// # Errors
    /// Those of the file system.
    pub(super) fn save_asked(&mut self) -> io::Result<()> {
        self.save_as(&[ASKED.to_owned()]).map(|_| ())
    }

    fn save_as(&mut self, names: &[String]) -> io::Result<Option<PathBuf>> {
        self.end_chunk()?;
        let Some((lost_before, _)) = self.chunks.front() else { return Ok(None) };
        let out = OutFolder::claim(&self.folder, &[], false).map_err(io::Error::other)?;
        let claimed = names.iter().find(|name| out.claim_growing(name).is_ok());
        let name = claimed.ok_or_else(|| io::Error::other(format!("{} and others exist", names[0])))?;
        let path = self.folder.join(name);
        self.write(&path, self.lost - lost_before)?;
        remove_oldest(&out)?;
        Ok(Some(path))
    }

    fn write(&self, path: &Path, lost: u64) -> io::Result<()> {
        let file = NewFile::create(path, Existing::Replace, &[]).map_err(io::Error::other)?;
        let mut writer = self.opening.begin(BufWriter::new(file))?;
        self.chunks.iter().try_for_each(|(_, chunk)| writer.chunk(chunk))?;
        let samples: u64 = self.chunks.iter().map(|(_, chunk)| chunk.messages()).sum();
        let counts = [("samples", samples), ("lost", lost), ("last_scan", 0)];
        writer.metadata("end", &counts.map(|(key, count)| (key.to_owned(), count.to_string())))?;
        writer.finish()?.0.into_inner()?.finish().map_err(io::Error::other)
    }
}

impl TapeTarget for Ring {
    fn message(&mut self, channel: u16, sequence: u32, log_ns: u64, data: &[&[u8]]) {
        self.open.message(channel, sequence, [log_ns; 2], data);
    }

    fn open_bytes(&self) -> usize {
        self.open.bytes()
    }

    /// Adds the open chunk, and drops the oldest ones that are too old or too many.
    fn end_chunk(&mut self) -> io::Result<()> {
        if self.open.bytes() == 0 {
            return Ok(());
        }
        let chunk = self.open.seal()?;
        let newest_ns = chunk.last_ns();
        self.bytes += chunk.bytes();
        self.chunks.push_back((self.lost, chunk));
        while let Some((_, oldest)) = self.chunks.front()
            && (oldest.last_ns().saturating_add(self.span_ns) < newest_ns || self.bytes > MAX_BYTES)
        {
            self.bytes -= oldest.bytes();
            self.chunks.pop_front();
        }
        Ok(())
    }

    fn attach(&mut self, name: &str, _media_type: &str, data: &[u8], _log_ns: u64) -> io::Result<()> {
        self.opening.add(name, data);
        Ok(())
    }
}

/// Removes the oldest files of incidents that runs have written.
fn remove_oldest(out: &OutFolder) -> io::Result<()> {
    let is_incident = |name: &str| name.starts_with("incident-") && out.has_grown(name);
    let mut files: Vec<_> = std::fs::read_dir(out.folder())?
        .flatten()
        .filter(|entry| entry.file_name().to_str().is_some_and(is_incident))
        .filter_map(|entry| Some((entry.metadata().ok()?.modified().ok()?, entry.path())))
        .collect();
    files.sort();
    let surplus = files.len().saturating_sub(MAX_FILES);
    files[..surplus].iter().try_for_each(|(_, path)| std::fs::remove_file(path))
}

#[cfg(test)]
mod tests {
    use shared_types::{Checkpoint, Command, Header, Obstacles, Pose, Role, Scan, ScanGeometry, Topic};

    use super::*;
    use crate::tape::Tape;

    /// A pose of a drive with ten scans a second.
    fn pose(scan_id: u64) -> Pose {
        let mut header = Header { scan_id, incarnation: 1, sequence: scan_id, ..Header::default() };
        header.chain[Role::Estimator.index()].published_ns = scan_id * 100_000_000;
        Pose { header, x_m: scan_id as f64, ..Pose::default() }
    }

    #[test]
    fn a_ring_holds_its_last_seconds_and_five_files_whatever_the_length_of_the_drive() {
        let folder = std::env::temp_dir().join(format!("scanloop-ring-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let mut tape = Tape::new(Ring::new(Opening::default(), &folder, 10.0), false, 0);
        let mut largest = [0; 2];
        for scan_id in 1..=20_000 {
            tape.sample(Topic::Pose, bytemuck::bytes_of(&pose(scan_id))).unwrap();
            let half = usize::from(scan_id > 10_000);
            largest[half] = largest[half].max(tape.target().bytes);
        }
        assert!(largest[1] < largest[0] + largest[0] / 10, "{largest:?}");
        // Files of the user, one of them with a name that is needed.
        let own = ["incident-3.mcap", "incident-99.mcap"].map(|name| folder.join(name));
        own.iter().for_each(|path| std::fs::write(path, "own").unwrap());
        for scan_id in 1..=7 {
            let path = tape.target().save(scan_id).unwrap().unwrap();
            let expected =
                if scan_id == 3 { "incident-3-a.mcap".into() } else { format!("incident-{scan_id}.mcap") };
            assert_eq!(path, folder.join(expected));
        }
        assert!(own.iter().all(|path| std::fs::read_to_string(path).unwrap() == "own"));
        let names = std::fs::read_dir(&folder).unwrap().flatten().map(|entry| entry.file_name());
        let files = names.filter(|name| name.to_string_lossy().starts_with("incident-")).count();
        let info = crate::info::Info::read(&folder.join("incident-7.mcap")).unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!((files, info.complete, info.lost), (5 + 2, true, Some(0)));
        assert!((10.0..12.0).contains(&info.duration_s), "{info}");
    }

    /// Resident memory of this process [KiB].
    fn memory_kib() -> u64 {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        line.trim().trim_end_matches(" kB").parse().unwrap()
    }

    #[test]
    #[ignore = "takes minutes: cargo test --release -p recording -- --ignored --nocapture"]
    fn the_memory_is_flat_over_a_day_of_scans() {
        let mut tape = Tape::new(Ring::new(Opening::default(), Path::new("/"), 60.0), false, 0);
        let (mut random, mut memory) = (1_u64, Vec::new());
        for scan_id in 1..=864_000 {
            let pose = pose(scan_id);
            let mut scan = Scan { header: pose.header, ..Scan::of(ScanGeometry::URG_04LX) };
            scan.header.chain[Role::Robot.index()].published_ns = scan_id * 100_000_000;
            for range in scan.ranges_mut() {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                *range = 2000 + (random >> 58) as u32;
            }
            let header = scan.header;
            let mut checkpoint = Checkpoint { header, role: Role::Obstacles.wire(), ..Checkpoint::default() };
            checkpoint.issued_ns = scan_id * 100_000_000;
            tape.sample(Topic::Scan, bytemuck::bytes_of(&scan)).unwrap();
            tape.sample(Topic::Pose, bytemuck::bytes_of(&pose)).unwrap();
            tape.sample(Topic::Obstacles, bytemuck::bytes_of(&Obstacles { header, ..Obstacles::default() }))
                .unwrap();
            tape.sample(Topic::Command, bytemuck::bytes_of(&Command { header, ..Command::default() }))
                .unwrap();
            tape.sample(Topic::Checkpoint, bytemuck::bytes_of(&checkpoint)).unwrap();
            if scan_id % 86_400 == 0 {
                memory.push((memory_kib(), tape.target().bytes >> 10));
            }
        }
        let text = format!("resident memory and ring, each tenth of a day [KiB]: {memory:?}");
        runtime::print(runtime::Priority::Notice, &text);
        let [first, last] = [memory[0].0, memory[memory.len() - 1].0];
        assert!(last < first + first / 20, "{memory:?}");
    }
}
