//! Markdown pages: their links, their anchors and their prose.

/// Lines of a page outside of blocks of code, with their numbers from 1.
fn lines(page: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut is_code = false;
    page.lines().enumerate().filter_map(move |(index, line)| {
        let fence = line.trim_start().starts_with("```");
        is_code ^= fence;
        (!is_code && !fence).then_some((index + 1, line))
    })
}

/// Text of a page outside of code, line by line. Each code span leaves a full stop, so that no phrase reaches across it.
pub fn prose(page: &str) -> Vec<(usize, String)> {
    let is_text = |(is_code, text): (bool, &str)| if is_code { ". ".to_owned() } else { text.to_owned() };
    split(page).map(|(number, parts)| (number, parts.into_iter().map(is_text).collect())).collect()
}

/// All code spans of a page that stand in one line.
pub fn spans(page: &str) -> Vec<&str> {
    split(page).flat_map(|(_, parts)| parts).filter(|(is_code, _)| *is_code).map(|(_, text)| text).collect()
}

/// Lines of a page with their parts, and whether each is code; a code span ends with its paragraph at the latest.
fn split(page: &str) -> impl Iterator<Item = (usize, Vec<(bool, &str)>)> {
    let mut is_code = false;
    lines(page).map(move |(number, line)| {
        is_code &= !line.trim().is_empty();
        let mut parts = vec![(is_code, "")];
        for (index, text) in line.split('`').enumerate() {
            is_code ^= index > 0;
            parts.push((is_code, text));
        }
        (number, parts)
    })
}

/// Targets of all links and pictures of a page, with the numbers of their lines.
pub fn links(page: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (number, line) in prose(page) {
        for (at, _) in line.match_indices("](") {
            let target = line[at + 2..].split(')').next().unwrap_or_default();
            found.push((number, target.split_whitespace().next().unwrap_or_default().to_owned()));
        }
    }
    found
}

/// Anchors of all headings of a page; the second of two equal ones gets `-1`.
pub fn anchors(page: &str) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    for (_, line) in lines(page).filter(|(_, line)| line.starts_with('#')) {
        let anchor = anchor(line.trim_start_matches('#').trim());
        let before = found.iter().filter(|other| **other == anchor).count();
        found.push(if before == 0 { anchor } else { format!("{anchor}-{before}") });
    }
    found
}

/// The anchor of a heading: lower case, blanks as hyphens, without other punctuation.
fn anchor(heading: &str) -> String {
    let kept = heading.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.flat_map(char::to_lowercase).map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// Rows of the table below a heading, without its head: the cells of each, trimmed.
pub fn table<'a>(page: &'a str, heading: &str) -> Vec<Vec<&'a str>> {
    let below = lines(page).map(|(_, line)| line).skip_while(|line| *line != heading).skip(1);
    let section = below.take_while(|line| !line.starts_with('#'));
    let rows = section.filter(|line| line.starts_with('|')).skip(2);
    rows.map(|row| row.trim_matches('|').split('|').map(str::trim).collect()).collect()
}

/// What stands between backticks.
pub fn code_spans(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').enumerate().filter(|(index, _)| index % 2 == 1).map(|(_, span)| span)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: &str = "# A `b`: c?\n[one](x.md#y) and `[no](z.md)`\n```\n# no\n[no](z.md)\n```\n## A b c\n![two](p.svg)\n\n\
                        | head | head |\n|---|---|\n| `a`, `b` | c |\n\n## Other\n| no |\n|---|\n| no |\n";

    #[test]
    fn links_and_anchors_outside_of_code_are_found() {
        assert_eq!(links(PAGE), [(2, "x.md#y".to_owned()), (8, "p.svg".to_owned())]);
        assert_eq!(anchors(PAGE), ["a-b-c", "a-b-c-1", "other"]);
    }

    #[test]
    fn code_spans_may_be_broken_across_lines() {
        let page = "one `two\nthree` four `five`\n\n`six\n\nseven";
        let text: Vec<String> = prose(page).into_iter().map(|(_, text)| text.replace(". ", "")).collect();
        assert_eq!(text, ["one ", " four ", "", "", "", "seven"]);
        assert!(spans(page).contains(&"five") && !spans(page).contains(&" four "));
    }

    #[test]
    fn the_table_of_a_section_is_read() {
        assert_eq!(table(PAGE, "## A b c"), [["`a`, `b`", "c"]]);
        assert_eq!(code_spans("`a`, `b`").collect::<Vec<_>>(), ["a", "b"]);
    }
}
