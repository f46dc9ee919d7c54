//! The invariants of the source tree: each a check over its files, and each shown to tell of a planted violation.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;
use toml::{Table, Value};

mod planted;

#[test]
fn the_tree_keeps_its_invariants() {
    let violations = check(&Tree::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("..")));
    let told: Vec<String> = violations.iter().map(ToString::to_string).collect();
    assert!(told.is_empty(), "\n{}\n", told.join("\n"));
}

/// This file and what is planted name what they forbid.
const HERE: &str = "tests/architecture";

/// Everything that is wrong with a tree.
fn check(tree: &Tree) -> Vec<Violation> {
    let checks = [
        top_level_is_as_agreed,
        files_are_small,
        rust_files_have_a_role,
        packages_are_named_as_their_folders,
        dependencies_stand_in_one_place,
        only_the_shell_depends_on_iceoryx2,
        dependencies_are_used_for_a_reason,
        code_map_is_complete,
        computing_code_is_pure,
        mains_are_short,
        unwanted_words_are_absent,
        unsafe_code_has_its_reason,
        functions_are_kept_short_by_clippy,
    ];
    let mut violations: Vec<Violation> = checks.iter().flat_map(|check| check(tree)).collect();
    violations.sort();
    violations
}

fn top_level_is_as_agreed(tree: &Tree) -> Vec<Violation> {
    const AGREED: &str = "Cargo.toml Cargo.lock README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE clippy.toml deny.toml \
                          rustfmt.toml rust-toolchain.toml services shared launcher bench tests";
    let is_agreed = |entry: &str| entry.starts_with('.') || AGREED.split(' ').any(|agreed| agreed == entry);
    let strays = tree
        .0
        .keys()
        .filter(|path| !is_agreed(path.split('/').next().unwrap_or(path)));
    strays
        .map(|path| violation(path, 1, "stands at the top: move it into the folder of its role"))
        .collect()
}

fn files_are_small(tree: &Tree) -> Vec<Violation> {
    const BYTES_MAX: usize = 1 << 20;
    let large = tree.0.iter().filter(|(_, bytes)| bytes.len() > BYTES_MAX);
    large
        .map(|(path, _)| violation(path, 1, "is larger than 1 MiB: shorten it, or make it in the test"))
        .collect()
}

fn rust_files_have_a_role(tree: &Tree) -> Vec<Violation> {
    const ODDS_AND_ENDS: [&str; 7] = ["utils", "util", "common", "helpers", "helper", "core", "misc"];
    let mut violations = Vec::new();
    for path in tree.rust_files() {
        if path
            .trim_end_matches(".rs")
            .split('/')
            .any(|part| ODDS_AND_ENDS.contains(&part))
        {
            violations.push(violation(path, 1, "has a name that says nothing: name what it holds"));
        }
        // That of the tests only looks for optional parts.
        if path.ends_with("/build.rs") && path != "tests/build.rs" {
            violations.push(violation(
                path,
                1,
                "nothing is generated here: write it out, and compare it in a test",
            ));
        }
    }
    violations
}

fn packages_are_named_as_their_folders(tree: &Tree) -> Vec<Violation> {
    let mut violations = Vec::new();
    for (path, manifest) in tree.crates() {
        let mut tell = |key: &str, text: String| violations.push(violation(path, tree.line_of(path, key), text));
        let folder = folder_of(path).rsplit('/').next().unwrap_or_default();
        let text_at = |key: &str| manifest["package"].get(key).and_then(Value::as_str).unwrap_or_default();
        if text_at("name") != folder {
            tell("name", format!("name the package `{folder}`, as its folder"));
        }
        if !text_at("description").ends_with('.') {
            tell("description", "say in one sentence what the crate is for".into());
        }
        let binary = if path.starts_with("services/") {
            format!("terrasense-{folder}")
        } else {
            "terrasense".into()
        };
        let product = path.starts_with("services/") || folder == "launcher";
        for found in manifest
            .get("bin")
            .and_then(Value::as_array)
            .into_iter()
            .flatten()
            .filter(|_| product)
        {
            if found.get("name").and_then(Value::as_str) != Some(&binary) {
                tell("[[bin]]", format!("name the binary `{binary}`"));
            }
        }
        if manifest.get("lints").and_then(|lints| lints.get("workspace")) != Some(&Value::Boolean(true)) {
            tell("[lints]", "take the workspace's lints: [lints] workspace = true".into());
        }
        if manifest.contains_key("features") {
            tell(
                "[features]",
                "has a feature: behaviour is chosen in the system file alone".into(),
            );
        }
    }
    violations
}

fn dependencies_stand_in_one_place(tree: &Tree) -> Vec<Violation> {
    let elsewhere = tree
        .dependencies()
        .filter(|found| found.value.get("workspace") != Some(&Value::Boolean(true)));
    let text = "write `.workspace = true`, and the version into the root Cargo.toml";
    elsewhere
        .map(|found| violation(found.manifest, tree.line_of(found.manifest, &found.name), text))
        .collect()
}

fn only_the_shell_depends_on_iceoryx2(tree: &Tree) -> Vec<Violation> {
    let allowed = |found: &Dependency| match (found.name.as_str(), folder_of(found.manifest)) {
        ("iceoryx2", "shared/shell") => true,
        // To be compared with.
        ("iceoryx2", "bench") => found.kind == "dev-dependencies",
        ("iceoryx2-bb-derive-macros" | "iceoryx2-bb-elementary-traits", folder) => folder == "shared/messages",
        (name, _) => !name.starts_with("iceoryx2"),
    };
    let outside = tree.dependencies().filter(|found| !allowed(found));
    let text = "only shared/shell depends on iceoryx2: open wires through the shell";
    let mut violations: Vec<Violation> = outside
        .map(|found| violation(found.manifest, tree.line_of(found.manifest, &found.name), text))
        .collect();
    for (name, value) in tree
        .workspace_dependencies()
        .iter()
        .filter(|(name, _)| name.starts_with("iceoryx2"))
    {
        let version = value.get("version").unwrap_or(value).as_str();
        if version != Some("=0.10.0") {
            let text = "pin it to \"=0.10.0\": processes of different versions refuse each other";
            violations.push(violation("Cargo.toml", tree.line_of("Cargo.toml", name), text));
        }
    }
    violations
}

fn dependencies_are_used_for_a_reason(tree: &Tree) -> Vec<Violation> {
    const REASON_WORDS_MIN: usize = 3;
    const UNWANTED: [&str; 7] = ["tokio", "async-std", "smol", "futures", "uom", "num-traits", "bindgen"];
    let readme = tree.text("README.md");
    let mut violations = Vec::new();
    for (name, value) in tree.workspace_dependencies() {
        let line = tree.line_of("Cargo.toml", &name);
        let mut tell = |text: &str| violations.push(violation("Cargo.toml", line, format!("`{name}`: {text}")));
        if UNWANTED.contains(&name.as_str()) {
            tell("no async runtime, units, float generics or code generator: remove it");
        }
        if value.get("path").is_some() {
            continue;
        }
        if !tree.dependencies().any(|found| found.name == name) {
            tell("no crate uses it: delete the line");
        }
        let is_word = |word: &&str| word.starts_with(char::is_alphabetic);
        let reasoned = |line: &str| line.split_whitespace().filter(is_word).count() >= REASON_WORDS_MIN;
        if !readme
            .lines()
            .any(|line| line.contains(&format!("`{name}`")) && reasoned(line))
        {
            tell("the README does not say what it is for: add a line with its name in backticks and the reason");
        }
    }
    violations
}

fn code_map_is_complete(tree: &Tree) -> Vec<Violation> {
    let readme = tree.text("README.md");
    let unknown = tree.crates().filter(|(path, _)| !readme.contains(folder_of(path)));
    unknown
        .map(|(path, _)| violation("README.md", 1, format!("add {} to the code map", folder_of(path))))
        .collect()
}

fn computing_code_is_pure(tree: &Tree) -> Vec<Violation> {
    const IMPURE: &str = "std::fs std::time std::env std::thread std::process std::net stdin stdout stderr print! println! \
                          eprint! eprintln! HashMap HashSet RandomState iceoryx2 rustix";
    let mut violations = Vec::new();
    for path in tree.rust_files() {
        let is_lib = path.starts_with("services/") && path.contains("/src/") && !path.ends_with("/main.rs");
        let elsewhere = [
            "shared/simulation/src/",
            "launcher/src/policy.rs",
            "launcher/src/system.rs",
        ];
        if !is_lib && !elsewhere.iter().any(|pure| path.starts_with(pure)) {
            continue;
        }
        let text = tree.text(path);
        let tested = text.find("#[cfg(test)]").unwrap_or(text.len());
        for (line, code) in code_lines(&text[..tested]) {
            if code.contains("std::{") {
                violations.push(violation(
                    path,
                    line,
                    "write a `use` for each module, so that each is seen",
                ));
            }
            let wires = is_lib.then_some("shell");
            if let Some(word) = IMPURE.split_whitespace().chain(wires).find(|word| names(code, word)) {
                let text = format!("names `{word}`: take time, files and randomness as arguments, wire in main.rs");
                violations.push(violation(path, line, text));
            }
        }
    }
    violations
}

fn mains_are_short(tree: &Tree) -> Vec<Violation> {
    const LINES_MAX: usize = 39;
    let is_main = |path: &&str| path.starts_with("services/") && path.ends_with("/src/main.rs");
    let mut violations = Vec::new();
    for path in tree.rust_files().filter(is_main) {
        let text = tree.text(path);
        if text.lines().count() > LINES_MAX {
            violations.push(violation(
                path,
                LINES_MAX + 1,
                "move what it computes into the lib: a main only wires",
            ));
        }
        if !text.contains("shell::main(") {
            violations.push(violation(
                path,
                1,
                "is run by `shell::main`: a service has no life of its own",
            ));
        }
    }
    violations
}

fn unwanted_words_are_absent(tree: &Tree) -> Vec<Violation> {
    const UNWANTED: [(&str, &str); 8] = [
        ("macro_rules!", "write it out, or as a function"),
        ("async", "no async: a stage waits on one wire, in the shell"),
        ("await", "no async: a stage waits on one wire, in the shell"),
        ("allow(dead_code)", "delete the dead code"),
        ("allow(unused)", "delete what is not used"),
        ("allow(clippy::too_many_lines)", "split the function"),
        ("env::var", "configuration stands in the system file alone"),
        ("env::var_os", "configuration stands in the system file alone"),
    ];
    let mut violations = Vec::new();
    for path in tree.rust_files().filter(|path| !path.starts_with(HERE)) {
        // Where programs are is the operating system's to say.
        for (line, code) in code_lines(&tree.text(path).replace("env::var_os(\"PATH\")", "")) {
            let found = UNWANTED.iter().filter(|(word, _)| names(code, word));
            violations.extend(found.map(|(word, remedy)| violation(path, line, format!("names `{word}`: {remedy}"))));
        }
    }
    violations
}

fn unsafe_code_has_its_reason(tree: &Tree) -> Vec<Violation> {
    /// The comment, and an attribute between it and the code.
    const LINES_ABOVE_MAX: usize = 5;
    let mut violations = Vec::new();
    for path in tree.rust_files().filter(|path| !path.starts_with(HERE)) {
        let text = tree.text(path);
        let lines: Vec<&str> = text.lines().collect();
        for (line, _) in code_lines(&text).filter(|(_, code)| names(code, "unsafe")) {
            if !path.starts_with("shared/shell/") {
                violations.push(violation(
                    path,
                    line,
                    "unsafe code stands in shared/shell alone, behind safe words",
                ));
            }
            let above = &lines[line.saturating_sub(1 + LINES_ABOVE_MAX)..line];
            if !above.iter().any(|line| line.contains("// SAFETY: ")) {
                violations.push(violation(path, line, "say above it why it is sound: `// SAFETY: …`"));
            }
        }
    }
    violations
}

fn functions_are_kept_short_by_clippy(tree: &Tree) -> Vec<Violation> {
    let mut violations = Vec::new();
    if !tree
        .text("clippy.toml")
        .lines()
        .any(|line| line == "too-many-lines-threshold = 70")
    {
        violations.push(violation("clippy.toml", 1, "set too-many-lines-threshold = 70"));
    }
    if tree.line_of("Cargo.toml", "too_many_lines = ") == 0 {
        violations.push(violation(
            "Cargo.toml",
            1,
            "warn of too_many_lines in [workspace.lints.clippy]",
        ));
    }
    violations
}

/// What is wrong, where, and what to do instead.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Violation {
    path: String,
    line: usize,
    text: String,
}

fn violation(path: &str, line: usize, text: impl Into<String>) -> Violation {
    Violation {
        path: path.into(),
        line: line.max(1),
        text: text.into(),
    }
}

impl fmt::Display for Violation {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}:{}: {}", self.path, self.line, self.text)
    }
}

/// The files of a source tree, by their paths from its root.
#[derive(Clone, Default)]
struct Tree(BTreeMap<String, Vec<u8>>);

/// A dependency of a crate.
struct Dependency<'tree> {
    manifest: &'tree str,
    kind: &'static str,
    name: String,
    value: Value,
}

impl Tree {
    fn read(root: &Path) -> Self {
        let mut tree = Self::default();
        tree.add(root, "");
        assert!(!tree.0.is_empty(), "no source tree at {}", root.display());
        tree
    }

    /// Adds a folder's files, but for what is built and for what tools keep in hidden folders.
    fn add(&mut self, folder: &Path, prefix: &str) {
        for entry in std::fs::read_dir(folder).expect("a folder that can be read").flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let (path, place) = (format!("{prefix}{name}"), entry.path());
            let skipped = path == "target" || name == "__pycache__" || (name.starts_with('.') && name != ".github");
            if place.is_dir() && !skipped {
                self.add(&place, &format!("{path}/"));
            } else if let (false, Ok(bytes)) = (skipped, std::fs::read(place)) {
                self.0.insert(path, bytes);
            }
        }
    }

    fn text(&self, path: &str) -> String {
        self.0
            .get(path)
            .map(|bytes| String::from_utf8_lossy(bytes).into_owned())
            .unwrap_or_default()
    }

    fn rust_files(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str).filter(|path| path.ends_with(".rs"))
    }

    fn manifest(&self, path: &str) -> Table {
        self.text(path)
            .parse()
            .unwrap_or_else(|error| panic!("{path}: {error}"))
    }

    fn crates(&self) -> impl Iterator<Item = (&str, Table)> {
        let manifests = self.0.keys().filter(|path| path.ends_with("/Cargo.toml"));
        manifests.map(|path| (path.as_str(), self.manifest(path)))
    }

    fn dependencies(&self) -> impl Iterator<Item = Dependency<'_>> {
        self.crates().flat_map(|(manifest, table)| {
            let kinds = ["dependencies", "dev-dependencies", "build-dependencies"];
            let tables = kinds
                .into_iter()
                .filter_map(move |kind| Some((kind, table.get(kind)?.as_table()?.clone())));
            tables.flat_map(move |(kind, table)| {
                table.into_iter().map(move |(name, value)| Dependency {
                    manifest,
                    kind,
                    name,
                    value,
                })
            })
        })
    }

    fn workspace_dependencies(&self) -> Table {
        let workspace = self.manifest("Cargo.toml").remove("workspace");
        let dependencies = workspace.and_then(|table| table.get("dependencies")?.as_table().cloned());
        dependencies.unwrap_or_default()
    }

    /// The first line of a file that begins with `start`, 0 where there is none.
    fn line_of(&self, path: &str, start: &str) -> usize {
        self.text(path)
            .lines()
            .position(|line| line.starts_with(start))
            .map_or(0, |index| index + 1)
    }
}

fn folder_of(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}

/// The lines of a Rust file by number, without their comments. A text that holds `//` is cut there, too.
fn code_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines()
        .enumerate()
        .map(|(index, line)| (index + 1, line.split("//").next().unwrap_or("")))
}

/// True if `code` holds `word`, and not only as a part of a longer name.
fn names(code: &str, word: &str) -> bool {
    let is_part = |neighbour: Option<char>| neighbour.is_some_and(|c| c.is_alphanumeric() || c == '_');
    let mut places = code.match_indices(word);
    places.any(|(at, _)| !is_part(code[..at].chars().next_back()) && !is_part(code[at + word.len()..].chars().next()))
}
