//! Pages of small and of long recordings.

use std::io::Read;

use flate2::read::ZlibDecoder;
use shared_types::Scan;

use super::*;
use crate::recorded::tests::{drive, drive_with};

/// The drive in a page.
fn content(page: &str) -> Value {
    let packed = page.split("id=\"drive\">").nth(1).unwrap().split('<').next().unwrap();
    let mut text = String::new();
    ZlibDecoder::new(&STANDARD.decode(packed).unwrap()[..]).read_to_string(&mut text).unwrap();
    serde_json::from_str(&text).unwrap()
}

/// The values of a column as `enclosed.js` computes them.
fn values(content: &Value, name: &str) -> Vec<Option<f64>> {
    let columns = content["columns"].as_array().unwrap();
    let column = columns.iter().find(|column| column["name"] == name).unwrap();
    let mut sum = 0;
    let value = |step: &Value| {
        step.as_i64().map(|step| {
            sum += step;
            sum as f64 / column["per_unit"].as_f64().unwrap()
        })
    };
    column["steps"].as_array().unwrap().iter().map(value).collect()
}

#[test]
fn a_page_has_each_scan_as_it_was_recorded() {
    let measure = |scan: &mut Scan| scan.ranges_mm[..3].copy_from_slice(&[1234, 0, 4000]);
    let file = drive_with("enclosed", 120, |_| {}, measure);
    let page = enclosed(&file.0).unwrap();
    assert_eq!((page.rows, page.frames), (120, 120));
    let content = content(&page.text);
    let x_m = values(&content, "x_m");
    assert!((1..=120).all(|scan| (x_m[scan - 1].unwrap() - 0.1 * scan as f64).abs() < 1e-9), "{x_m:?}");
    assert_eq!(values(&content, "scan_id")[119], Some(120.0));
    assert_eq!(values(&content, "clearance_m"), vec![None; 120], "there is no truth");
    let [index, frame] = [0, 1].map(|part| &content["frames"][76][part]);
    assert_eq!((index, &frame["pose"]["scan_id"]), (&json!(76), &json!(77)));
    assert_eq!(frame["scan"]["steps_cm"].as_array().unwrap()[..3], [json!(123), json!(-123), json!(400)]);
    let mut live = RecordedDrive::open(&file.0).unwrap();
    assert_eq!(content["events"], json!(live.events()));
    let processes = |frame: &Value| frame["system"]["status"]["processes"][3]["rate_hz"].clone();
    assert_eq!(processes(frame), processes(&live.frame(7.61).unwrap()));
}

#[test]
fn a_page_asks_for_nothing_outside_of_it() {
    let file = drive("alone");
    let page = enclosed(&file.0).unwrap().text;
    let own = page.replace("http://www.w3.org/2000/svg", "");
    for foreign in ["http:", "https:", "src=", "href=\"/", "url(", "from \"./"] {
        assert!(!own.contains(foreign), "{foreign}");
    }
    let map = page.split("importmap\">").nth(1).unwrap().split("</script>").next().unwrap();
    let map: Value = serde_json::from_str(map).unwrap();
    let scripts = map["imports"].as_object().unwrap();
    for (name, url) in scripts {
        let text = STANDARD.decode(url.as_str().unwrap().split("base64,").nth(1).unwrap()).unwrap();
        for asked in String::from_utf8(text).unwrap().split("from \"").skip(1) {
            let asked = asked.split('"').next().unwrap();
            assert!(scripts.contains_key(asked), "{name} asks for {asked}");
        }
    }
}

#[test]
fn a_page_of_ten_minutes_has_three_megabytes_at_most() {
    assert_three_megabytes("minutes", 6_000);
}

#[test]
#[ignore = "36000 scans"]
fn a_page_of_an_hour_has_three_megabytes_at_most() {
    assert_three_megabytes("hour", 36_000);
}

fn assert_three_megabytes(name: &str, scans: u64) {
    // Noise of some centimetres, which no compression takes away.
    let measure = |scan: &mut Scan| {
        let mut state = scan.header.scan_id;
        for range in &mut scan.ranges_mm {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            *range = 2000 + (state >> 58) as u32;
        }
    };
    let file = drive_with(name, scans, |_| {}, measure);
    let page = enclosed(&file.0).unwrap();
    assert_eq!(page.rows as u64, scans);
    assert!(page.text.len() <= MAX_BYTES && page.text.len() > MAX_BYTES / 2, "{}", page.text.len());
    let content = content(&page.text);
    let kept: Vec<u64> =
        content["frames"].as_array().unwrap().iter().map(|frame| frame[0].as_u64().unwrap()).collect();
    assert_eq!(kept[0], 0);
    // The estimator is restarted at scan 60: that is shown, whatever the distance of the frames.
    assert!(kept.windows(2).all(|pair| pair[0] < pair[1]) && kept.contains(&59), "{:?}", &kept[..20]);
}

#[test]
fn a_page_of_two_drives_has_both_along_their_way() {
    let other = |actuation: &mut shared_types::Actuation| actuation.desired_steering_rad = 0.02;
    let [a, b] = [drive("compared-a"), drive_with("compared-b", 60, other, |_| {})];
    let content = content(&compared([&a.0, &b.0]).unwrap());
    let stations = |side: usize| content["ways"][side][0]["stations"].as_array().unwrap();
    // 0.1 m a scan, so 12 m and 6 m.
    let last = |side: usize| stations(side).last().unwrap();
    assert!(last(0)[0].as_f64() > Some(11.8) && last(1)[0].as_f64() < Some(6.1), "{content}");
    // Place, position across the course, speed, steering, clearance: there is no truth.
    assert_eq!((&last(0)[1], &last(1)[3], &last(1)[4]), (&json!(0.0), &json!(0.02), &Value::Null));
    assert_ne!(last(0)[3], last(1)[3]);
    assert_eq!(content["compared"]["drives"], json!([1, 1]));
    assert!(content["sentences"][0].as_str().unwrap().starts_with("they do not part"), "{content}");
    assert_eq!(content["names"][1], b.0.display().to_string());
}
