//! The command line: `scanloop-link hub SYSTEM_ID`, `scanloop-link agent NAME ENDPOINT [CREDENTIALS]`,
//! `scanloop-link pair FOLDER HOST ADDRESS DAYS [--force]`, and `scanloop-link check CREDENTIALS HOST`.

use std::path::Path;

use anyhow::bail;
use runtime::{Domain, LinkTable};

use crate::threads::run_by;
use crate::{bridge, control, credentials};

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
        ["check", folder, host] => credentials::check(Path::new(folder), host),
        ["pair", folder, host, address, days, rest @ ..] if rest.is_empty() || rest == ["--force"] => {
            let force = !rest.is_empty();
            credentials::pair(Path::new(folder), host, address.parse()?, days.parse()?, force)
        }
        _ => bail!("it is started by `scanloop run` and `scanloop agent`, not by hand"),
    }
}
