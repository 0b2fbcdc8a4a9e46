//! The modules of a crate: where each stands, what it defines, what it imports, and which paths its code mentions.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path as FilePath, PathBuf};

use anyhow::Context;
use syn::visit::{self, Visit};
use syn::{Attribute, Item};

use crate::paths::{self, Import, Path};

/// Texts of the files of a crate, by path below `src`.
#[derive(Debug, Clone, Default)]
pub struct Sources(BTreeMap<PathBuf, String>);

impl Sources {
    /// Reads all Rust files below a folder.
    ///
    /// # Errors
    /// The first error of the file system.
    pub fn read(folder: &FilePath) -> anyhow::Result<Self> {
        let mut sources = Self::default();
        sources.add(folder, folder)?;
        Ok(sources)
    }

    fn add(&mut self, root: &FilePath, folder: &FilePath) -> anyhow::Result<()> {
        for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
            let path = entry?.path();
            if path.is_dir() {
                self.add(root, &path)?;
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
                self.0.insert(path.strip_prefix(root)?.to_owned(), text);
            }
        }
        Ok(())
    }
}

impl<const N: usize> From<[(&str, &str); N]> for Sources {
    fn from(files: [(&str, &str); N]) -> Self {
        Self(files.into_iter().map(|(path, text)| (path.into(), text.to_owned())).collect())
    }
}

/// One module.
#[derive(Debug, Default)]
pub struct Module {
    /// The file that its code stands in, below `src`.
    pub file: PathBuf,
    /// The module around it.
    pub parent: Option<usize>,
    /// Modules in it, by name.
    pub children: BTreeMap<String, usize>,
    /// Names of the items that it defines itself.
    pub items: BTreeSet<String>,
    /// Paths of the names that it imports or re-exports.
    pub imports: BTreeMap<String, Vec<Path>>,
    /// Paths of its globs.
    pub globs: Vec<Path>,
    /// All paths that its code mentions, those of its imports included.
    pub paths: BTreeSet<Path>,
}

/// All modules of a crate; the first one is the root.
#[derive(Debug)]
pub struct Modules {
    /// The modules.
    pub all: Vec<Module>,
    /// Where each macro is defined: one that is called by its bare name need not be imported.
    pub macros: BTreeMap<String, usize>,
}

impl Modules {
    /// Parses the crate whose root is `lib.rs`, or `main.rs` when there is no library.
    ///
    /// # Errors
    /// A file that is missing or does not parse.
    pub fn parse(sources: &Sources) -> anyhow::Result<Self> {
        let root = ["lib.rs", "main.rs"].into_iter().map(PathBuf::from);
        let root = root.into_iter().find(|file| sources.0.contains_key(file)).context("no root")?;
        let mut modules = Self { all: Vec::new(), macros: BTreeMap::new() };
        modules.add_file(sources, root, None, FilePath::new(""))?;
        Ok(modules)
    }

    /// Whether one of two files has a module that is the parent of one in the other.
    pub fn are_related(&self, one: &FilePath, other: &FilePath) -> bool {
        self.all.iter().any(|module| {
            let parent = module.parent.map(|parent| self.all[parent].file.as_path());
            let file = module.file.as_path();
            file == one && parent == Some(other) || file == other && parent == Some(one)
        })
    }

    /// Adds the module of a file and all below it; its child modules have their files in `folder`.
    fn add_file(
        &mut self,
        sources: &Sources,
        file: PathBuf,
        parent: Option<usize>,
        folder: &FilePath,
    ) -> anyhow::Result<usize> {
        let syntax = syn::parse_file(&sources.0[&file]).with_context(|| file.display().to_string())?;
        self.add(sources, file, parent, folder, &syntax.items)
    }

    fn add(
        &mut self,
        sources: &Sources,
        file: PathBuf,
        parent: Option<usize>,
        folder: &FilePath,
        items: &[Item],
    ) -> anyhow::Result<usize> {
        let index = self.all.len();
        let mut reader = Reader {
            module: Module { file: file.clone(), parent, ..Module::default() },
            ..Reader::default()
        };
        items.iter().for_each(|item| reader.visit_item(item));
        self.all.push(reader.module);
        self.macros.extend(reader.macros.into_iter().map(|name| (name, index)));
        for inner in reader.modules {
            let name = inner.ident.to_string();
            let folder = folder.join(&name);
            let child = match &inner.content {
                Some((_, items)) => self.add(sources, file.clone(), Some(index), &folder, items)?,
                None => {
                    let candidates = [folder.with_extension("rs"), folder.join("mod.rs")];
                    let found = candidates.into_iter().find(|file| sources.0.contains_key(file));
                    let found =
                        found.with_context(|| format!("{}: no file of mod {name}", file.display()))?;
                    self.add_file(sources, found, Some(index), &folder)?
                }
            };
            self.all[index].children.insert(name, child);
        }
        Ok(index)
    }
}

/// Reads the items of one module; modules in it are left for later.
#[derive(Default)]
struct Reader<'a> {
    module: Module,
    modules: Vec<&'a syn::ItemMod>,
    macros: Vec<String>,
}

impl Reader<'_> {
    fn import(&mut self, item: &syn::ItemUse) {
        if item.leading_colon.is_some() {
            return;
        }
        for import in paths::imports(&item.tree) {
            match import {
                Import::Name(name, path) => {
                    self.module.paths.insert(path.clone());
                    self.module.imports.entry(name).or_default().push(path);
                }
                Import::Glob(path) => self.module.globs.push(path),
            }
        }
    }

    fn tokens(&mut self, tokens: &proc_macro2::TokenStream) {
        let mut found = Vec::new();
        paths::in_tokens(tokens.clone(), &mut found);
        self.module.paths.extend(found);
    }
}

impl<'ast> Visit<'ast> for Reader<'ast> {
    fn visit_item(&mut self, item: &'ast Item) {
        let (attributes, name) = head(item);
        if is_test(attributes) {
            return;
        }
        self.module.items.extend(name.map(ToString::to_string));
        match item {
            Item::Mod(inner) => self.modules.push(inner),
            Item::Use(item) => self.import(item),
            Item::Macro(item) if item.ident.is_some() => {
                self.macros.extend(name.map(ToString::to_string));
                self.tokens(&item.mac.tokens);
            }
            _ => visit::visit_item(self, item),
        }
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        if !is_test(&item.attrs) {
            visit::visit_impl_item_fn(self, item);
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        self.module.paths.extend(paths::of(path));
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        self.tokens(&call.tokens);
        visit::visit_macro(self, call);
    }

    fn visit_attribute(&mut self, attribute: &'ast Attribute) {
        if let syn::Meta::List(list) = &attribute.meta {
            self.tokens(&list.tokens);
        }
    }

    // `pub(in path)` uses nothing.
    fn visit_visibility(&mut self, _: &'ast syn::Visibility) {}
}

/// Attributes and name of an item; none for a module, which is no item of its own file, and for what has no name.
fn head(item: &Item) -> (&[Attribute], Option<&syn::Ident>) {
    match item {
        Item::Const(item) => (&item.attrs, Some(&item.ident)),
        Item::Enum(item) => (&item.attrs, Some(&item.ident)),
        Item::ExternCrate(item) => (&item.attrs, None),
        Item::Fn(item) => (&item.attrs, Some(&item.sig.ident)),
        Item::ForeignMod(item) => (&item.attrs, None),
        Item::Impl(item) => (&item.attrs, None),
        Item::Macro(item) => (&item.attrs, item.ident.as_ref()),
        Item::Mod(item) => (&item.attrs, None),
        Item::Static(item) => (&item.attrs, Some(&item.ident)),
        Item::Struct(item) => (&item.attrs, Some(&item.ident)),
        Item::Trait(item) => (&item.attrs, Some(&item.ident)),
        Item::TraitAlias(item) => (&item.attrs, Some(&item.ident)),
        Item::Type(item) => (&item.attrs, Some(&item.ident)),
        Item::Union(item) => (&item.attrs, Some(&item.ident)),
        Item::Use(item) => (&item.attrs, None),
        _ => (&[], None),
    }
}

/// Whether an item has `#[cfg(test)]`.
fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<syn::Path>().is_ok_and(|path| path.is_ident("test"))
    })
}
