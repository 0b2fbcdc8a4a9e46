//! The command line: `scanloop-link hub SYSTEM_ID`, `scanloop-link agent NAME ENDPOINT [CREDENTIALS]`,
//! `scanloop-link pair FOLDER HOST ADDRESS DAYS`, and `scanloop-link check CREDENTIALS`. By hand, to measure a network:
//! `scanloop-link echo ADDRESS [CREDENTIALS]` on one host, `scanloop-link ping ADDRESS COUNT [CREDENTIALS]` on another.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::bail;
use runtime::{Domain, LinkTable, Realtime};

use crate::{bridge, control, credentials, ping};

/// Runs the link until its system ends, or its agent does.
///
/// # Errors
/// Wrong usage, a system that does not run, and an address that can't be used.
pub(crate) fn run() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["--version"] => {
            println!("scanloop-link {}", runtime::link_version());
            Ok(())
        }
        ["hub", system_id] => {
            let domain = Domain::existing(system_id)?;
            let Some(table) = LinkTable::read(&domain)? else { bail!("system `{system_id}` is on one host") };
            run_by(&table.realtime);
            bridge::run_hub(&domain, &table)
        }
        ["agent", name, endpoint] => control::run_agent(name, endpoint, None),
        ["agent", name, endpoint, credentials] => control::run_agent(name, endpoint, Some(credentials)),
        ["check", folder] => credentials::check(Path::new(folder)),
        ["pair", folder, host, address, days] => {
            credentials::pair(Path::new(folder), host, address.parse()?, days.parse()?)
        }
        ["echo", address] => ping::echo(address.parse()?, None),
        ["echo", address, credentials] => ping::echo(address.parse()?, Some(credentials)),
        ["ping", address, count] => ping::ping(address.parse()?, None, count.parse()?),
        ["ping", address, count, credentials] => {
            ping::ping(address.parse()?, Some(credentials), count.parse()?)
        }
        _ => bail!(
            "it is started by `scanloop run` and `scanloop agent`, not by hand; `echo` and `ping` measure"
        ),
    }
}

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
