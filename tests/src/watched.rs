//! What a running system does, as `scanloop topic` and `scanloop replay` show it.

use serde_json::{Value, json};

use crate::TestSystem;

impl TestSystem {
    /// The newest sample of a topic; nothing while none comes.
    pub fn newest(&self, topic: &str) -> Value {
        let output = self.run(&["topic", "echo", topic, "-n", "1", "--short"]);
        serde_json::from_slice(&output.stdout).unwrap_or_default()
    }

    /// Waits until the true wheels are blocked and the robot stands; returns where [m].
    pub fn await_rest(&self) -> [f64; 2] {
        self.wait_until("the robot stands", |system| {
            let truth = system.newest("truth");
            truth["blocked"] == 1 && truth["speed_mps"].as_f64() == Some(0.0)
        });
        let truth = self.newest("truth");
        ["x_m", "y_m"].map(|key| truth[key].as_f64().expect("a number"))
    }

    /// Panics unless the recording of the run that has ended is replayed to the bit, with no sample left out.
    pub fn assert_replayed(&self) {
        let recording = self.report().recording.expect("a recording").file;
        let output = self.run(&["replay", "--json", recording.to_str().expect("a readable path")]);
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let replayed: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        assert_eq!((&replayed["skipped"], &replayed["differences"]), (&json!(0), &json!([])));
    }
}
