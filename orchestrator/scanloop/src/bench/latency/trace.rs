//! Scans on a time line, for ui.perfetto.dev: one lane per process, an arrow from stage to stage of each scan.
//!
//! The format is the trace event JSON that Perfetto and Chrome read. A stage's lane shows for each scan *wait* (awake,
//! but not all inputs taken), *compute* and *publish*; the gap before is sleep or waiting for a processor. The arrows
//! go from the robot's publication through all stages to the actuation. The trace has the first scans of a run and its
//! slowest ones, see `Collector::stored`, so that the file stays below two megabytes.

use std::fmt::Write as _;

use report::latency::attribute;
use shared_types::{Header, Role};

/// The trace of scans, as JSON; times count from the first front beam.
pub(crate) fn text(scans: &[Header]) -> String {
    let scans: Vec<&Header> = scans.iter().filter(|header| attribute(header).is_ok()).collect();
    let origin_ns = scans.iter().map(|header| header.acquired_ns).min().unwrap_or(0);
    let mut events = Vec::new();
    for role in Role::ALL {
        let lane = role.index() + 1;
        events.push(format!(
            r#"{{"ph":"M","name":"process_name","pid":{lane},"tid":{lane},"args":{{"name":"{role}"}}}}"#
        ));
        events.push(format!(
            r#"{{"ph":"M","name":"process_sort_index","pid":{lane},"tid":{lane},"args":{{"sort_index":{lane}}}}}"#
        ));
    }
    for header in scans {
        scan(&mut events, header, origin_ns);
    }
    let mut text = String::from("{\"displayTimeUnit\":\"ns\",\"traceEvents\":[\n");
    let _ = writeln!(text, "{}\n]}}", events.join(",\n"));
    text
}

fn scan(events: &mut Vec<String>, header: &Header, origin_ns: u64) {
    let us = |time_ns: u64| time_ns.saturating_sub(origin_ns) as f64 * 1e-3;
    let scan = header.scan_id;
    for (place, role) in Role::ALL.iter().enumerate() {
        let lane = role.index() + 1;
        let stamps = header.stage(*role);
        let slices = [
            ("wait", stamps.woken_ns, stamps.taken_ns),
            ("compute", stamps.taken_ns, stamps.computed_ns),
            ("publish", stamps.computed_ns, stamps.published_ns),
        ];
        for (name, from_ns, until_ns) in slices {
            if until_ns > from_ns {
                let (start, length) = (us(from_ns), (until_ns - from_ns) as f64 * 1e-3);
                events.push(format!(
                    r#"{{"ph":"X","name":"{name}","cat":"stage","pid":{lane},"tid":{lane},"ts":{start:.3},"dur":{length:.3},"args":{{"scan":{scan}}}}}"#
                ));
            }
        }
        // An arrow is bound to the slice that encloses its time.
        let (phase, at_ns) = match place {
            0 => ("s", stamps.computed_ns),
            place if place + 1 == Role::ALL.len() => ("f", stamps.taken_ns),
            _ => ("t", stamps.taken_ns),
        };
        let bound = if phase == "f" { r#","bp":"e""# } else { "" };
        events.push(format!(
            r#"{{"ph":"{phase}","name":"scan","cat":"flow","id":{scan},"pid":{lane},"tid":{lane},"ts":{:.3}{bound}}}"#,
            us(at_ns)
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::latency::chain;
    use serde_json::Value;

    #[test]
    fn each_scan_has_slices_of_all_stages_and_one_arrow_from_robot_to_actuator() {
        let mut headers = [chain(1, 5_000), chain(2, 9_000)];
        for header in &mut headers {
            let published_ns = header.scan_published_ns();
            let robot = header.stage_mut(Role::Robot);
            (robot.woken_ns, robot.taken_ns, robot.computed_ns) =
                (published_ns - 300, published_ns - 300, published_ns - 20);
        }
        let hole = Header { scan_id: 3, ..Header::default() };
        let trace: Value = serde_json::from_str(&text(&[headers[0], headers[1], hole])).unwrap();
        let events = trace["traceEvents"].as_array().unwrap();
        let of = |phase: &str| events.iter().filter(|event| event["ph"] == phase).collect::<Vec<_>>();
        assert_eq!((of("s").len(), of("t").len(), of("f").len()), (2, 6, 2), "no arrow of scan 3");
        let controller = of("X")
            .into_iter()
            .find(|event| event["pid"] == 4 && event["name"] == "compute" && event["args"]["scan"] == 1)
            .unwrap();
        assert_eq!((&controller["ts"], &controller["dur"]), (&Value::from(1.490), &Value::from(2.0)));
        for name in ["wait", "compute", "publish"] {
            let scans = of("X").iter().filter(|event| event["name"] == name).count();
            assert!(scans >= 8, "{name}");
        }
        let names: Vec<&str> = of("M").iter().filter_map(|event| event["args"]["name"].as_str()).collect();
        assert_eq!(names, ["robot", "estimator", "obstacles", "controller", "actuator"]);
    }

    #[test]
    fn nothing_makes_an_empty_trace() {
        let trace: Value = serde_json::from_str(&text(&[])).unwrap();
        assert!(trace["traceEvents"].as_array().unwrap().iter().all(|event| event["ph"] == "M"));
    }
}
