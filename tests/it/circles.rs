//! Checks that files import each other in no circle. A module and the modules inside it may use each other.
//!
//! An import counts for the file that defines the item, also if another file exports it again. A module uses the modules
//! inside it to wire them, so these imports do not count; those in the other direction do. Calls of methods are no
//! imports: an `impl` may stand in a file above that of its type.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use syn::punctuated::Punctuated;
use syn::visit::{self, Visit};
use syn::{Attribute, Expr, ItemMod, ItemUse, Macro, MetaList, Token, UseTree, Visibility};

/// The segments of a path in the source.
type Segments = Vec<String>;

/// What a file names of others.
#[derive(Default)]
struct Names {
    /// Each import with the name that the file gives it.
    imports: Vec<(Segments, String)>,
    /// Paths in expressions, types and patterns.
    paths: Vec<Segments>,
    /// Modules that are compiled for tests alone.
    tests: Vec<String>,
    /// The number of inline modules around the current item.
    depth: usize,
}

impl Names {
    fn of(source: &str) -> Self {
        let mut names = Self::default();
        names.visit_file(&syn::parse_file(source).unwrap());
        names
    }

    /// Returns the segments as they are outside the inline modules.
    fn outside(&self, segments: Segments) -> Segments {
        let supers = segments.iter().take_while(|segment| *segment == "super").count().min(self.depth);
        if supers > 0 && supers == self.depth {
            std::iter::once("self".to_owned()).chain(segments.into_iter().skip(supers)).collect()
        } else {
            segments.into_iter().skip(supers).collect()
        }
    }

    /// Takes the paths in arguments of a macro or an attribute, if they are expressions.
    fn arguments(&mut self, arguments: syn::Result<Punctuated<Expr, Token![,]>>) {
        // The arguments live no longer than this call, so their visitor is another one.
        let mut inside = Self { depth: self.depth, ..Self::default() };
        arguments.iter().flatten().for_each(|argument| inside.visit_expr(argument));
        self.paths.append(&mut inside.paths);
    }

    fn import(&mut self, tree: &UseTree, mut before: Segments) {
        let mut add = |mut segments: Segments, name: String| {
            if segments.last().is_some_and(|last| last == "self") {
                segments.pop();
            }
            let name = if name == "self" { segments.last().cloned().unwrap_or_default() } else { name };
            let segments = self.outside(segments);
            self.imports.push((segments, name));
        };
        match tree {
            UseTree::Path(path) => {
                before.push(path.ident.to_string());
                self.import(&path.tree, before);
            }
            UseTree::Group(group) => group.items.iter().for_each(|item| self.import(item, before.clone())),
            UseTree::Name(name) => {
                before.push(name.ident.to_string());
                add(before, name.ident.to_string());
            }
            UseTree::Rename(rename) => {
                before.push(rename.ident.to_string());
                add(before, rename.rename.to_string());
            }
            _ => add(before, "*".to_owned()),
        }
    }
}

fn is_for_tests(attributes: &[Attribute]) -> bool {
    let is_test = |attribute: &&Attribute| attribute.parse_args::<syn::Path>().is_ok_and(|of| of.is_ident("test"));
    attributes.iter().filter(|attribute| attribute.path().is_ident("cfg")).any(|attribute| is_test(&attribute))
}

impl<'ast> Visit<'ast> for Names {
    fn visit_item_mod(&mut self, item: &'ast ItemMod) {
        if is_for_tests(&item.attrs) {
            self.tests.push(item.ident.to_string());
            return;
        }
        self.depth += 1;
        visit::visit_item_mod(self, item);
        self.depth -= 1;
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        if !is_for_tests(&item.attrs) {
            self.import(&item.tree, Segments::new());
        }
    }

    fn visit_visibility(&mut self, _: &'ast Visibility) {}

    fn visit_path(&mut self, path: &'ast syn::Path) {
        if path.segments.len() > 1 && path.leading_colon.is_none() {
            let segments = path.segments.iter().map(|segment| segment.ident.to_string()).collect();
            let segments = self.outside(segments);
            self.paths.push(segments);
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, item: &'ast Macro) {
        self.arguments(item.parse_body_with(Punctuated::parse_terminated));
        visit::visit_macro(self, item);
    }

    fn visit_meta_list(&mut self, item: &'ast MetaList) {
        self.arguments(item.parse_args_with(Punctuated::parse_terminated));
        visit::visit_meta_list(self, item);
    }
}

/// The files of a crate by their modules.
struct Crate(BTreeMap<Segments, Names>);

impl Crate {
    /// Parses sources by their path below `src`.
    fn of(sources: &[(String, String)]) -> Self {
        let module = |path: &str| -> Segments {
            let path = path.trim_end_matches(".rs").trim_end_matches("/mod");
            path.split('/').filter(|segment| !["lib", "mod"].contains(segment)).map(str::to_owned).collect()
        };
        let mut files: BTreeMap<Segments, Names> =
            sources.iter().map(|(path, text)| (module(path), Names::of(text))).collect();
        let tests: Vec<Segments> = files
            .iter()
            .flat_map(|(module, names)| {
                names.tests.iter().map(|name| [&module[..], std::slice::from_ref(name)].concat())
            })
            .collect();
        files.retain(|module, _| !tests.iter().any(|test| module.starts_with(test)));
        Self(files)
    }

    /// Returns the module in whose file the last segment is defined, seen from a module; `None` if it is in another crate.
    fn defining(&self, from: &[String], segments: &[String], depth: usize) -> Option<Segments> {
        let (first, rest) = segments.split_first()?;
        let (mut module, mut rest) = match first.as_str() {
            "crate" => (Segments::new(), rest),
            "self" => (from.to_vec(), rest),
            "super" => (from.split_last()?.1.to_vec(), rest),
            name if self.0.contains_key(&[from, &[name.to_owned()]].concat()) => (from.to_vec(), segments),
            _ => return None,
        };
        while let Some((next, behind)) = rest.split_first() {
            let inner = [&module[..], std::slice::from_ref(next)].concat();
            if next == "super" {
                module.pop();
            } else if self.0.contains_key(&inner) {
                module = inner;
            } else {
                let exported = self.0.get(&module)?.imports.iter().find(|(_, name)| name == next);
                let again = exported.filter(|(path, _)| depth < 8 && path[..] != *rest);
                return again.and_then(|(path, _)| self.defining(&module, path, depth + 1)).or(Some(module));
            }
            rest = behind;
        }
        self.0.contains_key(&module).then_some(module)
    }

    /// Returns the modules that a module uses, without those inside it.
    fn used(&self, module: &Segments, names: &Names) -> BTreeSet<Segments> {
        let imports = names.imports.iter().map(|(path, _)| path.clone());
        let paths = names.paths.iter().map(|path| {
            let import = names.imports.iter().find(|(_, name)| *name == path[0]);
            import.map_or_else(|| path.clone(), |(import, _)| [&import[..], &path[1..]].concat())
        });
        let used = imports.chain(paths).filter_map(|path| self.defining(module, &path, 0));
        used.filter(|other| !other.starts_with(module)).collect()
    }

    /// Returns the imports, as `one → other`, of which circles consist.
    fn circles(&self) -> Vec<String> {
        let modules: Vec<&Segments> = self.0.keys().collect();
        let places = |used: BTreeSet<Segments>| used.iter().filter_map(|of| modules.binary_search(&of).ok()).collect();
        let graph: Vec<Vec<usize>> = self.0.iter().map(|(module, names)| places(self.used(module, names))).collect();
        let leads_to = |from: usize, to: usize| {
            let (mut seen, mut next) = (vec![false; modules.len()], vec![from]);
            while let Some(module) = next.pop() {
                if !std::mem::replace(&mut seen[module], true) {
                    next.extend(&graph[module]);
                }
            }
            seen[to]
        };
        let arrows = graph.iter().enumerate().flat_map(|(module, used)| used.iter().map(move |other| (module, *other)));
        let arrows = arrows.filter(|(module, other)| leads_to(*other, *module));
        arrows.map(|(module, other)| format!("{} → {}", modules[module].join("/"), modules[other].join("/"))).collect()
    }
}

/// Returns the sources below a folder by their paths in it.
fn sources(folder: &Path) -> Vec<(String, String)> {
    let mut folders = vec![folder.to_owned()];
    let mut found: Vec<PathBuf> = Vec::new();
    while let Some(next) = folders.pop() {
        for path in std::fs::read_dir(next).unwrap().map(|entry| entry.unwrap().path()) {
            let is_source =
                path.extension().is_some_and(|extension| extension == "rs") && !path.ends_with("src/main.rs");
            if path.is_dir() {
                folders.push(path);
            } else if is_source {
                found.push(path);
            }
        }
    }
    let name = |path: &Path| path.strip_prefix(folder).unwrap().display().to_string();
    found.iter().map(|path| (name(path), std::fs::read_to_string(path).unwrap())).collect()
}

#[test]
fn files_import_each_other_in_no_circle() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut crates = vec![root.to_owned()];
    crates.extend(std::fs::read_dir(root.join("crates")).unwrap().map(|entry| entry.unwrap().path()));
    let mut wrong = Vec::new();
    for folder in crates {
        let files = Crate::of(&sources(&folder.join("src")));
        assert!(!files.0.is_empty(), "{}", folder.display());
        let name = folder.file_name().unwrap().to_string_lossy().into_owned();
        wrong.extend(files.circles().into_iter().map(|arrow| format!("{name}: {arrow}")));
    }
    assert!(wrong.is_empty(), "files that import each other in circles:\n{}", wrong.join("\n"));
}

#[test]
fn a_circle_is_found_through_exports_imports_and_macros() {
    let circles = |files: &[(&str, &str)]| {
        let files: Vec<_> = files.iter().map(|(path, text)| ((*path).to_owned(), (*text).to_owned())).collect();
        Crate::of(&files).circles()
    };
    let lib = ("lib.rs", "mod a; mod b; pub use b::{B as C};");
    for a in [
        "use super::b::B;",
        "use crate::C;",
        "use super::b; type A = b::B;",
        "fn f() { assert!(super::b::f(1, 2)) }",
        "#[error(\"{}\", super::b::f())] struct A;",
    ] {
        let both = [lib, ("a.rs", a), ("b.rs", "pub struct B; mod c { fn g() { super::super::a::f() } }")];
        assert_eq!(circles(&both), ["a → b", "b → a"], "{a}");
    }
    // One direction, tests, and a module with the modules inside it are no circles.
    for b in [
        "pub struct B;",
        "#[cfg(test)]\nmod tests { use crate::a::A; }",
        "#[cfg(test)]\nuse crate::a::A;",
        "use std::a;",
    ] {
        assert!(circles(&[lib, ("a.rs", "use super::b::B;"), ("b.rs", b)]).is_empty(), "{b}");
    }
    let inside =
        [("lib.rs", "mod a;"), ("a/mod.rs", "mod b; use b::B;"), ("a/b.rs", "use super::A; use crate::a::A2;")];
    assert!(circles(&inside).is_empty());
}
