//! Processors and priority of the threads of the link.

use std::collections::BTreeSet;

use runtime::Realtime;

/// Gives all threads of this process the processors and the priority of the processes of the loop; those that start later inherit
/// them.
pub(crate) fn run_by(realtime: &Realtime) {
    let entries = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let threads = entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let refused: BTreeSet<String> = threads.flat_map(|thread| realtime.apply_to(thread)).collect();
    for refused in refused {
        runtime::print(runtime::Priority::Warning, &refused);
    }
}
