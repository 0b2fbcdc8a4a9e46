//! Words that the glossary refuses, and where they are found.

use crate::markdown::{code_spans, table};

/// Names and phrases that are not used, with what is used instead, and what is allowed all the same.
#[derive(Debug, Clone, Default)]
pub struct Glossary {
    names: Vec<(String, String)>,
    phrases: Vec<(Vec<String>, String)>,
    allowed: Vec<(String, String)>,
}

/// One refused word in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hit {
    /// Line in the file, from 1.
    pub line: usize,
    /// The refused name or phrase.
    pub word: String,
    /// What the glossary has instead.
    pub instead: String,
}

impl Glossary {
    /// Reads the tables "Names", "Phrases" and "Allowed" of the page.
    pub fn read(page: &str) -> Self {
        let rows = |heading: &str| {
            let rows = table(page, heading).into_iter();
            rows.flat_map(|row| {
                code_spans(row[0]).map(move |word| (word.to_owned(), row[1])).collect::<Vec<_>>()
            })
        };
        let owned = |(word, other): (String, &str)| (word, other.to_owned());
        let phrase = |(phrase, instead): (String, &str)| {
            (phrase.split(' ').map(str::to_lowercase).collect(), instead.to_owned())
        };
        Self {
            names: rows("### Names").map(owned).collect(),
            phrases: rows("### Phrases").map(phrase).collect(),
            allowed: rows("### Allowed").map(owned).collect(),
        }
    }

    /// How many names and phrases are refused.
    pub fn len(&self) -> (usize, usize) {
        (self.names.len(), self.phrases.len())
    }

    /// The part of the table "Allowed" that no file needs, given whether a word is found in a file or folder.
    pub fn unneeded(&self, is_found: impl Fn(&str, &str) -> bool) -> Vec<&(String, String)> {
        self.allowed
            .iter()
            .filter(|(word, places)| !code_spans(places).any(|place| is_found(word, place)))
            .collect()
    }

    /// Whether a word may be used in a file.
    pub fn allows(&self, word: &str, file: &str) -> bool {
        let here = |places: &str| code_spans(places).any(|place| file.starts_with(place));
        self.allowed.iter().any(|(allowed, places)| allowed == word && here(places))
    }

    /// Refused names among the identifiers of code.
    pub fn names_in(&self, code: &str, first_line: usize) -> Vec<Hit> {
        let mut found = Vec::new();
        for (index, line) in code.split('\n').enumerate() {
            for identifier in line.split(|c: char| !c.is_alphanumeric() && c != '_') {
                let refused = self.names.iter().filter(|(name, _)| is_in(name, identifier));
                found.extend(refused.map(|(name, instead)| Hit {
                    line: first_line + index,
                    word: name.clone(),
                    instead: instead.clone(),
                }));
            }
        }
        found
    }

    /// Refused phrases in texts that follow each other, with the number of the first line of each.
    pub fn phrases_in<'a>(&self, texts: impl Iterator<Item = (usize, &'a str)>) -> Vec<Hit> {
        let words: Vec<(usize, String)> = texts.flat_map(|(line, text)| words(line, text)).collect();
        let mut found = Vec::new();
        for (phrase, instead) in &self.phrases {
            let matches = |window: &&[(usize, String)]| window.iter().map(|(_, word)| word).eq(phrase);
            found.extend(words.windows(phrase.len()).filter(matches).map(|window| Hit {
                line: window[0].0,
                word: phrase.join(" "),
                instead: instead.clone(),
            }));
        }
        found.sort_by_key(|hit| hit.line);
        found
    }
}

/// Whether an identifier has a name as one of its parts; a name in capitals only counts in the name of a constant.
fn is_in(name: &str, identifier: &str) -> bool {
    let is_constant = |text: &str| !text.contains(char::is_lowercase);
    (!is_constant(name) || is_constant(identifier))
        && components(identifier).any(|part| part == name.to_lowercase())
}

/// Parts of an identifier in snake, camel or upper case, in lower case.
fn components(identifier: &str) -> impl Iterator<Item = String> {
    let mut parts = vec![String::new()];
    let mut was_lower = false;
    for c in identifier.chars() {
        if c == '_' || c.is_uppercase() && was_lower {
            parts.push(String::new());
        }
        was_lower = c.is_lowercase() || c.is_numeric();
        if c != '_' {
            parts.last_mut().expect("never empty").extend(c.to_lowercase());
        }
    }
    parts.into_iter().filter(|part| !part.is_empty())
}

/// Words of a text in lower case with their lines; punctuation is a word of its own, so that no phrase reaches across it.
fn words(first_line: usize, text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (index, line) in text.split('\n').enumerate() {
        let mut word = String::new();
        for c in line.chars().chain([' ']) {
            if c.is_alphanumeric() || matches!(c, '_' | '-' | '\'') {
                word.extend(c.to_lowercase());
                continue;
            }
            if !word.is_empty() {
                found.push((first_line + index, std::mem::take(&mut word)));
            }
            if ".,;:!?()|".contains(c) {
                found.push((first_line + index, c.to_string()));
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: &str = "### Names\n\n| not | but |\n|---|---|\n| `ear`, `Ears` | waiter |\n| `MOST` | `MAX` |\n\n\
                        ### Phrases\n| not | but |\n|---|---|\n| `goes on` | continues |\n\n\
                        ### Allowed\n| word | in | reason |\n|---|---|---|\n| `ear` | `a/b`, `c.rs` | old |\n";

    fn words_of(hits: &[Hit]) -> Vec<(usize, &str)> {
        hits.iter().map(|hit| (hit.line, hit.word.as_str())).collect()
    }

    #[test]
    fn names_are_found_as_parts_of_identifiers() {
        let glossary = Glossary::read(PAGE);
        let hits = glossary.names_in("struct EarPort;\nlet most_clear = ear_of(MOST_ROWS, UTMOST);", 7);
        assert_eq!(words_of(&hits), [(7, "ear"), (8, "ear"), (8, "MOST")]);
        assert_eq!(glossary.len(), (3, 1));
    }

    #[test]
    fn phrases_are_found_across_lines_and_not_across_sentences() {
        let glossary = Glossary::read(PAGE);
        let texts = [(3, " The robot Goes"), (4, " on. It goes. On and on, goes-on")];
        assert_eq!(words_of(&glossary.phrases_in(texts.into_iter())), [(3, "goes on")]);
    }

    #[test]
    fn a_word_is_allowed_where_the_table_says_so() {
        let glossary = Glossary::read(PAGE);
        assert!(glossary.allows("ear", "a/b/d.rs") && glossary.allows("ear", "c.rs"));
        assert!(!glossary.allows("ear", "d.rs") && !glossary.allows("goes on", "c.rs"));
        assert_eq!(glossary.unneeded(|_, place| place == "d.rs").len(), 1);
    }
}
