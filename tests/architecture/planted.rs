//! For each invariant a small tree that keeps them all, with one violation in it.

use super::{Tree, check};

/// A tree of one service and the shell, with nothing wrong in it.
fn sound() -> Tree {
    let root = "[workspace.dependencies]\nshell = { path = \"shared/shell\" }\niceoryx2 = \"=0.10.0\"\n\
                [workspace.lints.clippy]\ntoo_many_lines = \"warn\"\n";
    let readme = "Code map: services/sinkage, shared/shell.\n| `iceoryx2` | zero-copy transport between processes |\n";
    let package = |name: &str, dependency: &str| {
        format!(
            "[package]\nname = \"{name}\"\ndescription = \"A role.\"\n[dependencies]\n{dependency}.workspace = true\n\
             [lints]\nworkspace = true\n"
        )
    };
    let binary = "[[bin]]\nname = \"terrasense-sinkage\"\n";
    let main = "fn main() -> ExitCode {\n    shell::main(|shell| Ok(()))\n}\n";
    let reset = "// SAFETY: the memory is mapped.\nunsafe { reset() }\n";
    Tree::default()
        .with("Cargo.toml", root)
        .with("README.md", readme)
        .with("clippy.toml", "too-many-lines-threshold = 70\n")
        .with("services/sinkage/Cargo.toml", &(package("sinkage", "shell") + binary))
        .with("services/sinkage/src/main.rs", main)
        .with("services/sinkage/src/lib.rs", "//! Visual sinkage.\n")
        .with("shared/shell/Cargo.toml", &package("shell", "iceoryx2"))
        .with("shared/shell/src/lib.rs", reset)
}

impl Tree {
    fn with(mut self, path: &str, text: &str) -> Self {
        self.0.insert(path.into(), text.into());
        self
    }

    fn changed(self, path: &str, from: &str, to: &str) -> Self {
        let text = self.text(path);
        assert!(text.contains(from), "{path} does not hold {from}");
        self.with(path, &text.replace(from, to))
    }
}

const LIB: &str = "services/sinkage/src/lib.rs";
const MAIN: &str = "services/sinkage/src/main.rs";
const MANIFEST: &str = "services/sinkage/Cargo.toml";

/// Exactly one violation is told, and its message begins so.
fn assert_told(tree: &Tree, start: &str) {
    let told: Vec<String> = check(tree).iter().map(ToString::to_string).collect();
    assert!(
        told.len() == 1 && told[0].starts_with(start),
        "expected {start}, told: {told:#?}"
    );
}

#[test]
fn a_sound_tree_is_left_alone() {
    assert_eq!(check(&sound()).len(), 0);
}

#[test]
fn a_stray_entry_at_the_top_is_told() {
    assert_told(
        &sound().with("scripts/run.sh", ""),
        "scripts/run.sh:1: stands at the top",
    );
}

#[test]
fn a_large_file_is_told() {
    let tree = sound().with("tests/large.csv", &"0\n".repeat(600_000));
    assert_told(&tree, "tests/large.csv:1: is larger than 1 MiB");
}

#[test]
fn a_module_for_odds_and_ends_is_told() {
    assert_told(
        &sound().with("launcher/src/utils.rs", ""),
        "launcher/src/utils.rs:1: has a name that says nothing",
    );
    assert_told(
        &sound().with("shared/common/src/lib.rs", ""),
        "shared/common/src/lib.rs:1: has a name",
    );
}

#[test]
fn a_package_that_is_not_named_as_its_folder_is_told() {
    let tree = sound().changed(MANIFEST, "name = \"sinkage\"", "name = \"sink\"");
    assert_told(&tree, "services/sinkage/Cargo.toml:2: name the package `sinkage`");
}

#[test]
fn a_binary_of_another_name_is_told() {
    let tree = sound().changed(MANIFEST, "terrasense-sinkage", "sinkage-service");
    assert_told(
        &tree,
        "services/sinkage/Cargo.toml:8: name the binary `terrasense-sinkage`",
    );
}

#[test]
fn a_crate_without_a_sentence_lints_or_with_a_feature_is_told() {
    assert_told(
        &sound().changed(MANIFEST, "A role.", "TODO"),
        "services/sinkage/Cargo.toml:3: say in one sentence",
    );
    assert_told(
        &sound().changed(MANIFEST, "[lints]\nworkspace = true\n", ""),
        "services/sinkage/Cargo.toml:1: take",
    );
    let tree = sound().changed(MANIFEST, "[lints]", "[features]\nfast = []\n[lints]");
    assert_told(&tree, "services/sinkage/Cargo.toml:6: has a feature");
}

#[test]
fn a_version_outside_the_root_is_told() {
    let tree = sound().changed(MANIFEST, "shell.workspace = true", "shell = \"1\"");
    assert_told(&tree, "services/sinkage/Cargo.toml:5: write `.workspace = true`");
}

#[test]
fn a_service_that_depends_on_iceoryx2_is_told() {
    let tree = sound().changed(MANIFEST, "shell.workspace", "iceoryx2.workspace");
    assert_told(
        &tree,
        "services/sinkage/Cargo.toml:5: only shared/shell depends on iceoryx2",
    );
}

#[test]
fn only_the_bench_may_compare_itself_with_iceoryx2_and_only_where_nothing_is_built_on_it() {
    let manifest = sound()
        .text(MANIFEST)
        .replace("[dependencies]\nshell", "[dev-dependencies]\niceoryx2");
    let here = sound().with(MANIFEST, &manifest);
    assert_told(
        &here,
        "services/sinkage/Cargo.toml:5: only shared/shell depends on iceoryx2",
    );
    let manifest = manifest.replace("name = \"sinkage\"", "name = \"bench\"");
    let manifest = manifest.replace("terrasense-sinkage", "bench");
    let tree = sound().changed("README.md", "Code map: ", "Code map: bench, ");
    assert_eq!(check(&tree.clone().with("bench/Cargo.toml", &manifest)).len(), 0);
    assert_told(
        &tree.with(
            "bench/Cargo.toml",
            &manifest.replace("dev-dependencies", "dependencies"),
        ),
        "bench/Cargo.toml:5: only shared/shell depends on iceoryx2",
    );
}

#[test]
fn another_version_of_iceoryx2_is_told() {
    let tree = sound().changed("Cargo.toml", "=0.10.0", "0.10.0");
    assert_told(&tree, "Cargo.toml:3: pin it to \"=0.10.0\"");
}

#[test]
fn a_dependency_without_a_reason_or_a_user_is_told() {
    assert_told(
        &sound().changed("README.md", "zero-copy transport between processes", ""),
        "Cargo.toml:3: `iceoryx2`: the README",
    );
    let tree = sound().changed("Cargo.toml", "[workspace.lints", "csv = \"1\"\n[workspace.lints");
    let tree = tree.changed(
        "README.md",
        "| `iceoryx2`",
        "| `csv` | reads recorded tables |\n| `iceoryx2`",
    );
    assert_told(&tree, "Cargo.toml:4: `csv`: no crate uses it");
}

#[test]
fn an_async_runtime_is_told() {
    let tree = sound().changed(
        "Cargo.toml",
        "[workspace.lints",
        "tokio = { path = \"x\" }\n[workspace.lints",
    );
    assert_told(&tree, "Cargo.toml:4: `tokio`: no async runtime");
}

#[test]
fn a_crate_that_the_code_map_forgets_is_told() {
    let tree = sound().changed("README.md", "services/sinkage, ", "");
    assert_told(&tree, "README.md:1: add services/sinkage to the code map");
}

#[test]
fn a_lib_that_names_a_clock_a_file_the_environment_a_thread_a_print_or_a_wire_is_told() {
    for line in [
        "use std::time::Instant;",
        "let text = std::fs::read(path);",
        "let home = std::env::args();",
        "std::thread::yield_now();",
        "println!(\"seen\");",
        "use shell::Output;",
        "use iceoryx2::prelude::Node;",
        "use std::{fmt, fs};",
    ] {
        let tree = sound().with(LIB, &format!("//! Sinkage.\n{line}\n"));
        assert_told(&tree, "services/sinkage/src/lib.rs:2: ");
    }
}

#[test]
fn what_only_a_comment_or_a_test_names_is_left_alone() {
    let text = "// Never std::fs.\nlet eggshells = 2;\n#[cfg(test)]\nmod tests {\n    use std::fs::File;\n}\n";
    assert_eq!(check(&sound().with(LIB, text)).len(), 0);
}

#[test]
fn a_main_that_computes_is_told() {
    let long = format!("shell::main(\n{}", "compute();\n".repeat(39));
    assert_told(
        &sound().with(MAIN, &long),
        "services/sinkage/src/main.rs:40: move what it computes",
    );
    assert_told(
        &sound().with(MAIN, "fn main() {}\n"),
        "services/sinkage/src/main.rs:1: is run by `shell::main`",
    );
}

#[test]
fn a_macro_async_code_dead_code_and_an_environment_variable_are_told() {
    for line in [
        "macro_rules! repeat { () => {} }",
        "async fn receive() {}",
        "#[allow(dead_code)]",
        "#![allow(unused)]",
        "#[allow(clippy::too_many_lines)]",
        "let level = env::var(\"LEVEL\");",
        "let level = env::var_os(\"LEVEL\");",
    ] {
        let tree = sound().with("launcher/src/status.rs", &format!("\n{line}\n"));
        assert_told(&tree, "launcher/src/status.rs:2: names ");
    }
}

#[test]
fn unsafe_code_outside_the_shell_or_without_a_reason_is_told() {
    let reasoned = "// SAFETY: because.\nunsafe { x() }\n";
    assert_told(
        &sound().with("launcher/src/process.rs", reasoned),
        "launcher/src/process.rs:2: unsafe code stands",
    );
    let tree = sound().with("shared/shell/src/lib.rs", "unsafe { reset() }\n");
    assert_told(&tree, "shared/shell/src/lib.rs:1: say above it why it is sound");
}

#[test]
fn a_looser_limit_on_functions_is_told() {
    assert_told(
        &sound().changed("clippy.toml", "70", "700"),
        "clippy.toml:1: set too-many-lines-threshold",
    );
    assert_told(
        &sound().changed("Cargo.toml", "too_many_lines", "too_many"),
        "Cargo.toml:1: warn of too_many_lines",
    );
}
