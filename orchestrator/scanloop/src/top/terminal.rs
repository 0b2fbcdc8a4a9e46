//! The terminal as ratatui draws on it: raw mode and escape sequences, which every terminal of the last decades knows.

use std::fmt::Write as _;
use std::io::{self, Write};

use console::screen::{ENTER, LEAVE, has_colours};
use ratatui_core::backend::{Backend, ClearType, WindowSize};
use ratatui_core::buffer::Cell;
use ratatui_core::layout::{Position, Size};
use ratatui_core::style::{Color, Modifier};
use rustix::termios::{OptionalActions, Termios, tcgetattr, tcgetwinsize, tcsetattr};

/// Size of a terminal that does not know it.
const DEFAULT: Size = Size { width: 80, height: 24 };

/// Standard error as a screen; dropping it restores the terminal.
pub(super) struct Screen {
    before: Termios,
    /// What is written with the next flush.
    pending: String,
    has_colours: bool,
}

impl Screen {
    /// Takes the terminal.
    ///
    /// # Errors
    /// Those of the terminal.
    pub(super) fn enter() -> io::Result<Self> {
        let before = tcgetattr(io::stdin())?;
        let mut raw = before.clone();
        raw.make_raw();
        tcsetattr(io::stdin(), OptionalActions::Now, &raw)?;
        let screen = Self { before, pending: String::new(), has_colours: has_colours() };
        io::stderr().write_all(ENTER)?;
        Ok(screen)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = io::stderr().write_all(LEAVE);
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &self.before);
    }
}

impl Backend for Screen {
    type Error = io::Error;

    fn draw<'a, I>(&mut self, content: I) -> io::Result<()>
    where
        I: Iterator<Item = (u16, u16, &'a Cell)>,
    {
        let (mut style, mut cursor) = (None, None);
        for (column, row, cell) in content {
            if cursor != Some((column, row)) {
                let _ = write!(self.pending, "\x1b[{};{}H", row + 1, column + 1);
            }
            // All that is drawn is one column wide.
            cursor = Some((column + 1, row));
            let wanted = (cell.fg, cell.bg, cell.modifier);
            if style != Some(wanted) {
                style = Some(wanted);
                self.pending.push_str("\x1b[0");
                for (code, is_set) in [
                    (1, cell.modifier.contains(Modifier::BOLD)),
                    (7, cell.modifier.contains(Modifier::REVERSED)),
                ] {
                    if is_set {
                        let _ = write!(self.pending, ";{code}");
                    }
                }
                for (color, base) in [(cell.fg, 30), (cell.bg, 40)] {
                    if let Some(code) = code_of(color).filter(|_| self.has_colours) {
                        let _ = write!(self.pending, ";{}", base + code);
                    }
                }
                self.pending.push('m');
            }
            self.pending.push_str(cell.symbol());
        }
        Ok(())
    }

    fn hide_cursor(&mut self) -> io::Result<()> {
        self.pending.push_str("\x1b[?25l");
        Ok(())
    }

    fn show_cursor(&mut self) -> io::Result<()> {
        self.pending.push_str("\x1b[?25h");
        Ok(())
    }

    /// The cursor is hidden: its place has no meaning.
    fn get_cursor_position(&mut self) -> io::Result<Position> {
        Ok(Position::ORIGIN)
    }

    fn set_cursor_position<P: Into<Position>>(&mut self, position: P) -> io::Result<()> {
        let Position { x, y } = position.into();
        let _ = write!(self.pending, "\x1b[{};{}H", y + 1, x + 1);
        Ok(())
    }

    fn clear(&mut self) -> io::Result<()> {
        self.clear_region(ClearType::All)
    }

    fn clear_region(&mut self, region: ClearType) -> io::Result<()> {
        self.pending.push_str(match region {
            ClearType::All => "\x1b[0m\x1b[2J",
            ClearType::AfterCursor => "\x1b[0m\x1b[0J",
            ClearType::BeforeCursor => "\x1b[0m\x1b[1J",
            ClearType::CurrentLine => "\x1b[0m\x1b[2K",
            ClearType::UntilNewLine => "\x1b[0m\x1b[0K",
        });
        Ok(())
    }

    fn size(&self) -> io::Result<Size> {
        let size = tcgetwinsize(io::stderr())?;
        let is_known = size.ws_col > 0 && size.ws_row > 0;
        Ok(if is_known { Size::new(size.ws_col, size.ws_row) } else { DEFAULT })
    }

    fn window_size(&mut self) -> io::Result<WindowSize> {
        Ok(WindowSize { columns_rows: self.size()?, pixels: Size::default() })
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().write_all(std::mem::take(&mut self.pending).as_bytes())
    }
}

/// The colours of all terminals, from black on; `None` for the terminal's own.
fn code_of(color: Color) -> Option<u8> {
    Some(match color {
        Color::Black => 0,
        Color::Red => 1,
        Color::Green => 2,
        Color::Yellow => 3,
        Color::Blue => 4,
        Color::Magenta => 5,
        Color::Cyan => 6,
        Color::Gray => 7,
        Color::DarkGray => 60,
        Color::LightRed => 61,
        Color::LightGreen => 62,
        Color::LightYellow => 63,
        Color::LightBlue => 64,
        Color::LightMagenta => 65,
        Color::LightCyan => 66,
        Color::White => 67,
        Color::Reset | Color::Rgb(..) | Color::Indexed(_) => return None,
    })
}
