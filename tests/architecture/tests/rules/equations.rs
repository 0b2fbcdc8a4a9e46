//! Every equation of the source has a home in the code that names it.

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

#[test]
fn every_equation_has_a_home_that_names_it() {
    let page = std::fs::read_to_string(root().join("docs/equations.md")).unwrap();
    let mut missing: Vec<u32> = (1..=46).collect();
    for row in page.lines().filter(|line| line.starts_with("| (7.")) {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let (range, _) = equations(cells[1]).unwrap();
        let text =
            std::fs::read_to_string(root().join(cells[3])).unwrap_or_else(|error| panic!("{row}: {error}"));
        assert!(text.contains(cells[4].trim_matches('`')), "{}: no {}", cells[3], cells[4]);
        for number in range {
            assert!(names(&text, number), "{} does not name (7.{number})", cells[3]);
            missing.retain(|other| *other != number);
        }
    }
    assert_eq!(missing, [], "equations without a home");
}

#[test]
fn a_range_names_what_lies_within() {
    assert!(names("the filter (7.9)-(7.13).", 11) && !names("the filter (7.9)-(7.13).", 14));
    assert!(names("(7.4), (7.6)", 6) && !names("(7.4), (7.6)", 5) && !names("(7.x)", 5));
}
