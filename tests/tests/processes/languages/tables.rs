//! The tables of functions in `docs/languages.md` name what the libraries have, and nothing else.

use std::collections::BTreeSet;

use super::tools::root;

fn read(file: &str) -> String {
    std::fs::read_to_string(root().join(file)).unwrap()
}

/// What stands in backquotes in the first column of the tables of a section.
fn named(section: &str) -> BTreeSet<String> {
    let page = read("docs/languages.md");
    let (_, rest) = page.split_once(&format!("\n## {section}\n")).unwrap();
    let rows = rest.split("\n## ").next().unwrap().lines().filter_map(|line| line.strip_prefix("| `"));
    let first_columns = rows.map(|row| format!("`{}", row.split(" | ").next().unwrap()));
    first_columns
        .flat_map(|text| text.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>())
        .collect()
}

#[test]
fn each_function_of_c_has_its_place_in_the_table() {
    let header = read("services/c-library/include/scanloop.h");
    let code = header.lines().filter(|line| !line.starts_with([' ', '/', '#', '}']));
    let prototypes = code.filter_map(|line| line.split_once('(').map(|(start, _)| start));
    let functions = prototypes.map(|start| start.rsplit([' ', '*']).next().unwrap().to_owned());
    let functions: BTreeSet<String> = functions.collect();
    assert!(functions.contains("scanloop_open") && functions.len() > 15, "{functions:?}");
    assert_eq!(named("C"), functions);
}

/// Functions of the module as the page calls them: `answer()`, `process.wait()`; `Process()` makes a process, `DeviceClock()` a
/// clock.
fn functions_of_python(module: &str) -> BTreeSet<String> {
    let (mut class, mut found) = (None, BTreeSet::new());
    for line in module.lines() {
        if let Some(name) = line.strip_prefix("class ") {
            let name = name.split(['(', ':']).next().unwrap();
            class =
                ["Process", "Input", "Output"].contains(&name).then(|| format!("{}.", name.to_lowercase()));
        } else if let Some(name) = line.strip_prefix("def ") {
            found.insert(name.split('(').next().unwrap().to_owned());
            class = None;
        } else if let (Some(class), Some(name)) = (&class, line.strip_prefix("    def ")) {
            found.insert(format!("{class}{}", name.split('(').next().unwrap()));
        }
    }
    found.retain(|name| !name.starts_with('_') && !name.contains("._"));
    let made =
        ["Process", "DeviceClock"].into_iter().filter(|class| module.contains(&format!("\nclass {class}")));
    found.extend(made.map(str::to_owned));
    found
}

#[test]
fn each_function_of_python_has_its_place_in_the_table() {
    let module = read("examples/python/scanloop.py");
    let (functions, attributes): (Vec<String>, Vec<String>) =
        named("Python").into_iter().partition(|name| name.contains('('));
    let functions: BTreeSet<String> =
        functions.iter().map(|name| name.split('(').next().unwrap().to_owned()).collect();
    assert_eq!(functions, functions_of_python(&module));
    for attribute in attributes.iter().filter_map(|name| name.strip_prefix("process.")) {
        let is_set = |line: &str| line.contains(&format!("self.{attribute}")) && line.contains(" = ");
        assert!(module.lines().any(is_set), "{attribute}");
    }
}
