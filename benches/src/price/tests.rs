use plan::Choice;

use super::*;

/// A row without figures.
pub(super) fn row(varied: Varied, latency_ms: f64, rate_hz: f64, pose_sigma_m: f64) -> Row {
    Row {
        varied,
        latency_ms,
        rate_hz,
        pose_sigma_m,
        radius_m: None,
        smallest_gap_m: None,
        stopping_distance_m: None,
        speed_mps: None,
        notes: Vec::new(),
    }
}

fn price() -> Price {
    let latency = |latency_ms: f64, gap_m: f64, stopping_m: f64| Row {
        smallest_gap_m: Some(gap_m),
        stopping_distance_m: Some(stopping_m),
        speed_mps: Some(1.0),
        ..row(Varied::Latency, latency_ms, 10.0, 0.0)
    };
    let refused = Row { notes: vec!["no safe speed".to_owned()], ..row(Varied::Rate, 0.0, 5.0, 0.0) };
    let sigma = Row { smallest_gap_m: Some(0.9), ..row(Varied::PoseSigma, 0.0, 10.0, 0.02) };
    let rows = vec![latency(0.0, 0.8, 0.3), latency(100.0, 1.0, 0.4), refused, sigma];
    Price { costs: Costs::of(&rows, 10.0), rows, body_width_m: 0.4, contacts: 0 }
}

#[test]
fn the_table_is_in_centimetres_and_names_what_is_missing() {
    let text = text::text(&price());
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(
        lines,
        [
            "condition           smallest gap  beyond the body  stopping distance       speed",
            "latency +0 ms              80 cm            40 cm            30.0 cm    1.00 m/s",
            "latency +100 ms           100 cm            60 cm            40.0 cm    1.00 m/s",
            "rate 5 Hz                      -                -                  -           -",
            "pose sigma 2 cm            90 cm            50 cm                  -           -",
            "rate 5 Hz: no safe speed",
            "",
            "10 ms of latency cost 2.0 cm of gap and 1.0 cm of stopping distance.",
            "Half the scan rate costs an unknown amount of gap and an unknown amount of stopping distance.",
            "1 cm of pose sigma costs an unknown amount of gap and an unknown amount of stopping distance.",
            "Each cost is the slope of the least-squares line through its rows.",
        ]
    );
}

#[test]
fn the_json_has_the_keys_of_the_interface_and_null_where_nothing_was_measured() {
    let json = serde_json::to_value(price()).unwrap();
    let row = &json["rows"][0];
    for (key, value) in [
        ("latency_ms", 0.0),
        ("rate_hz", 10.0),
        ("pose_sigma_m", 0.0),
        ("smallest_gap_m", 0.8),
        ("stopping_distance_m", 0.3),
    ] {
        assert_eq!(row[key].as_f64(), Some(value), "{key}");
    }
    let refused = json["rows"][2].as_object().unwrap();
    assert!(refused["smallest_gap_m"].is_null() && refused["stopping_distance_m"].is_null());
    assert_eq!(json["rows"][3]["varied"], "pose_sigma");
    assert!((json["costs"]["latency_10_ms"]["gap_m"].as_f64().unwrap() - 0.02).abs() < 1e-12);
}

#[test]
fn the_picture_has_three_panels_with_their_axes() {
    let svg = picture::draw(&price()).unwrap();
    for text in
        ["added latency [ms]", "scan period [ms]", "pose sigma [cm]", "smallest gap", "stopping distance"]
    {
        assert!(svg.contains(text), "{text}");
    }
}

#[test]
fn a_condition_is_measured_by_driving() {
    let figures = figures_at(10.0);
    assert_eq!((figures.contacts, figures.notes.len()), (0, 0), "{figures:?}");
    let gap_m = figures.smallest_gap_m.unwrap();
    assert!((0.4..=2.0).contains(&gap_m), "wider than the body: {gap_m}");
    // The speed is reached within 1 %, and wheels that are blocked at 1 m/s slide at least v^2 / 2 a = 0.1 m.
    let (speed_mps, stopping_m) = (figures.speed_mps.unwrap(), figures.stopping_distance_m.unwrap());
    assert!(speed_mps <= 1.01 && stopping_m > 0.98 * speed_mps.powi(2) / 10.0, "{figures:?}");
    // At half the rate the box is seen up to 0.1 s later, and the end of the sweep comes 0.033 s later.
    let slower = figures_at(5.0).stopping_distance_m.unwrap();
    assert!((slower - stopping_m - 0.133 * speed_mps).abs() < 0.03, "{slower} after {stopping_m}");
}

#[test]
fn a_later_command_stops_the_robot_as_much_later_as_it_drives_meanwhile() {
    let stopping = |latency_ms| {
        let latency = |condition: &Condition| condition.latency_ms == latency_ms;
        figures(&[], latency).stopping_distance_m.unwrap()
    };
    let longer_m = stopping(100.0) - stopping(0.0);
    // 100 ms at 1 m/s; the places of the box are 2.5 mm apart, and the delay jitters by some milliseconds.
    assert!((longer_m - 0.1).abs() < 0.02, "{longer_m}");
}

#[test]
fn a_robot_that_brakes_worse_than_described_is_a_contact_and_no_figure() {
    let set = ["vehicle.blocked_deceleration_mps2=50.0", "robot.blocked_deceleration_mps2=0.3"];
    let figures = figures(&[set[0], set[1], "vehicle.sudden_m=0.6"], |_| true);
    assert_eq!(figures.stopping_distance_m, None);
    let is_named = |note: &String| note.starts_with("contact: ") && note.ends_with("0.6 m ahead");
    assert!(figures.contacts > 0 && figures.notes.iter().any(is_named), "{figures:?}");
}

/// The figures of one seed, at a rate.
fn figures_at(rate_hz: f64) -> Figures {
    figures(&[&format!("rate_hz={rate_hz}"), &format!("controller.period_s={}", rate_hz.recip())], |_| true)
}

/// The figures of one seed under the first condition that is picked.
fn figures(set: &[&str], pick: impl Fn(&Condition) -> bool) -> Figures {
    let overrides = set.iter().map(|text| (*text).to_owned()).collect();
    let choice = Choice { overrides, ..Choice::default() };
    let arguments = PriceArguments { choice, seeds: 1, ..PriceArguments::default() };
    let condition = condition::all(&condition::base(&arguments).unwrap())
        .into_iter()
        .find(|condition| pick(condition))
        .unwrap();
    measure::on_all_cores(&Measurement::of_conditions(&arguments, &[condition]), || ()).unwrap().remove(0)
}
