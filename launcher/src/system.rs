//! From a system file to a checked graph. Pure: what it has to know of the machine is an argument.

use shell::{Error, Port, SystemFile};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// Services at the most: the rows of a `Supervision` sample.
const SERVICES_MAX: usize = messages::SERVICES_MAX;
/// Readers of one wire at the most, beside the launcher and a person who looks.
const READERS_MAX: usize = 6;
/// A cycle's deadline at the most [ms]: an hour.
const DEADLINE_MAX_MS: f64 = 3_600_000.0;

/// A system whose graph can run.
#[derive(Clone, Debug)]
pub struct System {
    /// The file it was read from.
    pub file: SystemFile,
    /// The services, writers before readers: a reader connects at once to the writers that are there.
    pub order: Vec<String>,
    /// The program of each service.
    pub programs: BTreeMap<String, PathBuf>,
    /// The wires, by name.
    pub wires: BTreeMap<String, Wire>,
}

/// A wire of the graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wire {
    /// What it carries.
    pub port: Port,
    /// The service that writes it.
    pub writer: String,
    /// The services that read it.
    pub readers: Vec<String>,
}

impl System {
    /// The wire whose samples trigger those of this one; `None` where a chain of stages begins.
    #[must_use]
    pub fn trigger_of(&self, wire: &str) -> Option<&str> {
        let about = self.wires.get(wire)?;
        let inputs = &self.file.services.get(&about.writer)?.inputs;
        inputs
            .get(about.port.trigger()?.name())
            .map(|trigger| trigger.get_ref().as_str())
    }

    /// Checks a system file. `find` tells where the program of this name is.
    ///
    /// # Errors
    /// Everything that is wrong with the graph, a line each, with the file's line and what to write instead.
    pub fn check(file: SystemFile, find: impl Fn(&str) -> Option<PathBuf>) -> Result<Self, Error> {
        check_count(&file)?;
        let mut problems = Vec::new();
        check_names(&file, &mut problems);
        check_deadline(&file, &mut problems);
        let programs = check_programs(&file, find, &mut problems);
        check_numbers(&file, &mut problems);
        let wires = check_wires(&file, &mut problems);
        let order = check_order(&file, &wires, &mut problems);
        if problems.is_empty() {
            return Ok(Self {
                file,
                order,
                programs,
                wires,
            });
        }
        Err(Error::config(
            problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"),
        ))
    }
}

/// Too many services are refused before anything else: what is wrong with each of them is not worth the time.
fn check_count(file: &SystemFile) -> Result<(), Error> {
    let count = file.services.len();
    if count <= SERVICES_MAX {
        return Ok(());
    }
    let line = file
        .services
        .keys()
        .map(|name| file.service_line(name))
        .nth(SERVICES_MAX);
    Err(Error::config(format!(
        "{}:{}: {count} services, at most {SERVICES_MAX} are possible; split the system in two, with two names",
        file.path,
        line.unwrap_or(1)
    )))
}

fn check_names(file: &SystemFile, problems: &mut Vec<Error>) {
    let name = &file.system.name;
    if !SystemFile::is_name(name.get_ref()) {
        let what = format!(
            "the system's name `{}` must be 1 to 24 characters of a-z, 0-9 and _, e.g. name = \"rover\"",
            name.get_ref()
        );
        problems.push(file.error_at(name.span(), &what));
    }
    for (name, table) in &file.services {
        if !SystemFile::is_name(name) {
            let what = format!("the service's name `{name}` must be 1 to 24 characters of a-z, 0-9 and _");
            problems.push(file.error_at(table.exec.span(), &what));
        }
    }
    if file.services.is_empty() {
        problems.push(Error::config(format!(
            "{}:1: no service; `terrasense default-system` prints an example",
            file.path
        )));
    }
}

fn check_deadline(file: &SystemFile, problems: &mut Vec<Error>) {
    let Some(deadline_ms) = &file.system.cycle_deadline_ms else {
        return;
    };
    let value = *deadline_ms.get_ref();
    if !(value > 0.0 && value <= DEADLINE_MAX_MS) {
        let what = format!("cycle_deadline_ms must be above 0 and at most {DEADLINE_MAX_MS}, is {value}");
        problems.push(file.error_at(deadline_ms.span(), &what));
    }
}

fn check_programs(
    file: &SystemFile,
    find: impl Fn(&str) -> Option<PathBuf>,
    problems: &mut Vec<Error>,
) -> BTreeMap<String, PathBuf> {
    let mut programs = BTreeMap::new();
    for (name, table) in &file.services {
        let Some(program) = table.exec.get_ref().first() else {
            problems.push(file.error_at(
                table.exec.span(),
                &format!("exec of service `{name}` is empty; write exec = [\"terrasense-{name}\"]"),
            ));
            continue;
        };
        match find(program) {
            Some(path) => drop(programs.insert(name.clone(), path)),
            None => problems.push(file.error_at(
                table.exec.span(),
                &format!(
                    "executable `{program}` of service `{name}` is neither beside `terrasense` nor on PATH; build it \
                     (`cargo build --release`) or write its full path"
                ),
            )),
        }
    }
    programs
}

fn check_numbers(file: &SystemFile, problems: &mut Vec<Error>) {
    for (name, table) in &file.services {
        let mut range = |key: &str, value: u64, span: std::ops::Range<usize>, low: u64, high: u64| {
            if !(low..=high).contains(&value) {
                let what = format!("{key} of service `{name}` must be {low} to {high}, is {value}");
                problems.push(file.error_at(span, &what));
            }
        };
        let numbers = [
            ("start_timeout_ms", Some(&table.start_timeout_ms), 1, 600_000),
            ("deadline_ms", table.deadline_ms.as_ref(), 1, 3_600_000),
            ("intensity_period_ms", Some(&table.intensity_period_ms), 1, 3_600_000),
            ("minimum_run_ms", Some(&table.minimum_run_ms), 0, 3_600_000),
        ];
        for (key, value, low, high) in numbers {
            if let Some(value) = value {
                range(key, *value.get_ref(), value.span(), low, high);
            }
        }
        range(
            "intensity",
            u64::from(*table.intensity.get_ref()),
            table.intensity.span(),
            0,
            1000,
        );
    }
}

fn check_wires(file: &SystemFile, problems: &mut Vec<Error>) -> BTreeMap<String, Wire> {
    let mut wires: BTreeMap<String, Wire> = BTreeMap::new();
    for (name, table) in &file.services {
        for (port_name, wire) in &table.outputs {
            let Some(port) = known_port(file, name, port_name, wire, problems) else {
                continue;
            };
            match wires.get(wire.get_ref()) {
                Some(other) => problems.push(file.error_at(
                    wire.span(),
                    &format!(
                        "wire {} has two writers, `{}` and `{name}`; give one of them another wire",
                        wire.get_ref(),
                        other.writer
                    ),
                )),
                None => {
                    let readers = Vec::new();
                    wires.insert(
                        wire.get_ref().clone(),
                        Wire {
                            port,
                            writer: name.clone(),
                            readers,
                        },
                    );
                }
            }
        }
    }
    for (name, table) in &file.services {
        for (port_name, wire) in &table.inputs {
            let Some(port) = known_port(file, name, port_name, wire, problems) else {
                continue;
            };
            if let Some(what) = connect(&mut wires, name, port, wire.get_ref()) {
                problems.push(file.error_at(wire.span(), &what));
            }
        }
    }
    wires
}

/// Adds a reader to a wire; says what is wrong where it cannot be.
fn connect(wires: &mut BTreeMap<String, Wire>, name: &str, port: Port, wire: &str) -> Option<String> {
    let same_kind: Vec<String> = wires
        .iter()
        .filter(|(_, other)| other.port == port)
        .map(|(wire, _)| wire.clone())
        .collect();
    let Some(found) = wires.get_mut(wire) else {
        let remedy = match same_kind.first() {
            Some(known) => format!("did you mean \"{known}\"?"),
            None => format!("no service has an output `{}`; add one", port.name()),
        };
        return Some(format!(
            "nobody writes wire {wire}, the input `{}` of service `{name}`; {remedy}",
            port.name()
        ));
    };
    if found.port != port {
        let (here, there) = (port.name(), found.port.name());
        return Some(format!(
            "wire {wire} carries `{there}`, but service `{name}` reads it as `{here}`"
        ));
    }
    if found.readers.len() == READERS_MAX {
        return Some(format!("wire {wire} has more than {READERS_MAX} readers"));
    }
    found.readers.push(name.into());
    None
}

fn known_port(
    file: &SystemFile,
    service: &str,
    port: &str,
    wire: &toml::Spanned<String>,
    problems: &mut Vec<Error>,
) -> Option<Port> {
    let name = wire.get_ref();
    let proper = |byte: u8| byte.is_ascii_alphanumeric() || b"_-./".contains(&byte);
    let is_step = |part: &str| ["", ".", ".."].contains(&part);
    if name.len() > 100 || !name.bytes().all(proper) || name.split('/').any(is_step) || name.starts_with("launcher/") {
        problems.push(file.error_at(
            wire.span(),
            &format!(
                "{name:?} makes no wire's name: up to 100 characters of a-z, 0-9, _, -, . and /, no `..`, not under \
                 launcher/; write e.g. \"front/{port}\""
            ),
        ));
        return None;
    }
    let found = Port::named(port);
    if found.is_none() {
        let known: Vec<&str> = Port::ALL.iter().map(|port| port.name()).collect();
        let what = format!(
            "service `{service}` has no port `{port}`; the ports are {}",
            known.join(", ")
        );
        problems.push(file.error_at(wire.span(), &what));
    }
    found
}

/// Writers before readers. A service that reads, over others, what it writes has no place in that order.
fn check_order(file: &SystemFile, wires: &BTreeMap<String, Wire>, problems: &mut Vec<Error>) -> Vec<String> {
    let mut order: Vec<String> = Vec::new();
    let mut left: BTreeSet<&String> = file.services.keys().collect();
    while !left.is_empty() {
        let reads_placed_only = |name: &&&String| {
            let mut read = wires.values().filter(|wire| wire.readers.contains(name));
            read.all(|wire| order.contains(&wire.writer))
        };
        let Some(next) = left.iter().find(reads_placed_only).copied() else {
            let names: Vec<&str> = left.iter().map(|name| name.as_str()).collect();
            problems.push(Error::config(format!(
                "{}:{}: the services {} form a cycle: each reads what another of them writes; a cycle of the graph must \
                 be broken at one input",
                file.path,
                file.service_line(names[0]),
                names.join(", ")
            )));
            return order;
        };
        left.remove(next);
        order.push(next.clone());
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHAIN: &str = r#"[system]
name = "test"
[service.camera]
exec = ["c"]
outputs = { frames = "front/frames" }
[service.sinkage]
exec = ["s"]
inputs = { frames = "front/frames" }
outputs = { sinkage = "front/sinkage" }
"#;

    fn check(text: &str) -> Result<System, Error> {
        let file = SystemFile::parse("rover.toml", text)?;
        System::check(file, |name| (name != "missing").then(|| PathBuf::from(name)))
    }

    fn refused(text: &str) -> String {
        check(text)
            .map(|system| format!("accepted: {system:?}"))
            .unwrap_or_else(|error| error.to_string())
    }

    #[test]
    fn writers_start_before_readers() {
        assert_eq!(check(CHAIN).unwrap().order, ["camera", "sinkage"]);
    }

    #[test]
    fn two_writers_on_a_wire_are_refused() {
        let text = format!("{CHAIN}[service.other]\nexec = [\"o\"]\noutputs = {{ frames = \"front/frames\" }}\n");
        assert!(refused(&text).starts_with("rover.toml:12: wire front/frames has two writers, `camera` and `other`"));
    }

    #[test]
    fn an_input_that_nobody_writes_is_refused_with_the_wire_that_was_meant() {
        let text = CHAIN.replace(
            "inputs = { frames = \"front/frames\" }",
            "inputs = { frames = \"front/frame\" }",
        );
        assert!(refused(&text).starts_with("rover.toml:8: nobody writes wire front/frame"));
        assert!(refused(&text).ends_with("did you mean \"front/frames\"?"));
    }

    #[test]
    fn a_cycle_is_refused() {
        let text = r#"[system]
name = "test"
[service.a]
exec = ["a"]
inputs = { soil = "soil" }
outputs = { sinkage = "sinkage" }
[service.b]
exec = ["b"]
inputs = { sinkage = "sinkage" }
outputs = { soil = "soil" }
"#;
        assert!(
            refused(text).starts_with("rover.toml:3: the services a, b form a cycle"),
            "{}",
            refused(text)
        );
    }

    #[test]
    fn a_missing_executable_is_refused() {
        let text = CHAIN.replace("[\"s\"]", "[\"missing\"]");
        assert!(refused(&text).starts_with("rover.toml:7: executable `missing` of service `sinkage`"));
    }

    #[test]
    fn an_unknown_port_a_wrong_name_and_a_wrong_number_are_all_told_at_once() {
        let text = CHAIN
            .replace("sinkage = \"front/sinkage\"", "depth = \"front/sinkage\"")
            .replace("name = \"test\"", "name = \"my-rover\"")
            .replace("exec = [\"c\"]", "exec = [\"c\"]\ndeadline_ms = 0");
        let told = refused(&text);
        for words in [
            "rover.toml:2: the system's name `my-rover`",
            "rover.toml:10: service `sinkage` has no port `depth`",
            "rover.toml:5: deadline_ms of service `camera` must be 1 to 3600000, is 0",
        ] {
            assert!(told.contains(words), "{told}");
        }
    }

    #[test]
    fn a_cycles_deadline_is_a_time_of_an_hour_at_the_most() {
        for good in ["50", "0.5", "3600000"] {
            let text = CHAIN.replace(
                "\n[service.camera]",
                &format!("\ncycle_deadline_ms = {good}\n[service.camera]"),
            );
            let deadline_ms = check(&text).unwrap().file.system.cycle_deadline_ms.unwrap();
            assert_eq!(deadline_ms.into_inner(), good.parse::<f64>().unwrap());
        }
        for bad in ["0", "-1", "nan", "inf", "3600001"] {
            let text = CHAIN.replace(
                "\n[service.camera]",
                &format!("\ncycle_deadline_ms = {bad}\n[service.camera]"),
            );
            let told = refused(&text);
            assert!(
                told.starts_with("rover.toml:3: cycle_deadline_ms must be above 0 and at most 3600000, is"),
                "{told}"
            );
        }
        let text = CHAIN.replace("\n[service.camera]", "\ncycle_deadline_ms = \"soon\"\n[service.camera]");
        assert!(refused(&text).starts_with("rover.toml:3: "), "{}", refused(&text));
    }

    #[test]
    fn a_name_that_would_lead_out_of_the_systems_folder_is_refused() {
        for name in [
            "../x",
            "..",
            "a/b",
            "a b",
            "a-b",
            "",
            "\\u0000",
            "\\n",
            &"x".repeat(25),
            "é",
        ] {
            let told = refused(&CHAIN.replace("\"test\"", &format!("\"{name}\"")));
            assert!(told.starts_with("rover.toml:2: the system's name"), "{name}: {told}");
            let told = refused(&CHAIN.replace("service.camera", &format!("service.\"{name}\"")));
            assert!(told.starts_with("rover.toml:4: the service's name"), "{name}: {told}");
        }
        let long = "x/".repeat(51);
        for wire in [
            "../../x",
            "a/../b",
            "/etc/x",
            "a//b",
            ".",
            "a b",
            "\\u0000",
            "",
            &long,
            "launcher/x",
        ] {
            let told = refused(&CHAIN.replace("front/frames", wire));
            assert!(told.starts_with("rover.toml:5: \""), "{wire}: {told}");
            assert!(told.contains("makes no wire's name"), "{wire}: {told}");
        }
    }

    #[test]
    fn too_many_services_are_refused_at_once() {
        let mut text = CHAIN.to_owned();
        for number in 0..10_000 {
            text += &format!("[service.s{number}]\nexec=[]\n");
        }
        let told = refused(&text);
        assert!(told.contains(": 10002 services, at most 32 are possible"), "{told}");
        assert_eq!(told.lines().count(), 1);
    }

    #[test]
    fn a_wire_read_as_something_else_is_refused() {
        let text = CHAIN.replace("inputs = { frames", "inputs = { soil");
        assert!(
            refused(&text).contains("wire front/frames carries `frames`, but service `sinkage` reads it as `soil`")
        );
    }
}
