//! `up`, `validate`, and what the commands share: finding a system file and its programs.

use crate::supervisor::Supervisor;
use crate::system::System;
use clap::Args;
use messages::ServiceState;
use shell::{Error, SystemFile, Termination};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

/// The built-in system file.
pub const DEFAULT_SYSTEM: &str = include_str!("../rover.toml");

/// `terrasense up`
#[derive(Debug, Args)]
pub struct UpArguments {
    /// The system file. Without one, the built-in system runs on the simulated rover.
    #[arg(value_name = "ROVER.TOML")]
    system: Option<String>,
}

/// `terrasense validate`
#[derive(Debug, Args)]
pub struct ValidateArguments {
    /// The system file. Without one, the built-in system is checked.
    #[arg(value_name = "ROVER.TOML")]
    system: Option<String>,
}

/// Runs a system until it is told to end.
pub fn up(arguments: &UpArguments) -> Result<ExitCode, Error> {
    let system = load(arguments.system.as_deref())?;
    check_configs(&system, arguments.system.as_deref())?;
    let termination = listen()?;
    let mut supervisor = Supervisor::new(system, termination.clone())?;
    supervisor.start(|_| ())?;
    let mut alive = true;
    say(&mut supervisor);
    if !termination.requested() {
        shell::tell(format_args!(
            "terrasense: up; `terrasense status --name {}` shows how it is doing",
            name_of(&supervisor)
        ));
    }
    while alive && !termination.requested() {
        supervisor.tick(|_| ())?;
        say(&mut supervisor);
        let over = [ServiceState::GIVEN_UP, ServiceState::STOPPED];
        alive = supervisor
            .services()
            .values()
            .any(|service| !over.contains(&service.state));
    }
    supervisor.stop(|_| ())?;
    say(&mut supervisor);
    if !alive {
        return Err(Error::internal("every service has ended; see above why"));
    }
    shell::tell(format_args!("terrasense: stopped"));
    Ok(ExitCode::SUCCESS)
}

/// Checks a system file without starting anything.
pub fn validate(arguments: &ValidateArguments) -> Result<ExitCode, Error> {
    let system = load(arguments.system.as_deref())?;
    check_configs(&system, arguments.system.as_deref())?;
    let file = &system.file;
    println!("{}: system `{}` is right", file.path, file.system.name.get_ref());
    for name in &system.order {
        let table = &file.services[name];
        let list = |wires: &std::collections::BTreeMap<String, toml::Spanned<String>>| {
            wires
                .values()
                .map(|wire| wire.get_ref().clone())
                .collect::<Vec<_>>()
                .join(" ")
        };
        println!("  {name:<16} {:<30} → {}", list(&table.inputs), list(&table.outputs));
    }
    Ok(ExitCode::SUCCESS)
}

/// Reads and checks a system file; without a path, the built-in one.
pub fn load(path: Option<&str>) -> Result<System, Error> {
    let file = match path {
        Some(path) => SystemFile::read(path)?,
        None => SystemFile::parse("the built-in rover.toml", DEFAULT_SYSTEM)?,
    };
    let folder = path.and_then(|path| Path::new(path).parent()).map(Path::to_path_buf);
    System::check(file, |program| find(program, folder.as_deref()))
}

/// Lets each of our own services check its configuration; other programs are asked when they start.
pub fn check_configs(system: &System, path: Option<&str>) -> Result<(), Error> {
    // The built-in file and generated ones have no path that a service could read.
    let scratch = std::env::temp_dir().join(format!("terrasense-check-{}.toml", std::process::id()));
    let given = path.map(PathBuf::from);
    let readable = given.as_ref().unwrap_or(&scratch);
    if given.is_none() {
        write_own(&scratch, &system.file.text)
            .map_err(|error| Error::unavailable(format!("{}: {error}", scratch.display())))?;
    }
    let problems: Vec<String> = system
        .programs
        .iter()
        .filter(|(_, program)| {
            program
                .file_name()
                .and_then(|file| file.to_str())
                .is_some_and(|file| file.starts_with("terrasense-"))
        })
        .filter_map(|(name, program)| check_config(name, program, readable))
        .map(|text| text.replace(&scratch.display().to_string(), &system.file.path))
        .collect();
    if given.is_none() {
        let _ = std::fs::remove_file(&scratch);
    }
    if problems.is_empty() {
        Ok(())
    } else {
        Err(Error::config(problems.join("\n")))
    }
}

/// Writes a file that nobody had made before, and that nobody else can read.
fn write_own(path: &Path, text: &str) -> std::io::Result<()> {
    let mut options = std::fs::OpenOptions::new();
    let mut file = options.write(true).create_new(true).mode(0o600).open(path)?;
    file.write_all(text.as_bytes())
}

/// What is wrong with the configuration of one service, if anything is.
fn check_config(name: &str, program: &Path, system: &Path) -> Option<String> {
    let output = Command::new(program)
        .arg("--check")
        .arg(system)
        .arg(name)
        .stdin(Stdio::null())
        .output();
    match output {
        Ok(output) if output.status.success() => None,
        Ok(output) => {
            let text = String::from_utf8_lossy(&output.stderr);
            let text = text.trim();
            Some(
                text.strip_prefix(&format!("service {name}: "))
                    .unwrap_or(text)
                    .to_owned(),
            )
        }
        Err(error) => Some(format!("{}: {error}", program.display())),
    }
}

/// Where a program is: by its path, seen from the system file's folder; else beside this one; else on PATH.
pub fn find(program: &str, folder: Option<&Path>) -> Option<PathBuf> {
    let runs = |path: &PathBuf| rustix::fs::access(path, rustix::fs::Access::EXEC_OK).is_ok() && path.is_file();
    if program.contains('/') {
        let path = folder.unwrap_or(Path::new("")).join(program);
        return std::path::absolute(path).ok().filter(runs);
    }
    let beside = std::env::current_exe().ok()?.parent()?.join(program);
    let paths = std::env::var_os("PATH").unwrap_or_default();
    let on_path = std::env::split_paths(&paths)
        .map(|folder| folder.join(program))
        .collect::<Vec<_>>();
    std::iter::once(beside).chain(on_path).find(runs)
}

/// Takes over SIGTERM and SIGINT.
pub fn listen() -> Result<Termination, Error> {
    Termination::listen().map_err(|error| Error::internal(error.to_string()))
}

/// Prints what has happened since the last call.
pub fn say(supervisor: &mut Supervisor) {
    for line in supervisor.take_log() {
        shell::tell(format_args!("terrasense: {line}"));
    }
}

/// The path from the root on: services are started elsewhere.
pub fn absolute(path: &str) -> Result<String, Error> {
    let absolute = std::path::absolute(path).map_err(|error| Error::usage(format!("{path}: {error}")))?;
    Ok(absolute.display().to_string())
}

fn name_of(supervisor: &Supervisor) -> &str {
    supervisor.system().file.system.name.get_ref()
}
