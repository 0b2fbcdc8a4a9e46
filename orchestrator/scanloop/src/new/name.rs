//! Names that no project can have, because its language or its tools have them.

use supervision::entry::{NAME_RULE, is_name};

use super::Language;
use super::template::Template;

/// Keywords of Rust, as Cargo has them, and those of edition 2024.
const RUST: &str = "abstract as async await become box break const continue crate do dyn else enum extern false final fn \
    for gen if impl in let loop macro match mod move mut override priv pub ref return self static struct super trait true \
    try type typeof unsafe unsized use virtual where yield";
/// Crates that come with Rust.
const CRATES_OF_RUST: &str = "alloc core proc_macro std test";
/// Names that Cargo allows no program, because it keeps such folders beside it.
const FOLDERS_OF_CARGO: &str = "build deps examples incremental";
/// Keywords of Python that are small letters.
const PYTHON: &str = "and as assert async await break class continue def del elif else except finally for from global if \
    import in is lambda nonlocal not or pass raise return try while with yield";
/// Keywords of C.
const C: &str = "auto break case char const continue default do double else enum extern float for goto if inline int long \
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while";

/// Why a project of this template can't have the name, or `None` where it can.
pub(super) fn refusal(name: &str, template: &Template) -> Option<String> {
    if !is_name(name) {
        return Some(NAME_RULE.to_owned());
    }
    let is_of = |words: &str| words.split_ascii_whitespace().any(|word| word == name.replace('-', "_"));
    let reasons: &[(&str, &str)] = match template.lang {
        Language::Rust => &[
            (RUST, "it is a keyword of Rust"),
            (CRATES_OF_RUST, "Rust has a crate of this name"),
            (FOLDERS_OF_CARGO, "Cargo has a folder of this name"),
        ],
        Language::Python => &[(PYTHON, "it is a keyword of Python")],
        Language::C => &[(C, "it is a keyword of C")],
    };
    let reserved = reasons.iter().find(|(words, _)| is_of(words)).map(|(_, reason)| *reason);
    let reason =
        reserved.or_else(|| template.uses_crate(name).then_some("the program uses a crate of this name"));
    reason.map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::super::ProjectRole;
    use super::super::template::find;
    use super::*;

    #[test]
    fn a_name_is_refused_with_what_has_it() {
        let reason = |name, lang| refusal(name, find(lang, ProjectRole::Robot).unwrap()).unwrap_or_default();
        assert!(reason("self", Language::Rust).contains("keyword of Rust"));
        assert!(reason("test", Language::Rust).contains("Rust has a crate"));
        assert!(reason("proc-macro", Language::Rust).contains("Rust has a crate"));
        assert!(reason("deps", Language::Rust).contains("Cargo has a folder"));
        assert!(reason("shared_types", Language::Rust).contains("uses a crate"));
        assert!(reason("lambda", Language::Python).contains("keyword of Python"));
        assert!(reason("typedef", Language::C).contains("keyword of C"));
        assert_eq!(reason("Mine", Language::C), NAME_RULE);
        for name in ["self-driving", "tests", "mine", "lambda", "edition", "serde-robot"] {
            assert_eq!(reason(name, Language::Rust), "", "{name}");
        }
    }
}
