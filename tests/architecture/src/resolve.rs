//! Which file defines the name at the end of a path.

use std::collections::BTreeSet;

use crate::modules::Modules;

/// What a path leads to within its crate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PathTarget {
    /// A module.
    Module(usize),
    /// The item with this name of a module.
    Item(usize, String),
}

/// Which of two things of one name is meant: `a` is a module in `a::b`, and anything at the end of a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Wanted {
    Module,
    Any,
}

impl Modules {
    /// What a path means in a module; none when it leads out of the crate, or is a local name.
    pub fn resolve(&self, module: usize, path: &[String]) -> Option<PathTarget> {
        self.follow(module, path, Wanted::Any, &mut BTreeSet::new())
    }

    fn follow(&self, module: usize, path: &[String], wanted: Wanted, seen: &mut Seen) -> Option<PathTarget> {
        let mut at = PathTarget::Module(module);
        for (index, name) in path.iter().enumerate() {
            // What follows an item is a part of it: a variant, an associated function.
            let PathTarget::Module(inside) = at else { break };
            let wanted = if index + 1 < path.len() { Wanted::Module } else { wanted };
            at = match name.as_str() {
                "crate" => PathTarget::Module(0),
                "self" => PathTarget::Module(inside),
                "super" => PathTarget::Module(self.all[inside].parent?),
                name => self.look_up(inside, name, wanted, seen)?,
            };
        }
        Some(at)
    }

    /// What a name is in a module: defined there, imported by name, or by a glob.
    fn look_up(&self, module: usize, name: &str, wanted: Wanted, seen: &mut Seen) -> Option<PathTarget> {
        // Imports may lead in circles.
        if !seen.insert((module, name.to_owned(), wanted)) {
            return None;
        }
        let this = &self.all[module];
        let item = this.items.contains(name).then(|| PathTarget::Item(module, name.to_owned()));
        let child = this.children.get(name).map(|child| PathTarget::Module(*child));
        let own = if wanted == Wanted::Module { child.or(item) } else { item.or(child) };
        let by_name = || {
            let paths = this.imports.get(name).into_iter().flatten();
            let mut targets = paths.filter_map(|path| self.follow(module, path, wanted, &mut seen.clone()));
            targets.next()
        };
        let by_glob = || {
            let mut globs = this.globs.iter().filter_map(|path| {
                match self.follow(module, path, Wanted::Module, &mut seen.clone())? {
                    PathTarget::Module(from) => self.look_up(from, name, wanted, &mut seen.clone()),
                    PathTarget::Item(..) => None,
                }
            });
            globs.next()
        };
        own.or_else(by_name).or_else(by_glob)
    }
}

/// Names that are being looked up.
type Seen = BTreeSet<(usize, String, Wanted)>;
