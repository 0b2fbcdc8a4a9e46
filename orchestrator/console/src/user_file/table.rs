//! The form of a table: what spreadsheets write that is not comma-separated values with decimal points.

use key_table::ForeignLetter;

/// Values that a spreadsheet writes for a formula without a result.
const ERRORS: [&str; 8] =
    ["#DIV/0!", "#N/A", "#NAME?", "#NULL!", "#NUM!", "#REF!", "#VALUE!", "#GETTING_DATA"];

/// The text of a table that has values separated by commas, under a header line; lines of blanks are empty in it. Lines that
/// begin with `#` are comments.
///
/// # Errors
/// The line and what it has instead, and a text without a row below the header.
pub(super) fn read(text: &str) -> Result<String, String> {
    // A single `\r` ends a line too.
    let text = text.replace("\r\n", "\n").replace('\r', "\n");
    let lines = text.lines().map(|line| if line.trim().is_empty() { "" } else { line });
    let text = lines.fold(String::with_capacity(text.len()), |text, line| text + line + "\n");
    require_form(&text).map(|()| text)
}

fn require_form(text: &str) -> Result<(), String> {
    let numbered = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    let mut lines = numbered.filter(|(_, line)| !line.is_empty() && !is_comment(line));
    let Some((number, header)) = lines.next() else {
        return Err(
            "line 1: the table is empty: a header line with the names of the columns is missing".to_owned()
        );
    };
    let fault = of_document(header).or_else(|| of_header(header)).or_else(|| separator(header));
    if let Some(fault) = fault {
        return Err(format!("line {number}: {fault}"));
    }
    let names: Vec<String> = values(header).unwrap_or_default();
    let mut rows = lines.peekable();
    if rows.peek().is_none() {
        return Err(format!("line {number}: no row follows the header"));
    }
    match rows.find_map(|(number, line)| of_row(line, &names).map(|fault| (number, fault))) {
        Some((number, fault)) => Err(format!("line {number}: {fault}")),
        None => Ok(()),
    }
}

/// A row may begin with `#` too, where a formula has no result.
fn is_comment(line: &str) -> bool {
    line.starts_with('#') && !is_error(line.split([',', ';', '\t']).next().unwrap_or_default().trim())
}

/// Whether a spreadsheet writes this for a formula without a result; other languages have other words.
fn is_error(value: &str) -> bool {
    let is_word = |word: &str| word.len() > 2 && word.bytes().all(|byte| byte.is_ascii_uppercase());
    ERRORS.contains(&value)
        || value.strip_prefix('#').and_then(|rest| rest.strip_suffix(['!', '?'])).is_some_and(is_word)
        || value.strip_prefix("Err:").is_some_and(|code| code.parse::<u16>().is_ok())
}

/// The text is of another kind.
fn of_document(header: &str) -> Option<String> {
    let kind = match header.as_bytes().first()? {
        b'<' => "HTML or XML",
        b'{' | b'[' => "JSON",
        _ => return None,
    };
    Some(format!("it is {kind}, no table of comma-separated values"))
}

/// The names of columns are separated by another letter than a comma.
fn separator(header: &str) -> Option<String> {
    let [commas, semicolons, tabs] = [',', ';', '\t'].map(|letter| header.matches(letter).count());
    let name = match () {
        () if semicolons > commas => "semicolons",
        () if tabs > commas => "tabs",
        () => return None,
    };
    Some(separated_by(name))
}

fn separated_by(name: &str) -> String {
    format!("values are separated by {name}; separate them by commas, with points in numbers")
}

fn of_header(header: &str) -> Option<String> {
    let start = header.trim_start_matches('"').as_bytes();
    if start.len() >= 4 && start[..4].eq_ignore_ascii_case(b"sep=") {
        return Some(format!("`{header}` is for a spreadsheet only; remove the line"));
    }
    if let Some(letter) =
        ForeignLetter::of(header).filter(|letter| letter.plain.is_none_or(|plain| plain == ' '))
    {
        return Some(format!("the header has {letter}"));
    }
    let unnamed = header.rsplit(',').take_while(|name| is_empty(name)).count();
    (unnamed > 0).then(|| format!("{unnamed} columns at its end have no name; remove the commas there"))
}

fn of_row(line: &str, names: &[String]) -> Option<String> {
    // A value that continues on the next line is a text.
    let values = values(line)?;
    if let Some(letter) = ForeignLetter::of(line).filter(|_| line.contains('\u{feff}')) {
        return Some(format!("it has {letter}"));
    }
    let named = values.iter().enumerate();
    let mut named = named.map(|(index, value)| (names.get(index).map_or("value", String::as_str), value));
    if let Some(fault) =
        named.find_map(|(name, value)| Some(format!("{name} = {value}: {}", of_value(value)?)))
    {
        return Some(fault);
    }
    if values.iter().all(|value| is_empty(value)) {
        return Some("it has commas and no value; remove it".to_owned());
    }
    let columns = names.len();
    if values.len() != columns {
        let other =
            [(';', "semicolons"), ('\t', "tabs")].into_iter().find(|(letter, _)| line.contains(*letter));
        if let Some((_, name)) = other {
            return Some(separated_by(name));
        }
    }
    if values.len() <= columns {
        return None;
    }
    let empty = values.iter().rev().take_while(|value| is_empty(value)).count();
    if empty > 0 && values.len() - empty <= columns {
        let surplus = values.len() - columns;
        return Some(format!("{surplus} empty values too many at its end; remove the commas there"));
    }
    let found = format!("{} values under {columns} names", values.len());
    values.windows(2).find_map(|pair| {
        let [whole, rest] = [pair[0].trim(), pair[1].trim()];
        match rest.split_once('.') {
            _ if !is_whole(whole.trim_start_matches('-')) => None,
            None if is_whole(rest) => {
                Some(format!("{found}; if they have decimal commas, write points: {whole},{rest} as {whole}.{rest}"))
            }
            Some((thousands, _)) if thousands.len() == 3 && is_whole(thousands) => {
                Some(format!("{found}; if they have commas between thousands, remove those: {whole},{rest} as {whole}{rest}"))
            }
            _ => None,
        }
    })
}

/// What makes a value no number that would be one without it.
fn of_value(value: &str) -> Option<String> {
    if is_number(value) {
        return None;
    }
    if is_error(value) {
        return Some("a spreadsheet had no result here; write a number".to_owned());
    }
    let plain = ForeignLetter::mended(value);
    if let Some(letter) = ForeignLetter::of(value).filter(|_| is_number(plain.trim())) {
        return Some(format!("it has {letter}"));
    }
    let plain = plain.replace(['\'', ' '], "");
    if is_number(&plain) {
        return Some(format!("it has an apostrophe or a blank; write {plain}"));
    }
    let (whole, decimals) = plain.rsplit_once(',')?;
    let one_comma = [whole, decimals].join(".");
    match () {
        // What comes last separates the decimals.
        () if whole.contains('.') => {
            let plain = format!("{}.{decimals}", whole.replace('.', ""));
            is_number(&plain).then(|| format!("it has a decimal comma; write {plain}"))
        }
        () if decimals.contains('.') || whole.contains(',') => {
            let plain = plain.replace(',', "");
            is_number(&plain).then(|| format!("it has commas between thousands; write {plain}"))
        }
        () if !is_number(&one_comma) => None,
        () if decimals.len() == 3 && is_whole(whole.trim_start_matches('-')) && whole != "0" => {
            Some(format!("it has a comma; write {one_comma}, or {whole}{decimals} if that is meant"))
        }
        () => Some(format!("it has a decimal comma; write {one_comma}")),
    }
}

/// The values of a line without their quotes; `None` when its last quote is open.
fn values(line: &str) -> Option<Vec<String>> {
    let (mut values, mut value, mut is_quoted) = (Vec::new(), String::new(), false);
    for letter in line.chars() {
        match letter {
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => values.push(std::mem::take(&mut value).trim().to_owned()),
            letter => value.push(letter),
        }
    }
    values.push(value.trim().to_owned());
    (!is_quoted).then_some(values)
}

fn is_empty(value: &str) -> bool {
    value.trim_matches(['"', ' ', '\t']).is_empty()
}

fn is_number(value: &str) -> bool {
    value.parse::<f64>().is_ok()
}

fn is_whole(value: &str) -> bool {
    !value.is_empty() && value.bytes().all(|digit| digit.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_of_spreadsheets_are_named_with_the_line() {
        for (text, expected) in [
            ("v;d;t\n0,5;2;4\n", "line 1: values are separated by semicolons"),
            ("# hall\nv\td\tt\n", "line 2: values are separated by tabs"),
            ("v,d,t\n0.5,2,4\n0.5;2;4\n", "line 3: values are separated by semicolons"),
            ("v,d,t\n0,5;2,0;4,1\n", "line 2: values are separated by semicolons"),
            ("v,d,t\n0.5\t2\t4\n", "line 2: values are separated by tabs"),
            ("v,d,t,,\n0.5,2,4,,\n", "line 1: 2 columns at its end have no name"),
            ("v,d,t\n0.5,2,4\n0.5,2,4,,\n", "line 3: 2 empty values too many"),
            ("v,d,t\r0.5,2,4\r,,\r", "line 3: it has commas and no value"),
            ("v,d,t\n0,5,2,0,4,1\n", "line 2: 6 values under 3 names; if they have decimal commas"),
            (
                "v,d,t\n0.5,2,4\n0,5,2,4.1\n",
                "line 3: 4 values under 3 names; if they have decimal commas, write points: 0,5 as 0.5",
            ),
            (
                "v,d,t\n1,000.5,2,4\n",
                "line 2: 4 values under 3 names; if they have commas between thousands, remove those: 1,000.5 as 1000.5",
            ),
            ("v,d,t\n\"0,5\",\"2\",\"4\"\n", "line 2: v = 0,5: it has a decimal comma; write 0.5"),
            ("v,d\n2,\"1,000.5\"\n", "line 2: d = 1,000.5: it has commas between thousands; write 1000.5"),
            ("v,d\n2,\"1.000,5\"\n", "line 2: d = 1.000,5: it has a decimal comma; write 1000.5"),
            (
                "v,d\n2,\"1,000\"\n",
                "line 2: d = 1,000: it has a comma; write 1.000, or 1000 if that is meant",
            ),
            ("v,d\n2,\u{2212}0.5\n", "line 2: d = \u{2212}0.5: it has \u{2212} (U+2212), write -"),
            ("v,d\n2,0.5\u{200b}\n", "line 2: d = 0.5\u{200b}: it has a letter that can't be seen (U+200B)"),
            ("v,d\n2,'0.5\n", "line 2: d = '0.5: it has an apostrophe or a blank; write 0.5"),
            (
                "v,d\n2,1\u{2019}000\n",
                "line 2: d = 1\u{2019}000: it has an apostrophe or a blank; write 1000",
            ),
            ("v,d\n2,3\n\u{feff}v,d\n2,3\n", "line 3: it has a byte order mark (U+FEFF) within the text"),
            ("v\u{200b},d\n2,3\n", "line 1: the header has a letter that can't be seen (U+200B)"),
            ("sep=,\nv,d\n2,3\n", "line 1: `sep=,` is for a spreadsheet only; remove the line"),
            ("v,d\n#DIV/0!,3\n", "line 2: v = #DIV/0!: a spreadsheet had no result here"),
            ("v,d\n# note\n2,3\n#BEZUG!,3\n", "line 4: v = #BEZUG!: a spreadsheet had no result here"),
            ("v,d\n2,#N/A\n", "line 2: d = #N/A: a spreadsheet had no result here"),
            ("", "line 1: the table is empty"),
            ("# hall\n\n", "line 1: the table is empty"),
            ("# hall\nv,d\n", "line 2: no row follows the header"),
            ("<!DOCTYPE html>\n<p>v,d</p>\n", "line 1: it is HTML or XML"),
            ("{\"v\": 1,\n\"d\": 2}\n", "line 1: it is JSON"),
        ] {
            let fault = read(text).unwrap_err();
            assert!(fault.starts_with(expected), "{fault}");
        }
        for good in [
            "v,d\n0.5,\n",
            "# a;b\n\nv, d\r\n-0.5, 2\r\n",
            "\"v\",\"d\"\n\"below, left\",2\n",
            "v,d\nnan,2\n#HALL! not a row\n",
            "v,d\nbelow; left,2\n",
        ] {
            read(good).unwrap();
        }
        assert_eq!(read("v,d\r\n2,3\r\n \t\r\n").unwrap(), "v,d\n2,3\n\n");
    }
}
