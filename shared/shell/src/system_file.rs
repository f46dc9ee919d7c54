//! The system file: the whole process set on one page, as TOML.

use crate::placement::{Cpus, OnRefusal, Places, Sched};
use crate::{Error, Port};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::io::Read;
use std::ops::Range;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Length of a system file at the most: of what is longer, nothing is parsed.
const BYTES_MAX: usize = 256 << 10;

/// A parsed system file. What its graph must fulfil beyond its form, the launcher checks.
#[derive(Clone, Debug)]
pub struct SystemFile {
    /// Where the file is, for errors.
    pub path: String,
    /// The file as it is.
    pub text: String,
    /// `[system]`
    pub system: SystemTable,
    /// `[service.NAME]`, by name.
    pub services: BTreeMap<String, ServiceTable>,
}

/// `[system]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SystemTable {
    /// Two systems of different names share nothing: neither files nor names in shared memory.
    pub name: Spanned<String>,
    /// Whether samples may be overtaken by newer ones.
    #[serde(default)]
    pub mode: Mode,
    /// A cycle is to be answered by the whole chain within this time after its first sample was sent [ms]; those that are
    /// later are counted. Absent: however late.
    pub cycle_deadline_ms: Option<Spanned<f64>>,
    /// Where the services run whose tables name no processors.
    #[serde(default)]
    pub placement: Places,
}

/// Whether samples may be overtaken by newer ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The newest data win: a full queue drops its oldest sample.
    #[default]
    Live,
    /// Nothing is dropped: a full queue stops its writer, and a stage waits for what it joins.
    Replay,
}

/// `[service.NAME]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServiceTable {
    /// The program and its first arguments; the system file and the service's name follow.
    pub exec: Spanned<Vec<String>>,
    /// Port → wire, for what the service reads.
    #[serde(default)]
    pub inputs: BTreeMap<String, Spanned<String>>,
    /// Port → wire, for what the service writes.
    #[serde(default)]
    pub outputs: BTreeMap<String, Spanned<String>>,
    /// Port → wire on which this service goes on when its turn comes, in the place of another: `outputs` are then for its
    /// rehearsal. The launcher writes it into the file of a swap.
    #[serde(default)]
    pub takes_over: BTreeMap<String, Spanned<String>>,
    /// When the service is started again after it has ended.
    #[serde(default)]
    pub restart: Restart,
    /// Silence on an output for longer [ms] means that the service hangs. Absent: never.
    pub deadline_ms: Option<Spanned<u64>>,
    /// Time from the start until all wires are open [ms]; longer means that the service hangs.
    #[serde(default = "default_start_timeout_ms")]
    pub start_timeout_ms: Spanned<u64>,
    /// Restarts within `intensity_period_ms` before the launcher gives the service up.
    #[serde(default = "default_intensity")]
    pub intensity: Spanned<u32>,
    /// See `intensity` [ms].
    #[serde(default = "default_intensity_period_ms")]
    pub intensity_period_ms: Spanned<u64>,
    /// A service that has run for longer [ms] is started again at once; otherwise the pause doubles each time.
    #[serde(default = "default_minimum_run_ms")]
    pub minimum_run_ms: Spanned<u64>,
    /// The processors it runs on. Absent: any.
    pub cpus: Option<Spanned<Cpus>>,
    /// How the kernel chooses it among other processes. Absent: as it does the launcher.
    pub sched: Option<Spanned<Sched>>,
    /// Whether its memory is kept from being paged out.
    pub lock_memory: Option<Spanned<bool>>,
    /// What to do where the machine refuses one of these three.
    #[serde(default)]
    pub on_refusal: OnRefusal,
    /// The service's own table, in its own words.
    pub config: Option<Spanned<toml::Value>>,
}

impl ServiceTable {
    /// The wire whose samples trigger those of an output.
    pub(crate) fn trigger_of(&self, port: &str) -> Option<&str> {
        let trigger = Port::named(port)?.trigger()?;
        self.inputs.get(trigger.name()).map(|input| input.get_ref().as_str())
    }
}

/// When a service is started again after it has ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Restart {
    /// However it ended.
    #[default]
    Always,
    /// If it ended with an error or by a signal.
    OnFailure,
    /// Not at all.
    Never,
}

fn default_start_timeout_ms() -> Spanned<u64> {
    Spanned::new(0..0, 5000)
}

fn default_intensity() -> Spanned<u32> {
    Spanned::new(0..0, 10)
}

fn default_intensity_period_ms() -> Spanned<u64> {
    Spanned::new(0..0, 10_000)
}

fn default_minimum_run_ms() -> Spanned<u64> {
    Spanned::new(0..0, 1000)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Tables {
    system: SystemTable,
    #[serde(default)]
    service: BTreeMap<String, ServiceTable>,
}

impl SystemFile {
    /// Parses a system file; `path` is only for errors.
    ///
    /// # Errors
    /// Names the line of what is not TOML, unknown, missing or of another type.
    pub fn parse(path: &str, text: &str) -> Result<Self, Error> {
        if text.len() > BYTES_MAX {
            let line = line_of(text, BYTES_MAX);
            return Err(Error::config(format!(
                "{path}:{line}: the file goes on beyond {} KiB; a system file is a page or two",
                BYTES_MAX >> 10
            )));
        }
        let tables: Tables = toml::from_str(text).map_err(|error| toml_error(path, text, &error))?;
        Ok(Self {
            path: path.into(),
            text: text.into(),
            system: tables.system,
            services: tables.service,
        })
    }

    /// Reads and parses a system file.
    ///
    /// # Errors
    /// As [`SystemFile::parse`], and where the file cannot be read.
    pub fn read(path: &str) -> Result<Self, Error> {
        let mut text = String::new();
        // One byte more, by which `parse` sees that there is more.
        let read = std::fs::File::open(path).and_then(|file| file.take(BYTES_MAX as u64 + 1).read_to_string(&mut text));
        read.map_err(|error| {
            Error::config(format!(
                "{path}: {error}; write one with `terrasense default-system > {path}`"
            ))
        })?;
        Self::parse(path, &text)
    }

    /// Whether a system or a service may have this name: it becomes a part of file names. No hyphen: that ends the name in
    /// `/dev/shm`, so that no system's files look like another's.
    #[must_use]
    pub fn is_name(name: &str) -> bool {
        (1..=24).contains(&name.len())
            && name
                .bytes()
                .all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_')
    }

    /// The folder in which this system's iceoryx2 keeps its files, on a tmpfs.
    #[must_use]
    pub fn root(&self) -> String {
        format!("/dev/shm/terrasense-{}", self.system.name.get_ref())
    }

    /// What this system's names in shared memory begin with.
    #[must_use]
    pub fn prefix(&self) -> String {
        format!("terrasense-{}-", self.system.name.get_ref())
    }

    /// The wire with which the chain begins that a wire belongs to.
    pub(crate) fn head_of(&self, wire: &str) -> String {
        let trigger_of = |wire: &str| {
            self.services.values().find_map(|table| {
                let port = table.outputs.iter().find(|(_, output)| output.get_ref() == wire)?.0;
                table.trigger_of(port)
            })
        };
        let mut head = wire;
        // A chain is no longer than there are services; what goes round in a circle, the launcher refuses.
        for _ in 0..self.services.len() {
            head = trigger_of(head).unwrap_or(head);
        }
        head.into()
    }

    /// An error at a place in this file.
    #[must_use]
    pub fn error_at(&self, span: Range<usize>, text: &str) -> Error {
        Error::config(format!("{}:{}: {text}", self.path, line_of(&self.text, span.start)))
    }

    /// The line at which a service's table begins.
    #[must_use]
    pub fn service_line(&self, name: &str) -> usize {
        let header = format!("[service.{name}");
        self.text.find(&header).map_or(1, |at| line_of(&self.text, at))
    }

    /// The `config` of a service as the service's own type, checked by `validate`, which returns a key and what is wrong
    /// with its value.
    ///
    /// # Errors
    /// Names the line of what is unknown, missing, of another type or out of range.
    pub fn config<C: DeserializeOwned>(
        &self,
        service: &str,
        validate: impl Fn(&C) -> Result<(), (&'static str, String)>,
    ) -> Result<C, Error> {
        let empty = || Spanned::new(0..0, DeValue::Table(DeTable::new()));
        let document = DeTable::parse(&self.text).map_err(|error| toml_error(&self.path, &self.text, &error))?;
        let table = document
            .get_ref()
            .get("service")
            .and_then(|services| services.get_ref().get(service))
            .and_then(|table| table.get_ref().get("config"))
            .cloned()
            .unwrap_or_else(empty);
        let keys = table.clone();
        let config = C::deserialize(toml::de::ValueDeserializer::from(table)).map_err(|error| {
            let text = toml_error(&self.path, &self.text, &error);
            if error.span().is_none_or(|span| span.is_empty()) {
                return Error::config(format!(
                    "{}:{}: config of service `{service}`: {}",
                    self.path,
                    self.service_line(service),
                    error.message()
                ));
            }
            text
        })?;
        validate(&config).map_err(|(key, what)| {
            let span = keys.get_ref().get(key).map(Spanned::span);
            let line = span.map_or_else(|| self.service_line(service), |span| line_of(&self.text, span.start));
            Error::config(format!("{}:{line}: `{key}` of service `{service}` {what}", self.path))
        })?;
        Ok(config)
    }
}

fn toml_error(path: &str, text: &str, error: &toml::de::Error) -> Error {
    let line = error.span().map_or(1, |span| line_of(text, span.start));
    Error::config(format!("{path}:{line}: {}", error.message()))
}

/// The line, from 1, that holds the byte at `offset`.
fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|byte| *byte == b'\n').count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Gain {
        gain: f64,
    }

    fn file(config: &str) -> SystemFile {
        let text = format!("[system]\nname = \"test\"\n\n[service.a]\nexec = [\"a\"]\nconfig = {{ {config} }}\n");
        SystemFile::parse("rover.toml", &text).unwrap()
    }

    fn positive(config: &Gain) -> Result<(), (&'static str, String)> {
        if config.gain > 0.0 {
            Ok(())
        } else {
            Err(("gain", format!("must be above 0, is {}", config.gain)))
        }
    }

    #[test]
    fn a_config_is_read_as_the_services_own_type() {
        assert_eq!(file("gain = 2.5").config::<Gain>("a", positive).unwrap().gain, 2.5);
    }

    #[test]
    fn every_error_names_its_line() {
        for (config, words) in [
            (
                "gain = -1.0",
                "rover.toml:6: `gain` of service `a` must be above 0, is -1",
            ),
            ("gain = 1.0, gian = 2.0", "rover.toml:6: unknown field `gian`"),
            (
                "gain = \"loud\"",
                "rover.toml:6: invalid type: string \"loud\", expected f64",
            ),
            ("", "rover.toml:"),
        ] {
            let error = file(config).config::<Gain>("a", positive).unwrap_err();
            assert!(error.to_string().starts_with(words), "{error}");
            assert_eq!(error.code(), 78);
        }
    }

    #[test]
    fn a_file_without_end_is_refused_before_it_is_parsed() {
        let error = SystemFile::read("/dev/zero").unwrap_err();
        assert!(
            error
                .to_string()
                .starts_with("/dev/zero:1: the file goes on beyond 256 KiB")
        );
        let text = "# a line\n".repeat(100_000);
        let error = SystemFile::parse("rover.toml", &text).unwrap_err();
        assert!(error.to_string().starts_with("rover.toml:29128: the file"), "{error}");
    }

    #[test]
    fn an_unknown_key_of_a_service_is_refused() {
        let error = SystemFile::parse("rover.toml", "[system]\nname='x'\n[service.a]\nexec=['a']\nexce=1").unwrap_err();
        assert!(
            error.to_string().starts_with("rover.toml:5: unknown field `exce`"),
            "{error}"
        );
    }
}
