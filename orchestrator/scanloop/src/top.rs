//! `scanloop top`: a running system on one screen of a terminal.
//!
//! The command starts itself once more with `--draw`: that process draws, and this one restores the terminal when it was
//! killed. Requests are commands of this program, in processes of their own, so the screen never waits for them.

mod canvas;
mod draw;
mod feed;
mod keys;
mod model;
mod reasons;
mod terminal;

use std::io;
use std::os::fd::AsFd;
use std::process::{Command, Stdio};
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use clap::Args;
use console::exit::{Exit, Failure};
use console::screen::{self, ScreenGuard};
use runtime::{Shutdown, wait_for};
use rustix::process::{Signal, getppid, kill_process, set_parent_process_death_signal};
use shared_types::Role;
use supervision::child::this_program;

use draw::built_in;
use feed::Feed;
use keys::{Key, Keyboard};
use model::Model;
use reasons::Reasons;
use terminal::Screen;

/// Time between two pictures.
const PICTURE: Duration = Duration::from_millis(100);
/// Bytes of keys that are taken at once.
const KEY_BYTES: usize = 1024;

/// Arguments of `top`.
#[derive(Debug, Args)]
pub struct TopArguments {
    /// Draw in this process; `top` starts itself with this option.
    #[arg(long, hide = true)]
    pub draw: bool,
    /// The view of a run; `run --top` uses it.
    #[arg(long, hide = true, requires = "draw")]
    pub of_run: bool,
}

/// Shows a system until a key ends the view or the system ends.
///
/// # Errors
/// No terminal, and a system that is not running; exit code 2.
pub(crate) fn top(system_id: &str, arguments: &TopArguments) -> anyhow::Result<Exit> {
    if !screen::is_available() {
        return Err(Failure::bad_input("top needs a terminal as standard input and standard error"));
    }
    if arguments.draw {
        return show(system_id, arguments.of_run);
    }
    supervision::runs::existing(system_id)?;
    let shutdown = Shutdown::of_orchestrator()?;
    let mut command = Command::new(this_program());
    command.args(["--system-id", system_id, "top", "--draw"]);
    let status = ScreenGuard::start(&mut command)?.wait(&[shutdown.descriptor()])?;
    match status.code() {
        Some(0) => Ok(Exit::Done),
        _ => anyhow::bail!("the view has ended: {status}"),
    }
}

/// Draws, and answers keys.
fn show(system_id: &str, of_run: bool) -> anyhow::Result<Exit> {
    let parent = getppid();
    set_parent_process_death_signal(Some(Signal::TERM))?;
    let shutdown = Shutdown::of_orchestrator()?;
    // From here on the signal arrives; before, the parent may have died.
    if getppid() != parent {
        return Ok(Exit::Done);
    }
    let mut model = Model { system_id: system_id.to_owned(), of_run, ..Model::default() };
    let mut feed = Feed::start(system_id)?;
    let (sender, notes) = channel();
    let mut terminal = ratatui_core::terminal::Terminal::new(Screen::enter()?)?;
    terminal.clear()?;
    let mut keyboard = Keyboard::default();
    let mut next = Instant::now();
    loop {
        let due = keyboard.due().map_or(next, |due| due.min(next));
        let left = due.saturating_duration_since(Instant::now());
        wait_for(&[io::stdin().as_fd(), shutdown.descriptor()], left.as_nanos() as u64);
        if shutdown.requested() || !answer_keys(&mut keyboard, &mut model, &sender)? {
            return Ok(Exit::Done);
        }
        notes.try_iter().for_each(|told| told.to(&mut model));
        if !feed.poll(&mut model) {
            return Ok(Exit::Done);
        }
        if Instant::now() >= next {
            next = Instant::now() + PICTURE;
            terminal.draw(|frame| draw::draw(frame.area(), frame.buffer_mut(), &model))?;
        }
    }
}

/// Does what the pressed keys ask for, new ones and those that were held; false when the view ends.
fn answer_keys(keyboard: &mut Keyboard, model: &mut Model, notes: &Sender<Told>) -> anyhow::Result<bool> {
    // Before the poll: what comes after it has not come within the pause.
    let now = Instant::now();
    let (mut bytes, mut count) = ([0; KEY_BYTES], 0);
    if wait_for(&[io::stdin().as_fd()], 0) {
        // Not through the buffer of `io::stdin`: a wait does not see what it holds.
        count = match rustix::io::read(io::stdin(), &mut bytes) {
            // The terminal is gone.
            Ok(0) | Err(_) => return Ok(false),
            Ok(count) => count,
        };
    }
    for key in keyboard.keys(&bytes[..count], now) {
        let role = model.role();
        match key {
            Key::Quit => return Ok(false),
            Key::Interrupt => {
                if model.of_run
                    && let Some(run) = getppid()
                {
                    kill_process(run, Signal::INT)?;
                }
                return Ok(false);
            }
            Key::Text => model.note("a text asks for nothing: press one key at a time".to_owned()),
            Key::Help => model.help = !model.help,
            Key::Why => ask_why(model, notes),
            Key::Up => model.select(false),
            Key::Down => model.select(true),
            Key::Role(index) => model.selected = index.min(Role::ALL.len() - 1),
            Key::Stop => request(model, notes, &["stop"]),
            Key::Restart => request(model, notes, &["restart", role.name()]),
            Key::Pause => request(model, notes, &["pause"]),
            Key::Resume => request(model, notes, &["resume"]),
            Key::Swap => request(model, notes, &["swap", role.name(), "--to", built_in(role)]),
        }
    }
    Ok(true)
}

/// What a command of this view has printed.
enum Told {
    /// A line among the events.
    Note(String),
    /// The answer for a scan.
    Reasons(Reasons),
}

impl Told {
    fn to(self, model: &mut Model) {
        match self {
            Self::Note(text) => model.note(text),
            // Another one may be asked about by now.
            Self::Reasons(told) => {
                model
                    .reasons
                    .iter_mut()
                    .filter(|shown| shown.scan == told.scan)
                    .for_each(|shown| *shown = told.clone());
            }
        }
    }
}

/// Starts a command of this program; what it prints becomes notes.
fn request(model: &mut Model, notes: &Sender<Told>, arguments: &[&str]) {
    model.note(format!("{} ...", arguments.join(" ")));
    start(model, notes, arguments, |lines| lines.into_iter().map(Told::Note).collect());
}

/// Asks about the next scan that is worth it, or closes the answer.
fn ask_why(model: &mut Model, notes: &Sender<Told>) {
    let newest = model.status.as_ref().map_or(0, |status| status.scan);
    let scan = Reasons::next(model.reasons.as_ref(), model.stop_scan, newest).filter(|scan| *scan > 0);
    model.reasons = scan.map(|scan| Reasons { scan, lines: Vec::new() });
    if let Some(scan) = scan {
        let told = move |lines| vec![Told::Reasons(Reasons { scan, lines })];
        start(model, notes, &["why", &scan.to_string()], told);
    }
}

/// Starts a command of this program; `told` is made of the lines that it prints.
fn start(
    model: &mut Model,
    notes: &Sender<Told>,
    arguments: &[&str],
    told: impl FnOnce(Vec<String>) -> Vec<Told> + Send + 'static,
) {
    let mut command = Command::new(this_program());
    command.args(["--system-id", &model.system_id]).args(arguments);
    command.stdin(Stdio::null());
    let notes = notes.clone();
    let started = std::thread::Builder::new().name("request".to_owned()).spawn(move || {
        let text = match command.output() {
            Ok(output) => {
                [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned())
            }
            Err(error) => [String::new(), format!("error: {error}")],
        };
        let lines = text.iter().flat_map(|text| text.lines()).filter(|line| !line.trim().is_empty());
        told(lines.map(str::to_owned).collect()).into_iter().for_each(|told| _ = notes.send(told));
    });
    if let Err(error) = started {
        model.note(format!("error: {}", console::limits::text_of(&error.into())));
    }
}
