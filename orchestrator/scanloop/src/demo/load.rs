//! Whether other programs keep the machine busy.

/// From so many ready programs per processor on, one of them waits for another.
const BUSY: f64 = 1.0;

/// What a user should know of a machine on which promised times can't be measured; `None` of an idle one.
pub(super) fn busy() -> Option<String> {
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    told(&std::fs::read_to_string("/proc/loadavg").ok()?, processors)
}

/// The same from the text of `/proc/loadavg`.
fn told(text: &str, processors: usize) -> Option<String> {
    let load: f64 = text.split_whitespace().next()?.parse().ok()?;
    (load > BUSY * processors as f64)
        .then(|| format!("load {load:.1} on {processors} processors in the last minute"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_is_busy_when_more_programs_are_ready_than_it_has_processors() {
        let of = |load: &str, processors| told(&format!("{load} 1.00 1.00 1/300 4711\n"), processors);
        assert_eq!(of("20.13", 2).unwrap(), "load 20.1 on 2 processors in the last minute");
        assert_eq!((of("1.90", 2), of("20.0", 32), told("", 2)), (None, None, None));
    }
}
