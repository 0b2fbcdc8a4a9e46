//! A name of a public type means one thing in the workspace.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;

use architecture::packages::packages;
use proc_macro2::TokenStream;
use syn::visit::{self, Visit};

use crate::{files, root};

/// Names that several public types have, and why.
const ALLOWED: &[(&str, &str)] =
    &[("Imu", "the layout of its topic gives the name: the example and the program for ROS 2 both write it")];

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

/// Names that stand in several places, each with its places.
fn repeated(types: impl IntoIterator<Item = (String, String)>) -> BTreeMap<String, Vec<String>> {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (name, place) in types {
        places.entry(name).or_default().push(place);
    }
    places.retain(|_, places| places.len() > 1);
    places
}

#[test]
fn no_two_public_types_of_the_workspace_have_one_name() {
    let mut found = Vec::new();
    for package in packages(&root()).unwrap() {
        for file in files(&root().join(&package.folder).join("src"), ".rs") {
            let place = file.strip_prefix(root()).unwrap().to_string_lossy().into_owned();
            let types = types(&std::fs::read_to_string(&file).unwrap());
            found.extend(types.into_iter().map(|name| (name, place.clone())));
        }
    }
    assert!(found.len() > 500, "{}", found.len());
    let mut repeated = repeated(found);
    for (name, _) in ALLOWED {
        assert!(repeated.remove(*name).is_some(), "not needed any more: {name}");
    }
    let lines = repeated.iter().map(|(name, places)| format!("{name} in {}\n", places.join(", ")));
    assert!(repeated.is_empty(), "\n{}", lines.collect::<String>());
}

#[test]
fn a_name_of_two_files_is_repeated_and_a_name_of_one_is_not() {
    let types = [("Plan", "a.rs"), ("Chain", "a.rs"), ("Plan", "b.rs")];
    let types = types.map(|(name, place)| (name.to_owned(), place.to_owned()));
    let expected = BTreeMap::from([("Plan".to_owned(), vec!["a.rs".to_owned(), "b.rs".to_owned()])]);
    assert_eq!(repeated(types), expected);
}

#[test]
fn public_types_are_found_wherever_they_stand() {
    let source = "pub struct A; pub(crate) struct B; struct C; mod m { pub enum D {} } pub type E = A;
                  fn f() { pub struct F; } #[cfg(test)] mod tests { pub struct G; }
                  sample! { /// Doc.\n pub struct H(8) { pub a: u8 } } macro_rules! m { () => { pub struct $name; } }";
    assert_eq!(types(source), ["A", "D", "E", "H"]);
}
