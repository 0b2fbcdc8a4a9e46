//! JSON that people can read.

/// Maximum length of a line with a joined object or array.
const MAX_LINE: usize = 200;

/// Puts every object and array that holds plain values only on one line, if it fits.
///
/// Works on the lines of the pretty printer. JSON strings hold no raw line ends, so a bracket at the end of a line
/// always opens an object or array.
pub(super) fn join_leaves(pretty: &str) -> String {
    let mut joined = String::with_capacity(pretty.len());
    // Lines since the last opening bracket that has not been closed; empty when there is none.
    let mut leaf: Vec<&str> = Vec::new();
    for line in pretty.lines() {
        if line.ends_with(['{', '[']) {
            append(&mut joined, &leaf);
            leaf.clear();
            leaf.push(line);
        } else if !leaf.is_empty() && line.trim_start().starts_with(['}', ']']) {
            leaf.push(line);
            append_joined(&mut joined, &leaf);
            leaf.clear();
        } else if leaf.is_empty() {
            append(&mut joined, &[line]);
        } else {
            leaf.push(line);
        }
    }
    append(&mut joined, &leaf);
    joined
}

fn append(text: &mut String, lines: &[&str]) {
    for line in lines {
        text.push_str(line);
        text.push('\n');
    }
}

fn append_joined(text: &mut String, leaf: &[&str]) {
    let (first, last) = (leaf[0], leaf[leaf.len() - 1].trim_start());
    let length: usize = first.len() + leaf[1..].iter().map(|line| line.trim_start().len() + 1).sum::<usize>();
    if length > MAX_LINE {
        append(text, leaf);
        return;
    }
    // Objects keep a space inside their braces, arrays do not.
    let gap = if first.ends_with('{') { " " } else { "" };
    text.push_str(first);
    for (index, line) in leaf[1..leaf.len() - 1].iter().enumerate() {
        text.push_str(if index == 0 { gap } else { " " });
        text.push_str(line.trim_start());
    }
    text.push_str(gap);
    text.push_str(last);
    text.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_that_looks_like_an_opening_bracket_is_none() {
        let pretty = "{\n  \"a\": \"x {\",\n  \"b\": {\n    \"c\": \"[\"\n  }\n}";
        assert_eq!(join_leaves(pretty), "{\n  \"a\": \"x {\",\n  \"b\": { \"c\": \"[\" }\n}\n");
    }
}
