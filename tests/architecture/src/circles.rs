//! Circles between the files of a crate.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;
use std::path::{Path, PathBuf};

use crate::modules::{Module, Modules, Sources};
use crate::resolve::PathTarget;

/// Which file of a crate uses which, and for which names. A module and its parent may use each other: that is left out.
#[derive(Debug, Default)]
pub struct Graph {
    uses: BTreeMap<PathBuf, BTreeMap<PathBuf, BTreeSet<String>>>,
}

/// Files of which each uses the next, with the names that it uses, and the last one the first.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Circle(Vec<(PathBuf, Vec<String>)>);

impl Graph {
    /// The graph of a crate.
    ///
    /// # Errors
    /// A file that is missing or does not parse.
    pub fn of(sources: &Sources) -> anyhow::Result<Self> {
        let modules = Modules::parse(sources)?;
        let mut graph = Self::default();
        for (index, module) in modules.all.iter().enumerate() {
            graph.add(&modules, index, module);
        }
        Ok(graph)
    }

    fn add(&mut self, modules: &Modules, index: usize, module: &Module) {
        for path in &module.paths {
            let (target, name) = match modules.resolve(index, path) {
                Some(PathTarget::Item(target, name)) => (target, name),
                // A module has no definition of its own; what is used of it says where that stands.
                Some(PathTarget::Module(_)) => continue,
                None => match (path.as_slice(), path.first().and_then(|name| modules.macros.get(name))) {
                    ([name], Some(target)) => (*target, name.clone()),
                    _ => continue,
                },
            };
            let file = &modules.all[target].file;
            if *file != module.file && !modules.are_related(file, &module.file) {
                let uses = self.uses.entry(module.file.clone()).or_default();
                uses.entry(file.clone()).or_default().insert(name);
            }
        }
    }

    /// A shortest circle through each use that is part of one.
    pub fn circles(&self) -> BTreeSet<Circle> {
        let edges = self.uses.iter().flat_map(|(from, targets)| targets.keys().map(move |to| (from, to)));
        edges.filter_map(|(from, to)| self.way_back(from, to)).map(|files| self.circle(&files)).collect()
    }

    /// The files of the shortest way that starts with a use and ends where it began.
    fn way_back<'a>(&'a self, from: &'a Path, to: &'a Path) -> Option<Vec<&'a Path>> {
        let mut before = BTreeMap::from([(to, from)]);
        let mut queue = VecDeque::from([to]);
        while let Some(file) = queue.pop_front() {
            if file == from {
                let mut files = vec![before[from]];
                while files[files.len() - 1] != from {
                    files.push(before[files[files.len() - 1]]);
                }
                files.reverse();
                return Some(files);
            }
            for next in self.uses.get(file).into_iter().flat_map(BTreeMap::keys) {
                if !before.contains_key(next.as_path()) {
                    before.insert(next, file);
                    queue.push_back(next);
                }
            }
        }
        None
    }

    /// A circle, starting with its first file by name.
    fn circle(&self, files: &[&Path]) -> Circle {
        let first = (0..files.len()).min_by_key(|index| files[*index]).unwrap_or(0);
        let link = |index: usize| {
            let (from, to) = (files[index % files.len()], files[(index + 1) % files.len()]);
            (from.to_owned(), self.uses[from][to].iter().cloned().collect())
        };
        Circle((first..first + files.len()).map(link).collect())
    }

    /// Number of files that stand in a circle.
    pub fn in_circles(circles: &BTreeSet<Circle>) -> usize {
        circles.iter().flat_map(|circle| &circle.0).map(|(file, _)| file).collect::<BTreeSet<_>>().len()
    }
}

impl fmt::Display for Circle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (file, names) in &self.0 {
            let more = if names.len() > 2 { ", ..." } else { "" };
            write!(f, "{} -[{}{more}]-> ", file.display(), names[..names.len().min(2)].join(", "))?;
        }
        self.0.first().map_or(Ok(()), |(file, _)| write!(f, "{}", file.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The circles of a crate of these files, as texts.
    fn circles<const N: usize>(files: [(&str, &str); N]) -> Vec<String> {
        Graph::of(&Sources::from(files)).unwrap().circles().iter().map(Circle::to_string).collect()
    }

    /// A crate with modules `a` and `b`, of which `b` uses `a`.
    fn with_a(root: &str, a: &str) -> Vec<String> {
        let root = format!("mod a; mod b; {root}");
        circles([("lib.rs", &root), ("a.rs", a), ("b.rs", "pub struct B; fn f(_: crate::a::A) {}")])
    }

    const CIRCLE: &str = "a.rs -[B]-> b.rs -[A]-> a.rs";

    #[test]
    fn files_that_use_each_other_are_a_circle() {
        assert_eq!(with_a("", "pub struct A(crate::b::B);"), [CIRCLE]);
        assert_eq!(with_a("", "use super::b::{B as C}; pub struct A(C);"), [CIRCLE]);
        assert_eq!(with_a("", "pub struct A; fn f() { use crate::b::B; }"), [CIRCLE]);
        assert!(with_a("", "pub struct A;").is_empty());
    }

    #[test]
    fn a_circle_over_several_files_is_found_once() {
        let found = circles([
            ("lib.rs", "mod a; mod b; mod c; mod d;"),
            ("a.rs", "pub struct A(crate::b::B);"),
            ("b.rs", "pub struct B(crate::c::C);"),
            ("c/mod.rs", "pub struct C(crate::a::A);"),
            ("d.rs", "pub struct D(crate::a::A);"),
        ]);
        assert_eq!(found, ["a.rs -[B]-> b.rs -[C]-> c/mod.rs -[A]-> a.rs"]);
    }

    #[test]
    fn a_re_export_stands_for_the_file_that_defines_the_name() {
        let a = "use crate::B; pub struct A(B);";
        assert_eq!(with_a("pub use b::B;", a), [CIRCLE]);
        assert_eq!(with_a("pub use b::*;", a), [CIRCLE]);
        assert_eq!(with_a("pub mod c { pub use crate::b::B; } pub use c::B;", a), [CIRCLE]);
        assert!(with_a("pub struct B;", "use crate::B; pub struct A(B);").is_empty());
    }

    #[test]
    fn names_that_come_with_a_glob_are_uses() {
        assert_eq!(with_a("", "use crate::b::*; pub struct A(B);"), [CIRCLE]);
        assert_eq!(with_a("use b::B;", "use super::*; pub struct A(B);"), [CIRCLE]);
        assert!(with_a("use b::B;", "use super::*; pub struct A;").is_empty());
    }

    #[test]
    fn macros_and_attributes_are_looked_into() {
        assert_eq!(with_a("", "pub struct A; fn f() { println!(\"{}\", crate::b::B::n()) }"), [CIRCLE]);
        assert_eq!(with_a("", "#[serde(default = \"crate::b::B\")] pub struct A;"), [CIRCLE]);
        assert_eq!(with_a("", "macro_rules! m { () => { $crate::b::B } } pub struct A;"), [CIRCLE]);
    }

    #[test]
    fn a_macro_that_is_not_imported_belongs_to_its_file() {
        let found = circles([
            ("lib.rs", "#[macro_use] mod a; mod b;"),
            ("a.rs", "macro_rules! note { () => { $crate::b::f() } }"),
            ("b.rs", "pub fn f() { note!() }"),
        ]);
        assert_eq!(found, ["a.rs -[f]-> b.rs -[note]-> a.rs"]);
    }

    #[test]
    fn a_parent_and_its_child_may_use_each_other() {
        let files = [("lib.rs", "mod a;"), ("a.rs", "mod b; pub struct A(b::B);")];
        assert!(circles([files[0], files[1], ("a/b.rs", "pub struct B(Box<super::A>);")]).is_empty());
        let grandchild = ("a/b/d.rs", "pub struct D(Box<crate::a::A>);");
        let b = ("a/b.rs", "mod d; pub struct B;");
        let found = circles([files[0], ("a.rs", "mod b; pub struct A(b::d::D);"), b, grandchild]);
        assert_eq!(found, ["a/b/d.rs -[A]-> a.rs -[D]-> a/b/d.rs"]);
    }

    #[test]
    fn what_tests_use_does_not_count() {
        assert!(with_a("", "pub struct A; #[cfg(test)] mod tests;").is_empty());
        assert!(with_a("", "pub struct A; #[cfg(test)] mod tests { use crate::b::B; }").is_empty());
        assert!(with_a("", "pub struct A; impl A { #[cfg(test)] fn f(_: crate::b::B) {} }").is_empty());
    }

    #[test]
    fn a_module_and_a_function_of_one_name_are_told_apart() {
        let found = circles([
            ("lib.rs", "mod a; mod b; mod c; pub use b::c;"),
            ("a.rs", "pub struct A; fn f() { crate::c::g() }"),
            ("b.rs", "pub fn c(_: crate::a::A) {}"),
            ("c.rs", "pub fn g() {}"),
        ]);
        assert!(found.is_empty(), "{found:?}");
    }
}
