//! What an agent refuses.

use shared_types::Role;

use super::*;

fn agent() -> Agent {
    let file = AgentFile {
        name: "lab".to_owned(),
        implementations: vec!["nmpc".to_owned()],
        ..AgentFile::default()
    };
    Agent {
        file,
        logs: PathBuf::new(),
        link: None,
        link_ended_ns: 0,
        served: None,
        offset_ns: None,
        connected_ns: None,
        watched_ns: 0,
    }
}

fn down(version: &str) -> Down {
    Down {
        version: version.to_owned(),
        system_id: "main".to_owned(),
        run_id: "abcdefghij".to_owned(),
        incarnation: 7,
        role: Role::Controller,
        order: Order::Start,
        stopped: false,
        start: None,
    }
}

#[test]
fn an_orchestrator_of_another_version_or_with_other_samples_is_refused_by_name() {
    let own = link_version();
    assert_eq!(agent().refuses(&down(&own)), None);
    let (version, samples) = own.split_once(' ').unwrap();
    for other in [format!("9.9.9 {samples}"), format!("{version} 0123456789abcdef")] {
        let reason = agent().refuses(&down(&other)).unwrap();
        assert!(reason.contains(&own) && reason.contains(&other), "{reason}");
    }
}
