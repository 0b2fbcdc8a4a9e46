//! Where a drive is imported from: a bag of ROS 2, or the log of a rover. Both give messages of ROS 2.

use std::path::{Path, PathBuf};

use console::user_file;
use recording::mcap::MAGIC;

use crate::ImportOptions;
use crate::bag::Bag;
use crate::message::{Each, refuse};
use crate::rover::RoverLog;

/// First bytes of a file of SQLite, in which older bags are.
const SQLITE: &[u8] = b"SQLite format 3\0";
/// First bytes of a bag of ROS 1.
const ROS1: &[u8] = b"#ROSBAG V";

/// A drive of another program.
pub(crate) enum Source {
    Bag(Bag),
    Rover(RoverLog),
}

impl Source {
    /// Finds out what a file or folder is.
    ///
    /// # Errors
    /// None of both, with the program that converts it where there is one; exit code 2.
    pub(crate) fn open(from: &Path, options: &ImportOptions) -> anyhow::Result<Self> {
        if from.is_dir() {
            return Bag::open(from, &bag_files(from)?, options).map(Self::Bag);
        }
        match user_file::read_start(from, SQLITE.len() as u64).map_err(|error| refuse(from, error))? {
            first if first.starts_with(&MAGIC) => Bag::open(from, &[from.to_owned()], options).map(Self::Bag),
            first if first.starts_with(SQLITE) => Err(in_sqlite(from)),
            first if first.starts_with(ROS1) => Err(refuse(
                from,
                "it is a bag of ROS 1; `rosbags-convert` of the Python package `rosbags` makes one of ROS 2",
            )),
            first if first.is_empty() => Err(refuse(from, "the file is empty")),
            _ => RoverLog::open(from, options.wheel_factors).map(Self::Rover),
        }
    }

    /// What it is, for a person.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Self::Bag(_) => "bag of ROS 2",
            Self::Rover(_) => "log of a rover with an URG-04LX",
        }
    }

    /// Its name as the implementation of a robot.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Bag(_) => "rosbag2",
            Self::Rover(_) => "rover-log",
        }
    }

    /// Its topics with scans and odometry.
    pub(crate) fn topics(&self) -> Vec<String> {
        match self {
            Self::Bag(bag) => bag.topics().map(str::to_owned).into(),
            Self::Rover(_) => Vec::new(),
        }
    }

    /// Its files.
    pub(crate) fn files<'f>(&'f self, from: &'f Path) -> Vec<&'f Path> {
        match self {
            Self::Bag(bag) => bag.files().collect(),
            Self::Rover(_) => vec![from],
        }
    }

    /// Whether its end is missing.
    ///
    /// # Errors
    /// A file that can't be read; exit code 2.
    pub(crate) fn is_cut_off(&self) -> anyhow::Result<bool> {
        match self {
            Self::Bag(bag) => bag.is_cut_off(),
            Self::Rover(log) => Ok(log.cut_off),
        }
    }

    /// Hands over all messages in the order in which they were recorded; may be called again.
    ///
    /// # Errors
    /// A damaged file; exit code 2. Errors of `each`.
    pub(crate) fn read(&self, each: &mut Each<'_>) -> anyhow::Result<()> {
        match self {
            Self::Bag(bag) => bag.read(each),
            Self::Rover(log) => log.read(each),
        }
    }

    /// Keys of the vehicle that are known of its robot.
    pub(crate) fn vehicle(&self) -> &'static [&'static str] {
        match self {
            Self::Bag(_) => &[],
            Self::Rover(_) => RoverLog::VEHICLE,
        }
    }
}

fn in_sqlite(path: &Path) -> anyhow::Error {
    let shown = path.display();
    refuse(
        path,
        format_args!(
            "it is a bag in SQLite (db3), which is not read; `ros2 bag convert -i {shown} -o mcap.yaml` makes one in MCAP, \
             with `output_bags: [{{uri: bag-mcap, storage_id: mcap, all_topics: true}}]` in mcap.yaml"
        ),
    )
}

/// The files of a bag in MCAP.
fn bag_files(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|error| refuse(folder, error))?;
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    let with = |extension: &str| {
        let has = |path: &&PathBuf| path.to_string_lossy().ends_with(extension);
        paths.iter().filter(has).cloned().collect::<Vec<PathBuf>>()
    };
    let files = with(".mcap");
    if !files.is_empty() {
        return Ok(files);
    }
    if !with(".db3").is_empty() || !with(".db3.zstd").is_empty() {
        return Err(in_sqlite(folder));
    }
    match with(".mcap.zstd").first() {
        Some(packed) => {
            Err(refuse(packed, format_args!("it is packed; `unzstd {}` unpacks it", packed.display())))
        }
        None => Err(refuse(folder, "no bag of ROS 2 is in this folder: no file ends with .mcap")),
    }
}
