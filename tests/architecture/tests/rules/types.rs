//! A name of a public type means one thing in its crate.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;

use architecture::packages::packages;
use proc_macro2::TokenStream;
use syn::visit::{self, Visit};

use crate::{files, root};

/// Names that two public types of one crate have, and why.
const ALLOWED: &[(&str, &str, &str)] = &[];

/// Names of public types of a file; tests do not count.
#[derive(Default)]
struct Types(Vec<String>);

impl<'ast> Visit<'ast> for Types {
    fn visit_item(&mut self, item: &'ast syn::Item) {
        let (visibility, name) = match item {
            syn::Item::Struct(item) => (&item.vis, &item.ident),
            syn::Item::Enum(item) => (&item.vis, &item.ident),
            syn::Item::Trait(item) => (&item.vis, &item.ident),
            syn::Item::Type(item) => (&item.vis, &item.ident),
            syn::Item::Mod(item) if item.attrs.iter().any(|attribute| attribute.path().is_ident("cfg")) => {
                return;
            }
            syn::Item::Macro(item) => return self.0.extend(types_among(item.mac.tokens.clone())),
            _ => return visit::visit_item(self, item),
        };
        if matches!(visibility, syn::Visibility::Public(_)) {
            self.0.push(name.to_string());
        }
    }

    fn visit_block(&mut self, _: &'ast syn::Block) {}
}

/// Names behind `pub struct` and `pub enum` among the tokens of a macro, which most samples and settings stand in.
fn types_among(tokens: TokenStream) -> Vec<String> {
    let words: Vec<String> = tokens.into_iter().map(|token| token.to_string()).collect();
    let declares = |words: &&[String]| words[0] == "pub" && ["struct", "enum"].contains(&words[1].as_str());
    words.windows(3).filter(declares).map(|words| words[2].clone()).filter(|name| name != "$").collect()
}

fn types(source: &str) -> Vec<String> {
    let mut types = Types::default();
    types.visit_file(&syn::parse_file(source).unwrap());
    types.0
}

#[test]
fn no_two_public_types_of_a_crate_have_one_name() {
    let mut twice = Vec::new();
    let mut found = 0;
    for package in packages(&root()).unwrap() {
        let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for file in files(&root().join(&package.folder).join("src"), ".rs") {
            for name in types(&std::fs::read_to_string(&file).unwrap()) {
                found += 1;
                places
                    .entry(name)
                    .or_default()
                    .push(file.file_name().unwrap().to_string_lossy().into_owned());
            }
        }
        let is_allowed =
            |name: &str| ALLOWED.iter().any(|(krate, other, _)| *krate == package.name && *other == name);
        let several = places.into_iter().filter(|(name, files)| files.len() > 1 && !is_allowed(name));
        twice.extend(
            several.map(|(name, files)| format!("{}: {name} in {}\n", package.name, files.join(", "))),
        );
    }
    assert!(found > 300, "{found}");
    assert!(twice.is_empty(), "\n{}", twice.concat());
}

#[test]
fn public_types_are_found_wherever_they_stand() {
    let source = "pub struct A; pub(crate) struct B; struct C; mod m { pub enum D {} } pub type E = A;
                  fn f() { pub struct F; } #[cfg(test)] mod tests { pub struct G; }
                  sample! { /// Doc.\n pub struct H(8) { pub a: u8 } } macro_rules! m { () => { pub struct $name; } }";
    assert_eq!(types(source), ["A", "D", "E", "H"]);
}
