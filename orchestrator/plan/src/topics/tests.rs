//! Systems with topics and companions that are allowed, and those that are not.

use std::path::PathBuf;

use super::*;
use crate::system::BUILT_IN;

/// A folder with a layout file, removed when dropped.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("scanloop-topics-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        let layout = "name = \"Imu\"\n[[field]]\nname = \"yaw_rate_radps\"\ntype = \"f64\"\ndoc = \"Yaw rate [rad/s]\"\n";
        std::fs::write(path.join("imu.toml"), layout).unwrap();
        Self(path)
    }

    /// The built-in system with more tables.
    fn system(&self, more: &str) -> anyhow::Result<System> {
        let text = format!("{BUILT_IN}\n{more}");
        System::from_table(text.parse().unwrap(), &self.0.join("lab.toml").display().to_string())
    }

    fn error(&self, more: &str) -> String {
        let message = self.system(more).unwrap_err().to_string();
        message.rsplit_once("lab.toml: ").map_or(message.clone(), |(_, rest)| rest.to_owned())
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

const TOPIC: &str = "[[topic]]\nname = \"imu\"\nlayout = \"imu.toml\"\n";

fn companion(name: &str, more: &str) -> String {
    format!("[[process]]\nrole = \"companion\"\nname = \"{name}\"\ncommand = [\"./{name}\"]\n{more}\n")
}

fn writer(name: &str) -> String {
    companion(name, "reads = [\"odometry\"]\nwrites = [\"imu\"]")
}

#[test]
fn a_companion_and_its_topic_are_in_the_table() {
    let folder = Folder::new("table");
    let system = folder.system(&format!("{TOPIC}{}", writer("sensor"))).unwrap();
    let table = read(&system, &folder.0.join("lab.toml").display().to_string()).unwrap();
    let row = &table.topic[0];
    assert_eq!((row.name.as_str(), row.writer.as_str(), row.queue, row.readers), ("imu", "sensor", 4, 8));
    assert_eq!(row.layout.own_type().unwrap().size(), 288 + 8 + 32);
    assert_eq!(table.companion[0].reads, ["odometry"]);
    assert!(table.companion[0].lockstep);
    assert!(table.bytes().unwrap() > 0);
}

#[test]
fn names_writers_and_readers_that_do_not_fit_are_refused() {
    let folder = Folder::new("refused");
    let nothing = folder.error(TOPIC);
    assert_eq!(nothing, "topic[0].name = imu is not allowed: a writer: no process writes topic imu");
    let two = folder.error(&format!("{TOPIC}{}{}", writer("one"), writer("other")));
    assert_eq!(two, "topic[0].name = imu is not allowed: one writer; one and other would write it");
    let by_hand = folder.error(&format!("{TOPIC}writer = \"operator\"\n{}", writer("one")));
    assert_eq!(by_hand, "topic[0].name = imu is not allowed: one writer; one and operator would write it");
    let twice = folder.error(&format!("{TOPIC}{TOPIC}{}", writer("one")));
    assert_eq!(twice, "topic[1].name = imu is not allowed: each name once");
    let same = folder.error(&format!("{TOPIC}{}{}", writer("one"), companion("one", "")));
    assert_eq!(same, "process[6].name = one is not allowed: each name once");
    let of_loop = folder.error(&TOPIC.replace("\"imu\"", "\"scan\""));
    assert_eq!(of_loop, "topic[0].name = scan is not allowed: another name: the loop has this topic");
    let writes = folder.error(&companion("bad", "writes = [\"command\"]"));
    assert!(
        writes.starts_with("process[5].writes = command is not allowed: a topic of your own"),
        "{writes}"
    );
    let truth = folder.error(&companion("spy", "reads = [\"truth\"]"));
    assert!(
        truth.starts_with("process[5].reads = truth is not allowed: with `reads_truth = true`"),
        "{truth}"
    );
    let role = folder.error(&companion("controller", ""));
    assert!(role.starts_with("process[5].name = controller is not allowed: no name of a role"), "{role}");
    let also = folder.error("[[process]]\nrole = \"companion\"\nname = \"x\"\ncommand = [\"x\"]\nalso_reads = [{topic = \"imu\"}]");
    assert!(also.starts_with("process[5].also_reads"), "{also}");
    let place = BUILT_IN.replace(
        "role = \"controller\"\nimplementation = \"nmpc\"",
        "role = \"companion\"\nname = \"mine\"\ncommand = [\"x\"]",
    );
    let missing = System::from_table(place.parse().unwrap(), "lab.toml").unwrap_err().to_string();
    assert!(missing.contains("no process of role controller"), "{missing}");
}

#[test]
fn a_layout_with_a_hole_or_without_fields_is_refused_with_its_file() {
    let folder = Folder::new("layout");
    let more = format!("{TOPIC}{}", writer("sensor"));
    std::fs::write(folder.0.join("imu.toml"), "name = \"Imu\"\n").unwrap();
    assert!(
        folder.system(&more).unwrap_err().to_string().contains("imu.toml: line 1: field = [] is not allowed")
    );
    let field = |name: &str, kind: &str| format!("[[field]]\nname = \"{name}\"\ntype = \"{kind}\"\n");
    let hole = format!("name = \"Imu\"\n{}{}", field("a", "u32"), field("b", "f64"));
    std::fs::write(folder.0.join("imu.toml"), hole).unwrap();
    let message = folder.system(&more).unwrap_err().to_string();
    assert!(
        message.contains("imu.toml: line 7: b = a field that begins at byte 292 is not allowed: no hole"),
        "{message}"
    );
    std::fs::remove_file(folder.0.join("imu.toml")).unwrap();
    assert!(folder.system(&more).unwrap_err().to_string().contains("imu.toml: "));
}

#[test]
fn a_circle_of_processes_is_refused_by_their_names() {
    let folder = Folder::new("circle");
    let own = |also: &str| {
        BUILT_IN
            .replace("implementation = \"ekf\"", &format!("command = [\"./mine\"]\nalso_reads = [{also}]"))
    };
    let with = |text: String, more: &str| {
        let file = folder.0.join("lab.toml").display().to_string();
        System::from_table(format!("{text}\n{TOPIC}{more}").parse().unwrap(), &file)
    };
    let circle =
        with(own("{topic = \"imu\"}"), &companion("sensor", "reads = [\"pose\"]\nwrites = [\"imu\"]"));
    let message = circle.unwrap_err().to_string();
    assert!(message.contains("sensor -> estimator -> sensor"), "{message}");
    assert!(with(own("{topic = \"imu\"}"), &writer("sensor")).is_ok());
    assert!(with(own(""), &companion("sensor", "reads = [\"pose\"]\nwrites = [\"imu\"]")).is_ok());
}

#[test]
fn a_companion_in_front_of_the_roles_is_not_taken_for_one() {
    let folder = Folder::new("first");
    let (head, rest) = BUILT_IN.split_once("[[process]]").unwrap();
    let text = format!("{head}{TOPIC}{}\n[[process]]{rest}", writer("sensor"));
    let file = folder.0.join("lab.toml").display().to_string();
    let system = System::from_table(text.parse().unwrap(), &file).unwrap();
    assert!(system.processes[0].is_companion() && system.emulates_robot());
}

#[test]
fn a_bound_names_a_field_of_the_layout() {
    let folder = Folder::new("agree");
    let with = |agree: &str| format!("{TOPIC}agree = [{agree}]\n{}", writer("sensor"));
    let file = folder.0.join("lab.toml").display().to_string();
    let read = |agree: &str| read(&folder.system(&with(agree)).unwrap(), &file);
    let table = read("{ field = \"yaw_rate_radps\", bound = 0.05 }").unwrap();
    assert_eq!(table.topic[0].agree, [("yaw_rate_radps".to_owned(), 0.05)]);
    let message = folder.error(&with("{ field = \"yaw\", bound = 0.05 }"));
    assert!(
        message.ends_with(
            "agree.field = yaw is not allowed: one of yaw_rate_radps. Did you mean `yaw_rate_radps`?"
        ),
        "{message}"
    );
    let message = folder.error(&with("{ field = \"yaw_rate_radps\", bound = -1.0 }"));
    assert!(
        message.starts_with("topic[0].agree[0].bound = -1") || message.contains("bound = -1"),
        "{message}"
    );
}

#[test]
fn topics_that_take_more_than_half_of_shared_memory_are_refused_with_the_sum() {
    let folder = Folder::new("memory");
    let large = "name = \"Imu\"\n[[field]]\nname = \"image\"\ntype = \"u8[4000000]\"\n";
    std::fs::write(folder.0.join("imu.toml"), large).unwrap();
    let mut more = writer("sensor");
    let names: Vec<String> = (0..40).map(|number| format!("t{number}")).collect();
    for name in &names {
        more += &TOPIC
            .replace("\"imu\"", &format!("\"{name}\""))
            .replace("[[topic]]", "[[topic]]\nqueue = 256\nreaders = 24");
    }
    let quoted: Vec<String> = names.iter().map(|name| format!("\"{name}\"")).collect();
    let message = folder.error(&more.replace("\"imu\"", &quoted.join(", ")));
    assert!(message.contains("at most half of /dev/shm"), "{message}");
    assert!(message.contains("40 topics with "), "{message}");
}
