//! Commands to a scanner.

/// How ranges are coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Coding {
    /// Two characters per range, at most 4094 mm: a third less to transmit.
    Two,
    /// Three characters per range.
    #[default]
    Three,
}

impl Coding {
    /// Characters per range.
    pub fn characters(self) -> u8 {
        match self {
            Self::Two => 2,
            Self::Three => 3,
        }
    }
}

/// Which ranges a scanner measures, and how often.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Measurement {
    /// Coding of the ranges.
    pub coding: Coding,
    /// First step of the scanner's turn, 0 to 9999.
    pub first: u16,
    /// Last step, 0 to 9999.
    pub last: u16,
    /// Steps merged to one range, the smallest; 0 and 1 are the same.
    pub cluster: u8,
    /// Scans left out after each one that is sent, 0 to 9.
    pub skip: u8,
    /// Number of scans; 0 for no end. In a reply: how many are left.
    pub count: u8,
    /// Asks for the newest scan of a laser that is on already (`GD`, `GS`); skip and count are not used.
    pub single: bool,
}

impl Measurement {
    /// Number of ranges of a scan.
    pub fn ranges(&self) -> usize {
        usize::from(self.last.saturating_sub(self.first)) / usize::from(self.cluster.max(1)) + 1
    }

    /// Whether a scan of `other` is one of this measurement: all but the count are equal.
    pub fn is_same(&self, other: &Self) -> bool {
        Self { count: 0, ..*self } == Self { count: 0, ..*other }
    }

    /// The measurement of an echo such as `MD0044072501005`, also with a tag; `None` if it is none.
    pub fn of_echo(echo: &[u8]) -> Option<Self> {
        let (name, digits) = echo.split_at_checked(2)?;
        let (coding, single) = match name {
            b"MD" => (Coding::Three, false),
            b"MS" => (Coding::Two, false),
            b"GD" => (Coding::Three, true),
            b"GS" => (Coding::Two, true),
            _ => return None,
        };
        let digits = digits.split(|byte| *byte == b';').next()?;
        if digits.len() != if single { 10 } else { 13 } {
            return None;
        }
        let number = |from: usize, to: usize| digits.get(from..to).and_then(decimal);
        Some(Self {
            coding,
            first: number(0, 4)?,
            last: number(4, 8)?,
            cluster: number(8, 10)? as u8,
            skip: if single { 0 } else { number(10, 11)? as u8 },
            count: if single { 0 } else { number(11, 13)? as u8 },
            single,
        })
    }

    fn append_to(&self, output: &mut Vec<u8>) {
        let Self { first, last, cluster, skip, count, single, .. } = *self;
        output.extend(ScipCommand::Measure(*self).name().as_bytes());
        let ranges = [(first, 4), (last, 4), (u16::from(cluster), 2)];
        let repetition = [(u16::from(skip), 1), (u16::from(count), 2)];
        let repetition = if single { &repetition[..0] } else { &repetition[..] };
        for (value, digits) in ranges.iter().chain(repetition) {
            append_decimal(output, u32::from(*value), *digits);
        }
    }
}

/// A command of SCIP 2.0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScipCommand {
    /// `SCIP2.0`: leave SCIP 1.1, in which an URG-04LX starts.
    SelectScip2,
    /// `VV`: vendor, product, firmware, protocol, serial number.
    Version,
    /// `PP`: the parameters of the model.
    Parameters,
    /// `II`: the present state.
    State,
    /// `BM`: laser on.
    LaserOn,
    /// `QT`: stop measuring, laser off.
    Quit,
    /// `RS`: back to the state after power-up.
    Reset,
    /// `TM0`: enter time mode; the laser is off in it.
    TimeModeOn,
    /// `TM1`: the time of the scanner.
    Time,
    /// `TM2`: leave time mode.
    TimeModeOff,
    /// `SS`: change the bit rate of the serial line.
    BitRate(u32),
    /// `MD`, `MS`, `GD`, `GS`.
    Measure(Measurement),
}

impl ScipCommand {
    /// Appends the command with its line feed.
    pub fn append_to(&self, output: &mut Vec<u8>) {
        match self {
            Self::Measure(measurement) => measurement.append_to(output),
            command => output.extend(command.name().as_bytes()),
        }
        if let Self::BitRate(rate) = self {
            append_decimal(output, *rate, 6);
        }
        output.push(b'\n');
    }

    /// Its two letters, and what follows them in the names of the specification.
    pub fn name(&self) -> &'static str {
        match self {
            Self::SelectScip2 => "SCIP2.0",
            Self::Version => "VV",
            Self::Parameters => "PP",
            Self::State => "II",
            Self::LaserOn => "BM",
            Self::Quit => "QT",
            Self::Reset => "RS",
            Self::TimeModeOn => "TM0",
            Self::Time => "TM1",
            Self::TimeModeOff => "TM2",
            Self::BitRate(_) => "SS",
            Self::Measure(Measurement { coding: Coding::Three, single: false, .. }) => "MD",
            Self::Measure(Measurement { coding: Coding::Two, single: false, .. }) => "MS",
            Self::Measure(Measurement { coding: Coding::Three, .. }) => "GD",
            Self::Measure(Measurement { coding: Coding::Two, .. }) => "GS",
        }
    }

    /// Whether a reply with this echo answers the command.
    pub fn is_answered_by(&self, echo: &[u8]) -> bool {
        if let Self::Measure(measurement) = self {
            return Measurement::of_echo(echo).is_some_and(|echoed| measurement.is_same(&echoed));
        }
        let mut line = Vec::with_capacity(16);
        self.append_to(&mut line);
        line.strip_suffix(b"\n") == Some(echo)
    }
}

/// A number of decimal digits only.
fn decimal(digits: &[u8]) -> Option<u16> {
    let is_number = !digits.is_empty() && digits.iter().all(u8::is_ascii_digit);
    let add = |value: u16, digit: &u8| value.checked_mul(10)?.checked_add(u16::from(digit - b'0'));
    is_number.then(|| digits.iter().try_fold(0, add)).flatten()
}

/// Appends a number with a fixed number of digits; higher digits are left out.
fn append_decimal(output: &mut Vec<u8>, value: u32, digits: u32) {
    output.extend((0..digits).rev().map(|place| (value / 10_u32.pow(place) % 10) as u8 + b'0'));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_echo_is_read_as_the_command_was_written() {
        let single = Measurement { first: 44, last: 725, cluster: 1, single: true, ..Measurement::default() };
        let endless = Measurement { coding: Coding::Two, skip: 1, single: false, count: 7, ..single };
        for (measurement, text) in [(single, "GD0044072501\n"), (endless, "MS0044072501107\n")] {
            let mut bytes = Vec::new();
            ScipCommand::Measure(measurement).append_to(&mut bytes);
            assert_eq!(bytes, text.as_bytes());
            assert_eq!(Measurement::of_echo(text.trim_end().as_bytes()), Some(measurement));
        }
        assert_eq!(endless.ranges(), 682);
    }

    #[test]
    fn an_echo_with_other_digits_is_none() {
        for echo in
            ["MD", "MD004407250100", "MD00440725010055", "MX0044072501005", "MD00440725x1005", "GD004407250"]
        {
            assert_eq!(Measurement::of_echo(echo.as_bytes()), None, "{echo}");
        }
    }
}
