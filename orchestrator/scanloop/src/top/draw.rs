//! The picture of a [`Model`] in a terminal of any size.

use ratatui_core::buffer::Buffer;
use ratatui_core::layout::Rect;
use ratatui_core::style::{Color, Modifier, Style};
use session::control::{ProcessStatus, SystemStatus};
use shared_types::{Pose, Role, ScannerState, StopReason};
use vehicle::Goal;
use vehicle::course::ellipse_point;
use vehicle::frame::to_track;

use super::canvas::Canvas;
use super::model::{Course, Model};
use super::reasons::Reasons;

/// The smallest terminal in which all fits [columns, rows].
const SMALLEST: [u16; 2] = [72, 20];
/// Columns of the latency.
const LATENCY_COLUMNS: u16 = 30;
/// Rows of the last events.
const EVENT_ROWS: u16 = 4;
/// Rows of processes: one for each role, and two for candidates.
const PROCESS_ROWS: u16 = 7;
/// What the map shows at least, and how much of it is behind the robot [m].
const MAP_M: [f64; 2] = [8.0, 3.4];
const BEHIND_M: f64 = 2.0;
/// Points around an ellipse.
const ELLIPSE_POINTS: usize = 24;
/// Eighths of a cell.
const BARS: [&str; 9] =
    [" ", "\u{2581}", "\u{2582}", "\u{2583}", "\u{2584}", "\u{2585}", "\u{2586}", "\u{2587}", "\u{2588}"];
const STAGES: [&str; 5] = ["estimator", "obstacles", "controller", "actuator", "transport"];

const DIM: Style = Style::new().fg(Color::DarkGray);
const TITLE: Style = Style::new().add_modifier(Modifier::BOLD);
const WARNING: Style = Style::new().fg(Color::Yellow).add_modifier(Modifier::BOLD);

/// Draws all.
pub(super) fn draw(area: Rect, buffer: &mut Buffer, model: &Model) {
    if area.width < SMALLEST[0] || area.height < SMALLEST[1] {
        let text = format!("the terminal is too small: {} x {} needed", SMALLEST[0], SMALLEST[1]);
        return print(buffer, area, 0, &text, WARNING);
    }
    title(row(area, 0), buffer, model);
    motion(row(area, 1), buffer, model);
    let processes = Rect { y: area.y + 2, height: PROCESS_ROWS + 1, ..area };
    if model.help || model.reasons.is_none() {
        process_table(processes, buffer, model);
    }
    let top = processes.bottom();
    let bottom = area.bottom() - EVENT_ROWS - 1;
    let middle = Rect { y: top, height: bottom - top, ..area };
    if model.help {
        help(middle, buffer, model);
    } else if let Some(shown) = &model.reasons {
        reasons(Rect { y: area.y + 2, height: bottom - area.y - 2, ..area }, buffer, shown);
    } else {
        let map_columns = middle.width - LATENCY_COLUMNS - 1;
        map(Rect { width: map_columns, ..middle }, buffer, model);
        latency(Rect { x: middle.x + map_columns + 1, width: LATENCY_COLUMNS, ..middle }, buffer, model);
    }
    events(Rect { y: bottom, height: EVENT_ROWS, ..area }, buffer, model);
    keys(row(area, area.height - 1), buffer, model);
}

fn row(area: Rect, row: u16) -> Rect {
    Rect { y: area.y + row, height: 1, ..area }
}

/// Writes a line at a row of an area, cut at its edge.
fn print(buffer: &mut Buffer, area: Rect, at: u16, text: &str, style: Style) {
    if at < area.height {
        buffer.set_stringn(
            area.x,
            area.y + at,
            runtime::printable(text).replace(['\n', '\t'], " "),
            usize::from(area.width),
            style,
        );
    }
}

fn title(area: Rect, buffer: &mut Buffer, model: &Model) {
    let style = Style::new().add_modifier(Modifier::REVERSED);
    buffer.set_style(area, style);
    let Some(SystemStatus { state, scenario, scan, lockstep, .. }) = &model.status else {
        return print(buffer, area, 0, &format!(" {}: waiting for the system", model.system_id), style);
    };
    let left =
        format!(" {}: {state}, {scenario}{}", model.system_id, if *lockstep { ", lock-step" } else { "" });
    print(buffer, area, 0, &left, style);
    let right = format!("scan {scan} ");
    let shift = area.width.saturating_sub(right.chars().count() as u16);
    print(buffer, Rect { x: area.x + shift, width: area.width - shift, ..area }, 0, &right, style);
}

/// Motion and what blocks the wheels.
fn motion(area: Rect, buffer: &mut Buffer, model: &Model) {
    if let Some(text) = &model.trouble {
        return print(buffer, area, 0, &format!(" {text}"), WARNING);
    }
    let status = model.status.as_ref();
    let scanner = status.and_then(|status| status.scanner.as_ref());
    let scanner = scanner.filter(|scanner| scanner.state != ScannerState::Healthy.name());
    if let Some(blocking) = status.and_then(|status| status.blocking) {
        return print(buffer, area, 0, &format!(" stopped: blocked by {blocking}"), WARNING);
    }
    if let Some(scanner) = scanner {
        return print(buffer, area, 0, &format!(" scanner {}", scanner.explanation), WARNING);
    }
    let mut text = String::new();
    if let Some(pose) = &model.pose {
        let speed_mps = model.truth.map_or(pose.speed_mps, |truth| truth.speed_mps);
        let goal_m = model.course.to_goal_m(pose);
        text += &format!(
            " x {:.2}  y {:+.2} m  speed {speed_mps:.2} m/s  goal {goal_m:.1} m",
            pose.x_m, pose.y_m
        );
    }
    if let Some(actuation) = &model.actuation {
        text += &format!("  steer {:+.3} rad", actuation.desired_steering_rad);
    }
    if let Some(truth) = &model.truth {
        text += &format!("  clear {:.2} m", truth.clearance_m);
    }
    if model.is_blocked() {
        let reason = model.actuation.and_then(|actuation| StopReason::try_from(actuation.stop_reason).ok());
        let reason = reason.filter(|reason| *reason != StopReason::None).map_or("", StopReason::name);
        return print(buffer, area, 0, &format!(" wheels blocked {reason} {text}"), WARNING);
    }
    print(buffer, area, 0, &text, Style::new());
}

fn process_table(area: Rect, buffer: &mut Buffer, model: &Model) {
    let header = format!(
        "  {:<11}{:<15}{:>7}  {:<8} {:>4} {:>6} {:>6} {:>5} {:>6}",
        "role", "implementation", "pid", "state", "rst", "Hz", "age/ms", "cpu/%", "MiB"
    );
    print(buffer, area, 0, &header, DIM);
    let rows = model.status.iter().flat_map(|status| &status.processes);
    for (index, process) in rows.take(usize::from(PROCESS_ROWS)).enumerate() {
        let ProcessStatus { role, implementation, pid, state, restarts, rate_hz, .. } = process;
        let mark = if *role == model.role() { '\u{25b8}' } else { ' ' };
        let text = format!(
            "{mark} {role:<11}{implementation:<15.15}{pid:>7}  {:<8} {restarts:>4} {rate_hz:>6.1} {:>6.0} {:>5.1} {:>6.1}",
            state.name(),
            process.last_sample_age_ms.min(999_999.0),
            process.cpu_percent,
            process.memory_kib as f64 / 1024.0
        );
        let style = match state.name() {
            "ready" => Style::new(),
            "shadow" | "standby" | "starting" => Style::new().fg(Color::Cyan),
            _ => WARNING,
        };
        print(buffer, area, index as u16 + 1, &text, style);
    }
}

fn map(area: Rect, buffer: &mut Buffer, model: &Model) {
    let Some(pose) = &model.pose else { return print(buffer, area, 0, " no pose yet", DIM) };
    let [low_m, high_m] = model.course.track.y_m;
    // A track that fits is shown whole; else, and on a course, the map follows the robot.
    let is_narrow = high_m - low_m <= MAP_M[1] && model.course.outline.is_none();
    let centre_m = if is_narrow { (low_m + high_m) / 2.0 } else { pose.y_m };
    let mut canvas = Canvas::new(area, [pose.x_m - BEHIND_M, centre_m - MAP_M[1] / 2.0], MAP_M);
    bounds(&mut canvas, pose, &model.course);
    model.returns.iter().for_each(|place| canvas.dot(*place, Color::White));
    for obstacle in model.obstacles.iter().flat_map(|obstacles| obstacles.list()) {
        let (centre, axes) = ([obstacle.x_m, obstacle.y_m], [obstacle.a_m, obstacle.b_m]);
        let yaw = model.course.outline.as_ref().map_or(0.0, |outline| outline.yaw_near(centre));
        let at = |index: usize| {
            ellipse_point(centre, axes, yaw, std::f64::consts::TAU * index as f64 / ELLIPSE_POINTS as f64)
        };
        let color = if obstacle.unseen_s > 0.0 { Color::DarkGray } else { Color::Magenta };
        canvas.outline(&(0..ELLIPSE_POINTS).map(at).collect::<Vec<_>>(), color);
        canvas.outline(
            &rectangle(
                [obstacle.box_x_m, obstacle.box_y_m, obstacle.box_yaw_rad],
                [obstacle.box_length_m, obstacle.box_width_m],
            ),
            Color::Yellow,
        );
    }
    for Goal { x_m, y_m, tolerance_m, .. } in model.course.goals_in_plane() {
        let arm_m = tolerance_m.max(0.1);
        canvas.line([x_m - arm_m, y_m], [x_m + arm_m, y_m], Color::Cyan);
        canvas.line([x_m, y_m - arm_m], [x_m, y_m + arm_m], Color::Cyan);
    }
    if let Some(command) = model.command.as_ref().filter(|_| !model.is_blocked()) {
        let nodes = command.nodes();
        for (from, to) in nodes.iter().zip(nodes.iter().skip(1)) {
            canvas.line([from.x_m, from.y_m], [to.x_m, to.y_m], Color::Cyan);
        }
    }
    let vehicle = &model.course.vehicle;
    let body = rectangle([pose.x_m, pose.y_m, pose.yaw_rad], [vehicle.length_m, vehicle.width_m]);
    canvas.outline(&body, if model.is_blocked() { Color::Yellow } else { Color::Blue });
    canvas.render(buffer);
}

/// The bounds of the track near the robot, or the course with those of its way.
fn bounds(canvas: &mut Canvas, pose: &Pose, course: &Course) {
    if let Some(outline) = &course.outline {
        for line in [&outline.left, &outline.right] {
            line.windows(2).for_each(|pair| canvas.line(pair[0], pair[1], Color::DarkGray));
        }
        // Every other piece: the course is dashed.
        outline.centre.chunks_exact(4).for_each(|dash| canvas.line(dash[0], dash[2], Color::DarkGray));
        return;
    }
    let [near_m, far_m] = [pose.x_m - 50.0, pose.x_m + 50.0];
    for y_m in course.track.y_m {
        let [from_m, to_m] = course.track.x_m;
        canvas.line([near_m.max(from_m), y_m], [far_m.min(to_m), y_m], Color::DarkGray);
    }
}

/// The corners of a rectangle.
fn rectangle([x_m, y_m, yaw_rad]: [f64; 3], [length_m, width_m]: [f64; 2]) -> [[f64; 2]; 4] {
    [[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]].map(|[ahead, left]| {
        let corner = to_track(yaw_rad, ahead * length_m, left * width_m);
        [x_m + corner.x, y_m + corner.y]
    })
}

fn latency(area: Rect, buffer: &mut Buffer, model: &Model) {
    print(buffer, area, 0, "scan to actuation [ms]", TITLE);
    if model.status.as_ref().is_some_and(|status| status.lockstep) {
        return print(buffer, area, 1, "none: time is simulated", DIM);
    }
    let percentile = |share| model.reaction_ms(share).map_or("-".to_owned(), |time| format!("{time:.2}"));
    let columns = usize::from(area.width);
    let newest: Vec<f64> = model.reactions_ms.iter().rev().take(columns).rev().copied().collect();
    let largest = newest.iter().copied().fold(1e-3, f64::max);
    let bar = |time: &f64| BARS[((time / largest * 8.0).ceil() as usize).min(8)];
    print(buffer, area, 1, &newest.iter().map(bar).collect::<String>(), Style::new().fg(Color::Cyan));
    print(buffer, area, 2, &format!("p50 {}  p90 {}", percentile(0.5), percentile(0.9)), Style::new());
    print(buffer, area, 3, &format!("p99 {}  max {}", percentile(0.99), percentile(1.0)), Style::new());
    let most = model.stages_ms.iter().copied().fold(1e-3, f64::max);
    for (index, (stage, time_ms)) in STAGES.iter().zip(model.stages_ms).enumerate() {
        let bar = "\u{2584}".repeat((time_ms / most * 10.0).round() as usize);
        print(buffer, area, 4 + index as u16, &format!("{stage:<11}{time_ms:>6.2} {bar}"), DIM);
    }
}

fn events(area: Rect, buffer: &mut Buffer, model: &Model) {
    buffer.set_string(area.x, area.y, "\u{2500}".repeat(usize::from(area.width)), DIM);
    let last: Vec<_> = model.events().rev().take(usize::from(area.height) - 1).collect();
    for (index, (event, text)) in last.into_iter().rev().enumerate() {
        let style = if event.is_some_and(|event| event.warning) { WARNING } else { Style::new() };
        let time =
            event.map_or_else(|| "      \u{25b8}".to_owned(), |event| format!("{:>5.1} s", event.time_s));
        print(buffer, area, index as u16 + 1, &format!("{time} {text}"), style);
    }
}

fn keys(area: Rect, buffer: &mut Buffer, model: &Model) {
    let end = if model.of_run { "q leave  ^C end run" } else { "q quit" };
    let text =
        format!(" ? help  y why  s STOP  p pause  \u{2191}\u{2193} role  r, w {}  {end}", model.role());
    buffer.set_style(area, Style::new().add_modifier(Modifier::REVERSED));
    print(buffer, area, 0, &text, Style::new().add_modifier(Modifier::REVERSED));
}

/// Takes the place of processes, map and latency.
fn reasons(area: Rect, buffer: &mut Buffer, shown: &Reasons) {
    let lines = shown.picture([area.width, area.height].map(usize::from));
    for (index, line) in lines.iter().enumerate() {
        print(buffer, area, index as u16, line, if index == 0 { TITLE } else { Style::new() });
    }
}

fn help(area: Rect, buffer: &mut Buffer, model: &Model) {
    let built_in = built_in(model.role());
    let lines = [
        " s       blocks the wheels at once and ends the system; it can't be taken back".to_owned(),
        " p       pauses: the wheels are blocked until c lets the controller drive again".to_owned(),
        " \u{2191} \u{2193}     selects a role; so do k, j and the digits 1 to 5".to_owned(),
        " r       restarts the process of the role: a new one takes over first".to_owned(),
        format!(" w       swaps it for a process of the built-in implementation ({built_in})"),
        " y       tells why: of the last stop, then of the newest scan".to_owned(),
        " ?       closes this help".to_owned(),
        if model.of_run {
            " q       leaves the view; Ctrl-C ends the run".to_owned()
        } else {
            " q       quits, as does Ctrl-C; the system drives on".to_owned()
        },
        " map: body blue, plan and goal cyan, ellipses magenta, remembered ones grey".to_owned(),
    ];
    for (index, line) in lines.iter().enumerate() {
        print(buffer, area, index as u16, line, Style::new());
    }
}

/// The built-in implementation that `w` swaps to.
pub(super) fn built_in(role: Role) -> &'static str {
    let of_role = supervision::entry::IMPLEMENTATIONS.iter().find(|(_, of)| *of == role);
    of_role.map_or("", |(name, _)| name)
}

#[cfg(test)]
mod tests;
