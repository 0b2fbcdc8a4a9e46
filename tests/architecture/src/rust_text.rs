//! The code of a Rust file and its text apart: identifiers here, comments and string literals there.

/// A part of a file with the number of its first line, from 1.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Part<'a> {
    /// Code without comments and literals.
    Code(usize, &'a str),
    /// A comment, or the content of a string literal.
    Text(usize, &'a str),
}

/// All parts of a Rust file in order.
pub fn parts(source: &str) -> Vec<Part<'_>> {
    let mut found = Vec::new();
    let (mut code_from, mut at) = (0, 0);
    while at < source.len() {
        let Some((text, end)) = text_at(source, at) else {
            at += character(source, at);
            continue;
        };
        found.push(Part::Code(line_of(source, code_from), &source[code_from..at]));
        found.push(Part::Text(line_of(source, at), text));
        (code_from, at) = (end, end);
    }
    found.push(Part::Code(line_of(source, code_from), &source[code_from..]));
    found
}

fn line_of(source: &str, at: usize) -> usize {
    source[..at].matches('\n').count() + 1
}

/// Length of the character at a place; of the whole literal where a character literal begins.
fn character(source: &str, at: usize) -> usize {
    let rest = &source[at..];
    let first = rest.chars().next().map_or(1, char::len_utf8);
    if let Some(literal) = rest.strip_prefix("'\\") {
        return literal.char_indices().skip(1).find(|(_, c)| *c == '\'').map_or(first, |(end, _)| end + 3);
    }
    if let Some(literal) = rest.strip_prefix('\'') {
        let inner = literal.chars().next().map_or(0, char::len_utf8);
        return if literal[inner..].starts_with('\'') { inner + 2 } else { first };
    }
    first
}

/// The comment or string literal that begins at a place, and where it ends.
fn text_at(source: &str, at: usize) -> Option<(&str, usize)> {
    let rest = &source[at..];
    if rest.starts_with("//") {
        let end = rest.find('\n').unwrap_or(rest.len());
        return Some((rest[..end].trim_start_matches(['/', '!']), at + end));
    }
    if rest.starts_with("/*") {
        let end = rest.find("*/").map_or(rest.len(), |end| end + 2);
        return Some((&rest[2..end], at + end));
    }
    if let Some(literal) = rest.strip_prefix('"') {
        let end = end_of_literal(literal);
        return Some((&literal[..end], at + 1 + end + 1));
    }
    let raw = rest
        .strip_prefix('r')
        .filter(|_| !source[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_'))?;
    let hashes = raw.len() - raw.trim_start_matches('#').len();
    let literal = raw[hashes..].strip_prefix('"')?;
    let closing = format!("\"{}", "#".repeat(hashes));
    let end = literal.find(&closing)?;
    Some((&literal[..end], at + 1 + hashes + 1 + end + closing.len()))
}

/// Where the quote stands that ends a string literal.
fn end_of_literal(literal: &str) -> usize {
    let mut is_escaped = false;
    for (index, byte) in literal.bytes().enumerate() {
        match byte {
            _ if is_escaped => is_escaped = false,
            b'\\' => is_escaped = true,
            b'"' => return index,
            _ => {}
        }
    }
    literal.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_literals_are_told_from_code() {
        let source = "fn a() { // one\n  b(\"two \\\" \", '\"', '\\'', r#\"three\"#, &'a x) }\n/// four";
        let texts: Vec<_> = parts(source)
            .into_iter()
            .filter_map(|part| match part {
                Part::Text(line, text) => Some((line, text)),
                Part::Code(..) => None,
            })
            .collect();
        assert_eq!(texts, [(1, " one"), (2, "two \\\" "), (2, "three"), (3, " four")]);
        let code: String = parts(source)
            .iter()
            .map(|part| if let Part::Code(_, code) = part { *code } else { "" })
            .collect();
        assert_eq!(code, "fn a() { \n  b(, '\"', '\\'', , &'a x) }\n");
    }
}
