//! The paths that code mentions, `use` declarations included.

use proc_macro2::{TokenStream, TokenTree};
use syn::UseTree;

/// Segments of a path as they are written.
pub type Path = Vec<String>;

/// One name that a `use` declaration brings in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Import {
    /// `use path as name`.
    Name(String, Path),
    /// `use path::*`.
    Glob(Path),
}

/// All names of a `use` declaration.
pub fn imports(tree: &UseTree) -> Vec<Import> {
    let mut found = Vec::new();
    collect(tree, &[], &mut found);
    found
}

fn collect(tree: &UseTree, before: &[String], found: &mut Vec<Import>) {
    let with = |ident: &syn::Ident| [before, &[text(ident)]].concat();
    match tree {
        UseTree::Path(path) => collect(&path.tree, &with(&path.ident), found),
        UseTree::Group(group) => group.items.iter().for_each(|item| collect(item, before, found)),
        UseTree::Glob(_) => found.push(Import::Glob(before.to_vec())),
        UseTree::Name(name) if name.ident == "self" => {
            found.push(Import::Name(before.last().cloned().unwrap_or_default(), before.to_vec()));
        }
        UseTree::Name(name) => found.push(Import::Name(text(&name.ident), with(&name.ident))),
        UseTree::Rename(rename) if rename.ident == "self" => {
            found.push(Import::Name(text(&rename.rename), before.to_vec()));
        }
        UseTree::Rename(rename) => found.push(Import::Name(text(&rename.rename), with(&rename.ident))),
    }
}

/// Segments of a path in code; none for one that starts at the root of all crates.
pub fn of(path: &syn::Path) -> Option<Path> {
    path.leading_colon.is_none().then(|| path.segments.iter().map(|segment| text(&segment.ident)).collect())
}

/// Whatever looks like a path among the tokens of a macro or an attribute.
pub fn in_tokens(tokens: TokenStream, found: &mut Vec<Path>) {
    // Segments so far, and how many colons followed them.
    let (mut path, mut colons) = (Path::new(), 0);
    for token in tokens {
        match token {
            TokenTree::Ident(ident) => {
                if colons != 2 {
                    found.push(std::mem::take(&mut path));
                }
                path.push(text(&ident));
                colons = 0;
            }
            TokenTree::Punct(punct) if punct.as_char() == ':' => colons += 1,
            other => {
                found.push(std::mem::take(&mut path));
                colons = 0;
                match other {
                    TokenTree::Group(group) => in_tokens(group.stream(), found),
                    // `#[serde(default = "crate::limits::most")]`
                    TokenTree::Literal(literal) => found.extend(in_text(&literal.to_string())),
                    TokenTree::Punct(_) | TokenTree::Ident(_) => {}
                }
            }
        }
    }
    found.push(path);
    found.retain(|path| !path.is_empty());
}

fn in_text(literal: &str) -> Option<Path> {
    let text = literal.trim_matches('"');
    let is_path = text.starts_with("crate::") || text.starts_with("super::") || text.starts_with("self::");
    is_path.then(|| text.split("::").map(str::to_owned).collect())
}

fn text(ident: &syn::Ident) -> String {
    let text = ident.to_string();
    text.strip_prefix("r#").map(str::to_owned).unwrap_or(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(text: &str) -> Path {
        text.split("::").map(str::to_owned).collect()
    }

    #[test]
    fn a_use_declaration_is_taken_apart() {
        let item: syn::ItemUse = syn::parse_str("use a::{b, c as d, e::{self, f::*}};").unwrap();
        let name = |name: &str, of: &str| Import::Name(name.to_owned(), path(of));
        let expected =
            [name("b", "a::b"), name("d", "a::c"), name("e", "a::e"), Import::Glob(path("a::e::f"))];
        assert_eq!(imports(&item.tree), expected);
    }

    #[test]
    fn paths_are_found_among_the_tokens_of_a_macro() {
        let mut found = Vec::new();
        in_tokens("\"{}\", crate::a::B::c(super::d), x: y, \"self::e\"".parse().unwrap(), &mut found);
        let expected = ["crate::a::B::c", "super::d", "x", "y", "self::e"];
        assert_eq!(found, expected.map(path));
    }
}
