//! One line that shows a running loop: a live line on a terminal, one plain line per second elsewhere.
//!
//! The text of the line is a pure function of [`View`] and the states of the processes; only [`Progress`] and `Steps`
//! write to standard error, through the queue of `runtime`, so that no run waits for its terminal. A line that is wider
//! than its columns is shortened: first without the time, then with the first three letters of role names, then cut off.

use std::time::{Duration, Instant};

use runtime::{Priority, show_live_line, start_terminal};
use shared_types::{Blocking, Role, ScannerHealth};

/// Width of a plain line.
pub const COLUMNS: usize = 100;

/// Width of the live line: that of the narrowest usual terminal, because the rest of a longer line is not visible.
pub const TERMINAL_COLUMNS: usize = 80;

/// Time between two plain lines.
const PLAIN_PERIOD: Duration = Duration::from_secs(1);

/// Least time between two drawings of the live line.
const LIVE_PERIOD: Duration = Duration::from_millis(100);

/// What the line shows of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct View {
    /// Driven time [s].
    pub time_s: f64,
    /// Distance to the goal, once it is known [m].
    pub goal_distance_m: Option<f64>,
    /// Speed over ground [m/s].
    pub speed_mps: f64,
    /// Steering angle at the wheels [rad].
    pub steering_rad: f64,
    /// Median and largest reaction time of the last second, once there is one [ms].
    pub reaction_ms: Option<[f64; 2]>,
    /// Whether time is simulated, so that reaction times mean nothing.
    pub lockstep: bool,
    /// The obstacle that the wheels are blocked for.
    pub blocking: Option<Blocking>,
    /// The scanner that the wheels are blocked for.
    pub scanner: Option<ScannerHealth>,
}

/// The name of the state of one process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProcessLabel<'a> {
    /// Its role.
    pub role: Role,
    /// Its state; a process that is `ready` is shown by a dot.
    pub state: &'a str,
}

/// Where progress is shown.
#[derive(Debug)]
pub enum Progress {
    /// On a terminal: one line that is redrawn.
    Live(Pace),
    /// Elsewhere: one line per second.
    Plain(Pace),
    /// Nowhere.
    Quiet,
}

/// Limits an action to once per period.
#[derive(Debug)]
pub struct Pace {
    period: Duration,
    last: Option<Instant>,
}

impl Pace {
    fn new(period: Duration) -> Self {
        Self { period, last: None }
    }

    fn is_due(&mut self, now: Instant) -> bool {
        let due = self.last.is_none_or(|last| now.saturating_duration_since(last) >= self.period);
        if due {
            self.last = Some(now);
        }
        due
    }
}

impl Progress {
    /// Progress for this standard error: live on a terminal, plain elsewhere, none when `quiet`.
    pub fn new(quiet: bool) -> Self {
        // The journal is for events; systemd receives the line as its status.
        if quiet || runtime::writes_to_journal() {
            return Self::Quiet;
        }
        if !runtime::is_terminal() {
            return Self::Plain(Pace::new(PLAIN_PERIOD));
        }
        start_terminal();
        Self::Live(Pace::new(LIVE_PERIOD))
    }

    /// Shows the state of the loop; ten calls a second are as good as more.
    pub fn update(&mut self, now: Instant, view: &View, processes: &[ProcessLabel<'_>]) {
        match self {
            Self::Live(pace) => {
                if pace.is_due(now) {
                    show_live_line(Some(&line(view, processes, TERMINAL_COLUMNS)));
                }
            }
            Self::Plain(pace) => {
                if pace.is_due(now) {
                    runtime::print(Priority::Info, &line(view, processes, COLUMNS));
                }
            }
            Self::Quiet => {}
        }
    }

    /// Writes a line of text, above the live line; with `--quiet` too, because such lines are rare and important.
    pub fn note(&self, text: &str) {
        runtime::print(Priority::Notice, text);
    }

    /// [`Progress::note`] for a warning.
    pub fn warn(&self, text: &str) {
        runtime::print(Priority::Warning, text);
    }

    /// Takes the live line away.
    pub fn finish(&mut self) {
        if matches!(self, Self::Live(_)) {
            show_live_line(None);
        }
    }
}

/// A live line that counts steps of known number, on a terminal only: `12/500 courses, 3 s`.
#[derive(Debug)]
pub struct Steps {
    what: &'static str,
    total: u64,
    done: u64,
    started: Instant,
    pace: Pace,
}

impl Steps {
    /// Nothing is done yet.
    pub fn new(total: u64, what: &'static str) -> Self {
        if runtime::is_terminal() {
            start_terminal();
        }
        Self { what, total, done: 0, started: Instant::now(), pace: Pace::new(LIVE_PERIOD) }
    }

    /// One step more; `note` stands at the end of the line.
    pub fn step(&mut self, note: &str) {
        self.done += 1;
        let now = Instant::now();
        if runtime::is_terminal() && self.pace.is_due(now) {
            let seconds = (now - self.started).as_secs();
            let Self { what, total, done, .. } = self;
            show_live_line(Some(&format!("{done}/{total} {what}, {seconds} s{note}")));
        }
    }
}

impl Drop for Steps {
    /// Takes the line away.
    fn drop(&mut self) {
        show_live_line(None);
    }
}

/// The line for a state of the loop, at most `columns` wide.
pub fn line(view: &View, processes: &[ProcessLabel<'_>], columns: usize) -> String {
    let figures = figures(view);
    let time = format!("{:6.1} s", view.time_s);
    let candidates = [
        format!("{time}  {figures}  {}", names(processes, 10)),
        format!("{figures}  {}", names(processes, 10)),
        format!("{time}  {figures}  {}", names(processes, 3)),
        format!("{figures}  {}", names(processes, 3)),
    ];
    let fits = |text: &&String| text.chars().count() <= columns;
    let chosen = candidates.iter().find(fits).unwrap_or(&candidates[3]);
    chosen.chars().take(columns).collect()
}

fn figures(view: &View) -> String {
    let goal = view.goal_distance_m.map_or("goal ?".to_owned(), |distance| format!("goal {distance:.2} m"));
    let reaction = match (view.lockstep, view.reaction_ms) {
        (true, _) => "lock-step".to_owned(),
        (false, None) => "-/- ms".to_owned(),
        (false, Some([median, largest])) => format!("{median:.1}/{largest:.1} ms"),
    };
    if let Some(blocking) = &view.blocking {
        return format!("{goal}  blocked by {blocking}");
    }
    if let Some(scanner) = &view.scanner {
        return format!("{goal}  scanner {scanner}");
    }
    format!("{goal}  {:.2} m/s  {:+.3} rad  {reaction}", view.speed_mps, view.steering_rad)
}

/// `controller●` for a process that is ready, else its state: `controller hung`.
fn names(processes: &[ProcessLabel<'_>], letters: usize) -> String {
    let names = processes.iter().map(|process| {
        let name: String = process.role.name().chars().take(letters).collect();
        if process.state == "ready" { format!("{name}\u{25cf}") } else { format!("{name} {}", process.state) }
    });
    names.collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn processes(controller: &str) -> [ProcessLabel<'_>; 5] {
        [Role::Robot, Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator].map(|role| {
            ProcessLabel { role, state: if role == Role::Controller { controller } else { "ready" } }
        })
    }

    const VIEW: View = View {
        time_s: 12.34,
        goal_distance_m: Some(7.456),
        speed_mps: 0.82,
        steering_rad: 0.0314,
        reaction_ms: Some([1.84, 2.91]),
        lockstep: false,
        blocking: None,
        scanner: None,
    };

    #[test]
    fn the_line_shows_goal_speed_steering_latency_and_all_processes() {
        assert_eq!(
            line(&VIEW, &processes("ready"), COLUMNS),
            "goal 7.46 m  0.82 m/s  +0.031 rad  1.8/2.9 ms  \
             robot\u{25cf} estimator\u{25cf} obstacles\u{25cf} controller\u{25cf} actuator\u{25cf}"
        );
    }

    #[test]
    fn a_process_that_is_not_ready_is_shown_in_words_and_names_make_room_for_it() {
        assert_eq!(
            line(&VIEW, &processes("backoff"), COLUMNS),
            "  12.3 s  goal 7.46 m  0.82 m/s  +0.031 rad  1.8/2.9 ms  \
             rob\u{25cf} est\u{25cf} obs\u{25cf} con backoff act\u{25cf}"
        );
    }

    #[test]
    fn a_narrow_terminal_shows_all_processes_too() {
        assert_eq!(
            line(&VIEW, &processes("ready"), TERMINAL_COLUMNS),
            "goal 7.46 m  0.82 m/s  +0.031 rad  1.8/2.9 ms  rob\u{25cf} est\u{25cf} obs\u{25cf} con\u{25cf} act\u{25cf}"
        );
    }

    #[test]
    fn a_stop_for_an_obstacle_is_named_with_the_gap_it_sees_and_needs() {
        let blocking = Blocking { x_m: 12.0, y_m: -0.1, gap_m: 0.12, needed_m: 0.62, id: 17, reserved: 0 };
        let view = View { blocking: Some(blocking), ..VIEW };
        let expected = "goal 7.46 m  blocked by obstacle 17 at (12.0, -0.1): gap 0.12 m, needs 0.62 m";
        for columns in [COLUMNS, TERMINAL_COLUMNS] {
            let text = line(&view, &processes("ready"), columns);
            assert!(text.starts_with(expected), "{text}");
        }
    }

    #[test]
    fn a_stop_for_the_scanner_is_explained() {
        let scanner = ScannerHealth { state: 2, blind_s: 0.4, ..ScannerHealth::default() };
        let text = line(&View { scanner: Some(scanner), ..VIEW }, &processes("ready"), TERMINAL_COLUMNS);
        assert!(text.starts_with("goal 7.46 m  scanner blind: no new ranges for 0.4 s"), "{text}");
    }

    #[test]
    fn no_line_is_wider_than_its_columns() {
        for view in
            [View { goal_distance_m: Some(1e300), ..VIEW }, View { speed_mps: f64::NAN, ..VIEW }, VIEW]
        {
            for state in ["ready", "starting", &"x".repeat(300)] {
                for columns in [COLUMNS, TERMINAL_COLUMNS, 0] {
                    assert!(line(&view, &processes(state), columns).chars().count() <= columns);
                }
            }
        }
    }

    #[test]
    fn a_loop_without_answers_or_with_simulated_time_shows_no_latency() {
        let text = line(&View { reaction_ms: None, goal_distance_m: None, ..VIEW }, &[], COLUMNS);
        assert!(text.contains("goal ?") && text.contains("-/- ms"), "{text}");
        assert!(line(&View { lockstep: true, ..VIEW }, &[], COLUMNS).contains("lock-step"));
    }
}
