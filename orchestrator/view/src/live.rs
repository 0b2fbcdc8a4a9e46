//! A running system as a source.

use serde_json::{Value, json};
use shared_types::Role;

use crate::actions::Verb;
use crate::course::{Goals, course};
use crate::events::Events;
use crate::follower::{Follower, News};
use crate::scene::Scene;
use crate::source::{Source, Update};

/// Time between two states of the system [s].
const SYSTEM_S: f64 = 0.5;

/// The running system of one id, whenever there is one.
pub(crate) struct Live {
    system_id: String,
    verbs: Vec<Verb>,
    follower: Follower,
    scene: Scene,
    events: Events,
    course: Value,
    goals: Goals,
    had_one: bool,
    next_system_s: f64,
}

impl Live {
    /// Waits for a system of that id.
    ///
    /// # Errors
    /// A thread that can't be started.
    pub(crate) fn new(system_id: &str, verbs: Vec<Verb>) -> anyhow::Result<Self> {
        Ok(Self {
            system_id: system_id.to_owned(),
            verbs,
            follower: Follower::start(system_id)?,
            scene: Scene::default(),
            events: Events::default(),
            course: Value::Null,
            goals: Goals::default(),
            had_one: false,
            next_system_s: 0.0,
        })
    }

    /// A directory that a dead run left behind is no system: one that lives answers or publishes.
    fn connection(&mut self) -> &'static str {
        let is_alive = self.follower.status().is_some() || self.scene.samples.newest_scan() > 0;
        let is_live = self.follower.domain().is_some() && is_alive;
        self.had_one |= is_live;
        match (is_live, self.had_one) {
            (true, _) => "live",
            (false, true) => "over",
            (false, false) => "waiting",
        }
    }

    fn system(&mut self, now_s: f64) -> String {
        let connection = self.connection();
        let domain = self.follower.domain();
        if let Some(domain) = domain.filter(|_| self.course.is_null()) {
            let file = runtime::settings_file(Role::Controller);
            (self.course, self.goals) = course(&domain.folder().read_text(&file).unwrap_or_default());
        }
        json!({
            "time_s": now_s,
            "connection": connection,
            "system_id": self.system_id,
            "run_id": domain.map(runtime::Domain::run_id),
            "status": self.follower.status(),
            "status_age_s": self.follower.silent_s(),
            "course": self.course,
            "authority": domain.map(|_| self.scene.authority()),
            "latency_us": domain.and_then(|_| self.scene.latency()),
            "actions": self.verbs.iter().map(|verb| verb.name()).collect::<Vec<_>>(),
        })
        .to_string()
    }
}

impl Source for Live {
    fn poll(&mut self, now_s: f64) -> Update {
        let Self { follower, scene, events, course, goals, next_system_s, system_id, .. } = self;
        events.set_time(now_s);
        follower.poll(|news| {
            match news {
                News::Found(_) => {
                    events.start(system_id);
                    (*course, *next_system_s) = (Value::Null, now_s);
                }
                News::Gone => {
                    events.end();
                    *next_system_s = now_s;
                }
                _ => {}
            }
            scene.take(news, events, now_s);
        });
        scene.show_goals(goals);
        let row = follower.domain().and_then(|_| scene.next_row(now_s));
        let mut update = Update { frame: row.map(|row| scene.samples.frame(row)), ..Update::default() };
        if now_s >= self.next_system_s {
            self.next_system_s = now_s + SYSTEM_S;
            update.system = Some(self.system(now_s));
        }
        update.events = self.events.take();
        update
    }
}
