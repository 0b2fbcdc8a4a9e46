//! Every equation of the source has a home in the code: an item whose own text names the equation.

use architecture::markdown::code_spans;

use crate::root;

/// Numbers of the equations `(7.A)` or `(7.A)-(7.B)` at the beginning of a text, and what follows.
fn equations(text: &str) -> Option<(std::ops::RangeInclusive<u32>, &str)> {
    let (first, rest) = text.strip_prefix("(7.")?.split_once(')')?;
    let first = first.parse().ok()?;
    let last = rest.strip_prefix("-(7.").and_then(|rest| rest.split_once(')'));
    match last.map(|(last, rest)| (last.parse(), rest)) {
        Some((Ok(last), rest)) => Some((first..=last, rest)),
        _ => Some((first..=first, rest)),
    }
}

/// Whether a text names an equation, alone or within a range.
fn names(text: &str, number: u32) -> bool {
    text.match_indices("(7.")
        .any(|(at, _)| equations(&text[at..]).is_some_and(|(range, _)| range.contains(&number)))
}

/// An item of a Rust file, as `fn cover`: its doc comment, its attributes and its body. None unless there is exactly one.
fn item(source: &str, item: &str) -> Option<String> {
    let lines: Vec<&str> = source.lines().collect();
    let defines = |line: &&str| {
        let line = line.trim_start();
        let line = line.strip_prefix("pub(crate) ").or_else(|| line.strip_prefix("pub ")).unwrap_or(line);
        line.strip_prefix(item)
            .is_some_and(|rest| !rest.starts_with(|c: char| c.is_alphanumeric() || c == '_'))
    };
    let mut places = (0..lines.len()).filter(|index| defines(&lines[*index]));
    let (Some(at), None) = (places.next(), places.next()) else { return None };
    let is_head = |line: &&&str| line.trim_start().starts_with("///") || line.trim_start().starts_with("#[");
    let head = lines[..at].iter().rev().take_while(is_head).count();
    // The style of the code base ends an item with a brace that stands as far to the right as the item does.
    let indentation = lines[at].len() - lines[at].trim_start().len();
    let end = format!("{}}}", " ".repeat(indentation));
    let length = lines[at..].iter().position(|line| *line == end || line.ends_with("{}"))?;
    Some(lines[at - head..=at + length].join("\n"))
}

/// What is wrong with a row of the page; `read` gives the text of a file.
fn wrong(row: &str, read: impl Fn(&str) -> Option<String>) -> Vec<String> {
    let cells: Vec<&str> = row.split('|').map(str::trim).collect();
    let [_, numbers, _, file, items, _] = cells[..] else { return vec![format!("{row}: not four cells")] };
    let Some(source) = read(file) else { return vec![format!("no file {file}")] };
    let Some((range, _)) = equations(numbers) else { return vec![format!("{row}: no equation")] };
    let (mut found, mut text) = (Vec::new(), String::new());
    for name in code_spans(items) {
        match item(&source, name) {
            Some(item) => text += &item,
            None => found.push(format!("{file} has not exactly one `{name}`")),
        }
    }
    let unnamed = range.filter(|number| !names(&text, *number));
    found.extend(unnamed.map(|number| format!("{file}: (7.{number}) is not named in {items}")));
    found
}

#[test]
fn every_equation_has_an_item_that_names_it() {
    let page = std::fs::read_to_string(root().join("docs/equations.md")).unwrap();
    let rows: Vec<&str> = page.lines().filter(|line| line.starts_with("| (7.")).collect();
    let read = |file: &str| std::fs::read_to_string(root().join(file)).ok();
    let found: Vec<String> = rows.iter().flat_map(|row| wrong(row, read)).collect();
    assert!(found.is_empty(), "\n{}", found.join("\n"));
    let listed: Vec<u32> =
        rows.iter().filter_map(|row| equations(&row[2..])).flat_map(|(range, _)| range).collect();
    let missing: Vec<u32> = (1..=46).filter(|number| !listed.contains(number)).collect();
    assert_eq!(missing, [], "equations without a home");
}

#[test]
fn an_item_that_does_not_name_its_equation_is_found() {
    let source = "/// The sum, (7.2).\npub fn sum() {\n    // (7.3)\n}\n\n/// (7.4)\nfn other() {}\n\nfn sums() {\n}\n";
    let row = |numbers: &str, items: &str| {
        wrong(&format!("| {numbers} | x | a.rs | {items} |"), |_| Some(source.to_owned()))
    };
    assert_eq!(row("(7.2)-(7.3)", "`fn sum`"), [""; 0]);
    assert_eq!(row("(7.3)-(7.4)", "`fn sum`, `fn other`"), [""; 0]);
    assert_eq!(row("(7.4)", "`fn sum`"), ["a.rs: (7.4) is not named in `fn sum`"]);
    assert_eq!(row("(7.4)", "`fn su`").len(), 2, "no such item, so no name either");
    assert_eq!(wrong("| (7.1) | x | b.rs | `fn a` |", |_| None), ["no file b.rs"]);
}

#[test]
fn a_range_names_what_lies_within() {
    assert!(names("the filter (7.9)-(7.13).", 11) && !names("the filter (7.9)-(7.13).", 14));
    assert!(names("(7.4), (7.6)", 6) && !names("(7.4), (7.6)", 5) && !names("(7.x)", 5));
}
