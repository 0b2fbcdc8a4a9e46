//! The templates: files of `examples`, and what changes in them when they are copied.

use super::{Language, ProjectRole};

/// A project.
pub(super) struct Template {
    pub lang: Language,
    pub role: ProjectRole,
    pub files: &'static [File],
    /// Whether it is built with crates, or a library, of the source tree.
    pub needs_source: bool,
}

/// A file of a project.
pub(super) struct File {
    /// Its path in the project.
    pub path: &'static str,
    text: &'static str,
    /// What is replaced, and by what; `@NAME@` and `@SOURCE@` in the latter are those of the project.
    changes: &'static [(&'static str, &'static str)],
}

impl File {
    /// Its text in a project of that name, which finds the source tree at the path `source`.
    pub(super) fn text(&self, name: &str, source: &str) -> String {
        let changed =
            self.changes.iter().fold(self.text.to_owned(), |text, (from, to)| text.replace(from, to));
        changed.replace("@NAME@", name).replace("@SOURCE@", source)
    }

    pub(super) fn is_program(&self) -> bool {
        self.path.ends_with(".sh")
    }
}

impl Template {
    /// Whether the program uses a crate of that name.
    pub(super) fn uses_crate(&self, name: &str) -> bool {
        let manifest = self.files.iter().find(|file| file.path == "Cargo.toml");
        let crates = manifest.and_then(|file| file.text.split("[dependencies]\n").nth(1)).unwrap_or_default();
        let mut names = crates
            .lines()
            .take_while(|line| !line.starts_with('['))
            .filter_map(|line| line.split_once(" = "));
        names.any(|(used, _)| used == name.replace('_', "-"))
    }

    /// What a user types next.
    pub(super) fn next_steps(&self, name: &str) -> String {
        let build = match self.lang {
            Language::Rust => format!("cargo build --release --manifest-path {name}/Cargo.toml"),
            Language::C => format!("make -C {name}"),
            Language::Python => format!("{name}/setup.sh"),
        };
        let role = super::value(&self.role);
        let program = match (self.lang, self.role) {
            (Language::Rust, _) => format!("{name}/target/release/{name}"),
            (Language::C, _) => format!("{name}/{role}"),
            (Language::Python, ProjectRole::Robot) => format!("{name}/.venv/bin/python {name}/robot.py"),
            (Language::Python, _) => format!("{name}/.venv/bin/python {name}/pure_pursuit.py"),
        };
        let check = match self.role {
            ProjectRole::Companion => String::new(),
            _ => format!("  scanloop conformance {role} -- {program}\n"),
        };
        format!("{name} is made. Next:\n  {build}\n{check}  scanloop run free --system {name}/system.toml\n")
    }
}

/// The template of a language and role.
pub(super) fn find(lang: Language, role: ProjectRole) -> Option<&'static Template> {
    TEMPLATES.iter().find(|template| template.lang == lang && template.role == role)
}

macro_rules! file {
    ($path:literal, $example:literal $(, $from:literal => $to:literal)*) => {
        File {
            path: $path,
            text: include_str!(concat!("../../../../examples/", $example)),
            changes: &[$(($from, $to)),*],
        }
    };
}

/// What each program in Python imports.
macro_rules! python_files {
    ($($file:expr),* $(,)?) => {
        &[
            $($file,)*
            file!("scanloop.py", "python/scanloop.py"),
            file!("scanloop_types.py", "python/scanloop_types.py"),
            file!("requirements.txt", "python/requirements.txt",
                "casadi==3.8.2\nmcap==1.6.0\nrosbags==0.11.9\n" => ""),
            file!("setup.sh", "python/setup.sh",
                "the Python examples in target/python" => "@NAME@ in .venv",
                "about 150 MB" => "about 15 MB",
                "../../target/python" => ".venv",
                "import casadi, iceoryx2, mcap, rosbags" => "import iceoryx2"),
        ]
    };
}

/// All templates.
pub(super) const TEMPLATES: &[Template] = &[
    Template {
        lang: Language::Rust,
        role: ProjectRole::Controller,
        needs_source: true,
        files: &[
            file!("Cargo.toml", "template-controller/Cargo.toml",
                "# A controller of your own. Copy this folder out of the repository, and change the paths to where your clone of Scanloop\n# is (docs/tutorial.md shows the commands).\n" => "# A controller of your own, made by `scanloop new`.\n",
                "my-controller" => "@NAME@", "\"../../" => "\"@SOURCE@/"),
            file!(".gitignore", "template-controller/.gitignore"),
            file!("system.toml", "template-controller/system.toml", "#:schema ../../docs/schema/system.json" => "#:schema @SOURCE@/docs/schema/system.json", "my-controller" => "@NAME@"),
            file!("src/main.rs", "template-controller/src/main.rs"),
            file!("src/controller.rs", "template-controller/src/controller.rs"),
            file!("src/planner.rs", "template-controller/src/planner.rs"),
            file!("src/settings.rs", "template-controller/src/settings.rs"),
            file!("src/verify.rs", "template-controller/src/verify.rs"),
        ],
    },
    Template {
        lang: Language::Rust,
        role: ProjectRole::Robot,
        needs_source: true,
        files: &[
            file!("Cargo.toml", "template-robot/rust/Cargo.toml",
                "# The driver of a robot of your own. Copy this folder out of the repository, and change the paths to where your clone of\n# Scanloop is.\n" => "# The driver of a robot of your own, made by `scanloop new`.\n",
                "my-robot" => "@NAME@", "\"../../../" => "\"@SOURCE@/"),
            file!(".gitignore", "template-controller/.gitignore"),
            file!("system.toml", "template-robot/system.toml", "#:schema ../../docs/schema/system.json" => "#:schema @SOURCE@/docs/schema/system.json",
                "examples/template-robot/rust/target/release/my-robot" => "@NAME@/target/release/@NAME@",
                "# command = [\"examples/template-robot/c/robot\"]\n# command = [\"target/python/bin/python\", \"examples/template-robot/python/robot.py\"]\n" => "",
                "From the root of the repository:" => "In the folder that contains @NAME@:",
                "examples/template-robot/system.toml" => "@NAME@/system.toml"),
            file!("src/main.rs", "template-robot/rust/src/main.rs"),
            file!("src/device.rs", "template-robot/rust/src/device.rs"),
            file!("src/driver.rs", "template-robot/rust/src/driver.rs"),
            file!("src/odometry.rs", "template-robot/rust/src/odometry.rs"),
        ],
    },
    Template {
        lang: Language::Rust,
        role: ProjectRole::Estimator,
        needs_source: true,
        files: &[
            file!("Cargo.toml", "rust/dead-reckoning/Cargo.toml",
                "dead-reckoning" => "@NAME@",
                "version.workspace = true\nedition.workspace = true\nrust-version.workspace = true\nlicense.workspace = true\npublish.workspace = true\n" => "version = \"0.1.0\"\nedition = \"2024\"\npublish = false\n",
                "runtime = { workspace = true }" => "runtime = { path = \"@SOURCE@/services/runtime\" }",
                "shared-types = { workspace = true }" => "shared-types = { path = \"@SOURCE@/shared-types\" }",
                "[lints]\nworkspace = true\n" => "# A workspace of its own: `cargo build` in this folder does not look for one further up.\n[workspace]\n"),
            file!(".gitignore", "template-controller/.gitignore"),
            file!("system.toml", "rust/dead-reckoning/system.toml", "#:schema ../../../docs/schema/system.json" => "#:schema @SOURCE@/docs/schema/system.json",
                "#   cargo build --release -p dead-reckoning\n" => "#   cargo build --release --manifest-path @NAME@/Cargo.toml\n",
                "cargo run --release -- run" => "scanloop run",
                "examples/rust/dead-reckoning/system.toml" => "@NAME@/system.toml",
                "From the root of the repository:" => "In the folder that contains @NAME@:",
                "target/release/dead-reckoning" => "@NAME@/target/release/@NAME@"),
            file!("src/main.rs", "rust/dead-reckoning/src/main.rs"),
        ],
    },
    Template {
        lang: Language::Python,
        role: ProjectRole::Controller,
        needs_source: false,
        files: python_files![
            file!("pure_pursuit.py", "python/pure_pursuit.py"),
            file!("system.toml", "python/system.toml", "#:schema ../../docs/schema/system.json\n" => "",
                "examples/python/setup.sh" => "@NAME@/setup.sh",
                "cargo run --release -- run" => "scanloop run",
                "examples/python/system.toml" => "@NAME@/system.toml",
                "From the root of the repository:" => "In the folder that contains @NAME@:",
                "target/python/bin/python" => "@NAME@/.venv/bin/python",
                "examples/python/" => "@NAME@/"),
        ],
    },
    Template {
        lang: Language::Python,
        role: ProjectRole::Robot,
        needs_source: false,
        files: python_files![
            file!("robot.py", "template-robot/python/robot.py",
                "\n\nIn a copy, take scanloop.py and scanloop_types.py of examples/python with you.\n" => "\n",
                "from pathlib import Path\n" => "",
                "\nsys.path.insert(0, str(Path(__file__).resolve().parents[2] / \"python\"))\n" => ""),
            file!("device.py", "template-robot/python/device.py"),
            file!("system.toml", "template-robot/system.toml", "#:schema ../../docs/schema/system.json\n" => "",
                "command = [\"examples/template-robot/rust/target/release/my-robot\"]\n# command = [\"examples/template-robot/c/robot\"]\n# command" => "command",
                "target/python/bin/python" => "@NAME@/.venv/bin/python",
                "examples/template-robot/python/" => "@NAME@/",
                "From the root of the repository:" => "In the folder that contains @NAME@:",
                "examples/template-robot/system.toml" => "@NAME@/system.toml"),
        ],
    },
    Template {
        lang: Language::Python,
        role: ProjectRole::Companion,
        needs_source: false,
        files: python_files![
            file!("advisor.py", "python/speed-limit/advisor.py"),
            file!("controller.py", "python/speed-limit/controller.py"),
            file!("limit.py", "python/speed-limit/limit.py"),
            file!("limit.toml", "python/speed-limit/limit.toml"),
            file!("own_topics.py", "python/own_topics.py"),
            file!("pure_pursuit.py", "python/pure_pursuit.py"),
            file!("system.toml", "python/speed-limit/system.toml", "#:schema ../../../docs/schema/system.json\n" => "",
                "examples/python/setup.sh" => "@NAME@/setup.sh",
                "cargo run --release -- run" => "scanloop run",
                "examples/python/speed-limit/" => "@NAME@/",
                "From the root of\n# the repository:" => "In the folder that\n# contains @NAME@:",
                "target/python/bin/python" => "@NAME@/.venv/bin/python"),
        ],
    },
    Template {
        lang: Language::C,
        role: ProjectRole::Obstacles,
        needs_source: true,
        files: &[
            file!("obstacles.c", "c/obstacles.c"),
            file!("health.h", "c/health.h"),
            file!("scanloop_types.h", "c/scanloop_types.h"),
            file!(".gitignore", "c/.gitignore"),
            file!("Makefile", "c/Makefile", "ROOT := ../.." => "ROOT := @SOURCE@"),
            file!("system.toml", "c/system.toml", "#:schema ../../docs/schema/system.json" => "#:schema @SOURCE@/docs/schema/system.json",
                "cargo run --release -- run" => "scanloop run",
                "From the root of the repository:" => "In the folder that contains @NAME@:",
                "examples/c" => "@NAME@"),
        ],
    },
    Template {
        lang: Language::C,
        role: ProjectRole::Robot,
        needs_source: true,
        files: &[
            file!("robot.c", "template-robot/c/robot.c"),
            file!("device.h", "template-robot/c/device.h"),
            file!("Makefile", "template-robot/c/Makefile",
                " In a copy of this folder set\n# ROOT to where your clone of Scanloop is." => "",
                "ROOT ?= ../../.." => "ROOT ?= @SOURCE@"),
            file!("system.toml", "template-robot/system.toml", "#:schema ../../docs/schema/system.json" => "#:schema @SOURCE@/docs/schema/system.json",
                "command = [\"examples/template-robot/rust/target/release/my-robot\"]\n# command = [\"examples/template-robot/c/robot\"]\n# command = [\"target/python/bin/python\", \"examples/template-robot/python/robot.py\"]\n" => "command = [\"@NAME@/robot\"]\n",
                "From the root of the repository:" => "In the folder that contains @NAME@:",
                "examples/template-robot/system.toml" => "@NAME@/system.toml"),
        ],
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_change_finds_its_place_and_nothing_of_the_examples_is_left() {
        for template in TEMPLATES {
            for file in template.files {
                let mut text = file.text.to_owned();
                for (from, to) in file.changes {
                    assert!(text.contains(from), "{}: {from}", file.path);
                    text = text.replace(from, to);
                }
                let made = file.text("mine", "../scanloop");
                let is_left = |what: &str| made.contains(what) && !file.path.ends_with("Makefile");
                for what in ["@", "examples/", "my-controller", "my-robot", "dead-reckoning"] {
                    // Decorators of Python.
                    let is_allowed = what == "@" && (file.path.ends_with(".py") || file.path == "setup.sh");
                    assert!(is_allowed || !is_left(what), "{} has {what}", file.path);
                }
            }
        }
    }

    #[test]
    fn a_pair_has_one_template_with_a_system_file() {
        for template in TEMPLATES {
            let same =
                TEMPLATES.iter().filter(|other| other.lang == template.lang && other.role == template.role);
            assert_eq!(same.count(), 1);
            assert!(template.files.iter().any(|file| file.path == "system.toml"));
        }
        assert!(find(Language::C, ProjectRole::Companion).is_none());
        let controller = find(Language::Rust, ProjectRole::Controller).unwrap();
        assert!(
            controller.uses_crate("serde")
                && !["my-serde", "version"].map(|name| controller.uses_crate(name)).contains(&true)
        );
        assert!(
            controller.next_steps("mine").contains("conformance controller -- mine/target/release/mine\n")
        );
    }
}
