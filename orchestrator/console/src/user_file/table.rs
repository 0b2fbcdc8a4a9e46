//! The form of a table: what spreadsheets write that is not comma-separated values with decimal points.

/// Passes when a table has values separated by commas, under a header line. Lines that begin with `#` are comments.
///
/// # Errors
/// The line and what it has instead.
pub(super) fn require_form(text: &str) -> Result<(), String> {
    // A single `\r` ends a line too.
    let text = text.replace("\r\n", "\n").replace('\r', "\n");
    let numbered = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    let mut lines = numbered.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let Some((number, header)) = lines.next() else { return Ok(()) };
    let fault = of_header(header).or_else(|| separator(header));
    if let Some(fault) = fault {
        return Err(format!("line {number}: {fault}"));
    }
    let columns = header.split(',').count();
    match lines.find_map(|(number, line)| of_row(line, columns).map(|fault| (number, fault))) {
        Some((number, fault)) => Err(format!("line {number}: {fault}")),
        None => Ok(()),
    }
}

/// The names of columns are separated by another letter than a comma.
fn separator(header: &str) -> Option<String> {
    let [commas, semicolons, tabs] = [',', ';', '\t'].map(|letter| header.matches(letter).count());
    let name = match () {
        () if semicolons > commas => "semicolons",
        () if tabs > commas => "tabs",
        () => return None,
    };
    Some(format!("values are separated by {name}; separate them by commas, with points in numbers"))
}

fn of_header(header: &str) -> Option<String> {
    let unnamed = header.rsplit(',').take_while(|name| is_empty(name)).count();
    (unnamed > 0).then(|| format!("{unnamed} columns at its end have no name; remove the commas there"))
}

fn of_row(line: &str, columns: usize) -> Option<String> {
    let quoted = line.split('"').skip(1).step_by(2);
    if let Some(number) = quoted.map(str::trim).find(|value| is_decimal_comma(value)) {
        return Some(format!("{number} has a decimal comma; write {}", number.replace(',', ".")));
    }
    if line.contains('"') {
        return None;
    }
    let values: Vec<&str> = line.split(',').collect();
    if values.iter().all(|value| is_empty(value)) {
        return Some("it has commas and no value; remove it".to_owned());
    }
    if values.len() <= columns {
        return None;
    }
    let empty = values.iter().rev().take_while(|value| is_empty(value)).count();
    if empty > 0 && values.len() - empty <= columns {
        let surplus = values.len() - columns;
        return Some(format!("{surplus} empty values too many at its end; remove the commas there"));
    }
    let is_digits =
        |value: &&str| value.trim().trim_start_matches('-').chars().all(|digit| digit.is_ascii_digit());
    values.iter().all(is_digits).then(|| {
        let count = values.len();
        format!("{count} values under {columns} names; if they have decimal commas, write points")
    })
}

fn is_empty(value: &str) -> bool {
    value.trim_matches(['"', ' ', '\t']).is_empty()
}

fn is_decimal_comma(value: &str) -> bool {
    value.matches(',').count() == 1 && value.replace(',', ".").parse::<f64>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_of_spreadsheets_are_named_with_the_line() {
        for (text, expected) in [
            ("v;d;t\n0,5;2;4\n", "line 1: values are separated by semicolons"),
            ("# hall\nv\td\tt\n", "line 2: values are separated by tabs"),
            ("v,d,t,,\n0.5,2,4,,\n", "line 1: 2 columns at its end have no name"),
            ("v,d,t\n0.5,2,4\n0.5,2,4,,\n", "line 3: 2 empty values too many"),
            ("v,d,t\r0.5,2,4\r,,\r", "line 3: it has commas and no value"),
            ("v,d,t\n0,5,2,0,4,1\n", "line 2: 6 values under 3 names; if they have decimal commas"),
            ("v,d,t\n\"0,5\",\"2\",\"4\"\n", "line 2: 0,5 has a decimal comma; write 0.5"),
        ] {
            let fault = require_form(text).unwrap_err();
            assert!(fault.starts_with(expected), "{fault}");
        }
        for good in ["v,d\n0.5,\n", "# a;b\n\nv, d\r\n-0.5, 2\r\n", "\"v\",\"d\"\n\"below, left\",2\n", ""] {
            assert_eq!(require_form(good), Ok(()), "{good}");
        }
    }
}
