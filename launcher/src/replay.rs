//! `replay`: the real process set over a recorded traverse, without loss, as fast as it goes.

use crate::commands::{self, DEFAULT_SYSTEM, find, listen, say};
use crate::figures;
use crate::policy::Ending;
use crate::record::Recording;
use crate::supervisor::Supervisor;
use crate::system::System;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use messages::{ServiceState, Status};
use shell::{Error, Port, SystemFile, now_ns};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use toml_edit::{DocumentMut, Item, Table, Value, value};
use traverse::{Rolls, Traverse};

/// Without a sample on any wire for this long, a replay has stalled [ns].
const STALL_NS: u64 = 30_000_000_000;

/// `terrasense replay`
#[derive(Debug, Args)]
pub struct ReplayArguments {
    /// The traverse folder: traverse.toml, frames.csv and pictures, wheel.csv, sinkage.csv, vibration.csv; any part may be
    /// absent.
    #[arg(value_name = "TRAVERSE")]
    traverse: PathBuf,
    /// Where the CSVs go; made if it is not there.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Writes the pictures with what was found in them into DIR/overlay.
    #[arg(long)]
    overlay: bool,
    /// A system file whose services replace the built-in ones.
    #[arg(long, value_name = "ROVER.TOML")]
    system: Option<String>,
    /// Draw what was estimated: soil.svg shows cohesion and friction angle against time, with their 95 % bands, the changes
    /// of soil that were found, and the truth if the traverse has a truth.csv; sinkage.svg does so for the sinkage on either
    /// side, and interface.svg shows the intensity and the score along the rim of one picture.
    #[arg(long)]
    plots: bool,
}

/// Which parts a traverse has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Parts {
    frames: bool,
    wheel: bool,
    sinkage: bool,
    vibration: bool,
}

impl Parts {
    /// The angles of contact were measured, and are not seen by a camera.
    fn measured_angles(self) -> bool {
        self.sinkage && !self.frames
    }
}

/// Replays a traverse.
pub fn run(arguments: &ReplayArguments) -> Result<ExitCode, Error> {
    let folder = &arguments.traverse;
    let description = describe(folder)?;
    let parts = parts(folder)?;
    let system = system(arguments, &description, parts)?;
    commands::check_configs(&system, None)?;
    std::fs::create_dir_all(&arguments.out)
        .map_err(|error| Error::data(format!("{}: {error}", arguments.out.display())))?;
    let mut recordings = BTreeMap::new();
    for figure in [figures::SOIL, figures::SINKAGE, figures::INTERFACE] {
        remove_earlier(&arguments.out, figure)?;
    }
    for (wire, about) in &system.wires {
        remove_earlier(&arguments.out, &format!("{}.csv", about.port.name()))?;
        recordings.insert(
            wire.clone(),
            Recording::create(&arguments.out, about.port.name(), about.port)?,
        );
    }
    let termination = listen()?;
    let mut supervisor = Supervisor::new(system, termination.clone())?;
    let outcome = play(&mut supervisor, &mut recordings, &termination);
    supervisor.stop(|_| ())?;
    let blind = outcome?;
    for (wire, recording) in recordings {
        println!(
            "{:<24} {:>8} rows  {}/{}.csv",
            wire,
            recording.rows,
            arguments.out.display(),
            name_of(&supervisor, &wire)
        );
        recording.finish()?;
    }
    if blind > 0 {
        shell::tell(format_args!(
            "terrasense: {blind} pictures could not be read: the camera says above why, and frames.csv and sinkage.csv say \
             input_rejected, or no_data where there is no file"
        ));
    }
    draw(arguments, parts)?;
    Ok(ExitCode::SUCCESS)
}

/// Figures and pictures, as far as they were asked for.
fn draw(arguments: &ReplayArguments, parts: Parts) -> Result<(), Error> {
    let (folder, out) = (&arguments.traverse, &arguments.out);
    if arguments.plots {
        let drawn = [
            ("cohesion, friction", figures::soil(folder, out)?),
            ("sinkage", figures::sinkage(folder, out)?),
            ("interface", figures::interface(folder, out)?),
        ];
        for (what, path) in drawn.iter().filter_map(|(what, path)| Some((what, path.as_ref()?))) {
            println!("{what:<24} {:>13}  {}", "plot", path.display());
        }
        if drawn.iter().all(|(_, path)| path.is_none()) {
            shell::tell(format_args!(
                "terrasense: nothing to plot: this replay has neither soil nor sinkage"
            ));
        }
    }
    if arguments.overlay && parts.frames {
        let count = crate::overlay::write(folder, out)?;
        println!("{:<24} {count:>8} PNGs  {}/overlay", "pictures", out.display());
    }
    Ok(())
}

/// Runs the system until every wire has come to its end. Gives the number of frames without a picture.
fn play(
    supervisor: &mut Supervisor,
    recordings: &mut BTreeMap<String, Recording>,
    termination: &shell::Termination,
) -> Result<u64, Error> {
    let bar = ProgressBar::new_spinner();
    bar.set_style(ProgressStyle::with_template("{spinner} {elapsed_precise} {msg}").unwrap_or_else(|_| unreachable!()));
    let mut failure = None;
    let (mut progress_ns, mut blind) = (now_ns(), 0);
    let mut record = |(wire, port, header, bytes): crate::supervisor::Seen<'_>| {
        progress_ns = now_ns();
        let pictured = header.status.is_answer() || header.status == Status::ENDED;
        blind += u64::from(port == Port::Frames && !pictured);
        if let Some(recording) = recordings.get_mut(wire) {
            if let Err(error) = recording.add(header, bytes) {
                failure.get_or_insert(error);
            }
            if recording.rows % 64 == 0 {
                bar.set_message(format!(
                    "{:.1} s of the traverse, {} {}",
                    header.taken_ns as f64 * 1e-9,
                    recording.rows,
                    port.name()
                ));
            }
        }
        progress_ns
    };
    let mut last_ns = now_ns();
    supervisor.start(|seen| last_ns = record(seen))?;
    loop {
        supervisor.tick(|seen| last_ns = record(seen))?;
        check_endings(supervisor)?;
        if termination.requested() {
            return Err(Error::internal("interrupted; nothing was written"));
        }
        let wires = &supervisor.system().wires;
        let going: Vec<&String> = wires
            .keys()
            .filter(|wire| !supervisor.watch(wire).is_some_and(|watch| watch.ended))
            .collect();
        if going.is_empty() {
            break;
        }
        if now_ns().saturating_sub(last_ns) > STALL_NS {
            let wires = going
                .iter()
                .map(|wire| format!("{wire} (by {})", supervisor.system().wires[*wire].writer));
            let list = wires.collect::<Vec<_>>().join(", ");
            return Err(Error::internal(format!(
                "no sample for 30 s, and no end on: {list}; nothing was written"
            )));
        }
    }
    bar.finish_and_clear();
    failure.map_or(Ok(blind), Err)
}

/// A replay does not go on without one of its services: it would not be the same a second time.
fn check_endings(supervisor: &mut Supervisor) -> Result<(), Error> {
    let ended = supervisor.services().iter().find_map(|(name, service)| {
        let over = service.state == ServiceState::GIVEN_UP;
        over.then_some((name.clone(), service.ending))
    });
    let Some((name, ending)) = ended else {
        let _ = supervisor.take_log();
        return Ok(());
    };
    match ending {
        Some(Ending::Code(65)) => Err(Error::data(format!(
            "{name} could not read the traverse; nothing was written"
        ))),
        Some(Ending::Code(78)) => Err(Error::config(format!("{name} was refused its configuration"))),
        _ => {
            say(supervisor);
            Err(Error::internal(format!(
                "{name} ended before the traverse did; nothing was written"
            )))
        }
    }
}

fn describe(folder: &Path) -> Result<Traverse, Error> {
    let path = folder.join("traverse.toml");
    let shown = path.display().to_string();
    let failed = |what: &dyn std::fmt::Display| {
        Error::data(format!(
            "{shown}: {what}; a traverse folder needs at least:\n{}",
            Traverse::EXAMPLE
        ))
    };
    // A pipe would be waited for.
    if path.exists() && !path.is_file() {
        return Err(failed(&"is no file"));
    }
    let file = std::fs::File::open(&path).map_err(|error| failed(&error))?;
    Traverse::read(&shown, Some(Box::new(file))).map_err(|error| Error::data(error.to_string()))
}

fn parts(folder: &Path) -> Result<Parts, Error> {
    let has = |file: &str| folder.join(file).is_file();
    let parts = Parts {
        frames: has("frames.csv"),
        wheel: has("wheel.csv"),
        sinkage: has("sinkage.csv"),
        vibration: has("vibration.csv") || has("vibration.wav"),
    };
    if !(parts.frames || parts.wheel || parts.sinkage || parts.vibration) {
        return Err(Error::data(format!(
            "{}: no frames.csv, wheel.csv, sinkage.csv, vibration.csv or vibration.wav; `terrasense simulate --out DIR` \
             writes a folder to compare with",
            folder.display()
        )));
    }
    if parts.frames && parts.sinkage {
        shell::tell(format_args!(
            "terrasense: the traverse has pictures; its measured sinkage.csv is not used"
        ));
    }
    Ok(parts)
}

/// The system file of this replay: the services that have their inputs, fed from the traverse.
fn system(arguments: &ReplayArguments, description: &Traverse, parts: Parts) -> Result<System, Error> {
    let (path, text) = match &arguments.system {
        Some(path) => (path.clone(), SystemFile::read(path)?.text),
        None => ("the built-in rover.toml".to_owned(), DEFAULT_SYSTEM.to_owned()),
    };
    let mut document: DocumentMut = text
        .parse()
        .map_err(|error| Error::config(format!("{path}: {error}")))?;
    document["system"]["name"] = value(format!("replay_{}", std::process::id()));
    document["system"]["mode"] = value("replay");
    let folder = commands::absolute(&arguments.traverse.display().to_string())?;
    let services = document["service"]
        .as_table_mut()
        .ok_or_else(|| Error::config(format!("{path}: no [service.…] tables")))?;
    feed(services, &folder, parts);
    keep_fed(services);
    if services.is_empty() {
        return Err(Error::data(format!(
            "{folder}: no service of {path} has the inputs it needs in this traverse"
        )));
    }
    for (_, service) in services.iter_mut() {
        service["restart"] = value("never");
        service.as_table_like_mut().map(|table| table.remove("deadline_ms"));
        configure(service, description, parts);
    }
    let file = SystemFile::parse(&path, &document.to_string())?;
    let beside = arguments
        .system
        .as_deref()
        .and_then(|path| Path::new(path).parent())
        .map(Path::to_path_buf);
    System::check(file, |program| find(program, beside.as_deref()))
}

/// Turns the sources to the traverse, and takes away the outputs that it has nothing for.
fn feed(services: &mut Table, folder: &str, parts: Parts) {
    if parts.measured_angles() {
        // Measured angles take the place of the service that would see them.
        let seen = writer_of(services, Port::Sinkage).and_then(|(name, wire)| services.remove(&name).map(|_| wire));
        if let (Some(wire), Some((name, _))) = (seen, writer_of(services, Port::Wheel)) {
            services[&name]["outputs"]["sinkage"] = value(wire);
        }
    }
    for (_, service) in services.iter_mut() {
        let is_source = service
            .get("inputs")
            .and_then(Item::as_table_like)
            .is_none_or(toml_edit::TableLike::is_empty);
        if !is_source {
            continue;
        }
        service["config"] = value(toml_edit::InlineTable::from_iter([
            ("source", "recorded"),
            ("folder", folder),
        ]));
        let absent = [
            (Port::Frames, parts.frames),
            (Port::Wheel, parts.wheel),
            (Port::Vibration, parts.vibration),
        ];
        if let Some(outputs) = service.get_mut("outputs").and_then(Item::as_table_like_mut) {
            absent
                .iter()
                .filter(|(_, there)| !there)
                .for_each(|(port, _)| drop(outputs.remove(port.name())));
        }
    }
}

/// Leaves only the services that write something and have all their inputs, but for those they can do without.
fn keep_fed(services: &mut Table) {
    loop {
        let mut written = Vec::new();
        for (_, service) in services.iter() {
            written.extend(wires(service, "outputs").into_iter().map(|(_, wire)| wire));
        }
        let unfed = services.iter().find(|(_, service)| {
            let starved = |(port, wire): &(String, String)| *port != Port::Class.name() && !written.contains(wire);
            wires(service, "outputs").is_empty() || wires(service, "inputs").iter().any(starved)
        });
        let Some(name) = unfed.map(|(name, _)| name.to_owned()) else {
            for (_, service) in services.iter_mut() {
                let unwritten: Vec<String> = wires(service, "inputs")
                    .into_iter()
                    .filter(|(_, wire)| !written.contains(wire))
                    .map(|(port, _)| port)
                    .collect();
                if let Some(inputs) = service.get_mut("inputs").and_then(Item::as_table_like_mut) {
                    unwritten.iter().for_each(|port| drop(inputs.remove(port)));
                }
            }
            return;
        };
        services.remove(&name);
    }
}

/// Gives a stage what the traverse says of wheel, soil and sensors.
fn configure(service: &mut Item, description: &Traverse, parts: Parts) {
    let outputs: Vec<String> = wires(service, "outputs").into_iter().map(|(port, _)| port).collect();
    let writes = |port: Port| outputs.iter().any(|name| name == port.name());
    let mut settings: Vec<(&str, Value)> = Vec::new();
    if let (Some(wheel), true) = (&description.wheel, writes(Port::Sinkage) || writes(Port::Soil)) {
        settings.push(("radius_m", wheel.radius_m.into()));
        if writes(Port::Sinkage) && !writes(Port::Wheel) {
            let rolls = if wheel.rolls == Rolls::Left { "left" } else { "right" };
            settings.push(("rolls", rolls.into()));
        }
        if writes(Port::Soil) {
            settings.push(("width_m", wheel.width_m.into()));
            settings.push(("grouser_height_m", wheel.grouser_height_m.into()));
        }
    }
    if writes(Port::Soil) {
        let sensors = &description.sensors;
        let given = [
            ("shear_modulus_m", description.soil.shear_modulus_m),
            ("load_sigma", sensors.load_sigma),
            ("torque_sigma", sensors.torque_sigma),
            ("entry_sigma_rad", sensors.entry_sigma_rad),
            ("slip_sigma", sensors.slip_sigma),
        ];
        settings.extend(
            given
                .into_iter()
                .filter_map(|(key, number)| Some((key, number?.into()))),
        );
        // A camera sees how high the soil lies behind the wheel, not where it stops to press; a measurement may know.
        if parts.measured_angles() {
            settings.push(("exit_angle", "measured".into()));
        }
    }
    let source = wires(service, "inputs").is_empty();
    for (key, setting) in settings.into_iter().filter(|_| !source) {
        service["config"][key] = Item::Value(setting);
    }
}

fn writer_of(services: &Table, port: Port) -> Option<(String, String)> {
    services.iter().find_map(|(name, service)| {
        let found = wires(service, "outputs")
            .into_iter()
            .find(|(output, _)| output == port.name());
        found.map(|(_, wire)| (name.to_owned(), wire))
    })
}

/// Port → wire of one direction.
fn wires(service: &Item, direction: &str) -> Vec<(String, String)> {
    let table = service.get(direction).and_then(Item::as_table_like);
    let pairs = table.into_iter().flat_map(|table| table.iter());
    pairs
        .filter_map(|(port, wire)| Some((port.to_owned(), wire.as_str()?.to_owned())))
        .collect()
}

fn remove_earlier(folder: &Path, file: &str) -> Result<(), Error> {
    let path = folder.join(file);
    match std::fs::remove_file(&path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(Error::data(format!("{}: {error}", path.display())))
        }
        _ => Ok(()),
    }
}

fn name_of(supervisor: &Supervisor, wire: &str) -> &'static str {
    supervisor.system().wires[wire].port.name()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MEASURED: Parts = Parts {
        frames: false,
        wheel: true,
        sinkage: true,
        vibration: false,
    };

    /// The built-in system's terramechanics, configured for a traverse of these parts.
    fn soil_config(parts: Parts) -> Item {
        let mut document: DocumentMut = DEFAULT_SYSTEM.parse().unwrap();
        let services = document["service"].as_table_mut().unwrap();
        let (name, _) = writer_of(services, Port::Soil).unwrap();
        let description = Traverse::parse("traverse.toml", Traverse::EXAMPLE).unwrap();
        configure(&mut services[&name], &description, parts);
        services[&name]["config"].clone()
    }

    #[test]
    fn the_exit_angle_is_used_where_it_was_measured_and_not_seen() {
        let measured = soil_config(MEASURED);
        assert_eq!(measured["exit_angle"].as_str(), Some("measured"));
        assert!(measured.get("radius_m").is_some());
        for parts in [
            Parts {
                frames: true,
                ..MEASURED
            },
            Parts {
                frames: true,
                sinkage: false,
                ..MEASURED
            },
        ] {
            assert!(soil_config(parts).get("exit_angle").is_none(), "{parts:?}");
        }
    }

    #[test]
    fn measured_angles_take_the_place_of_the_camera() {
        let mut document: DocumentMut = DEFAULT_SYSTEM.parse().unwrap();
        let services = document["service"].as_table_mut().unwrap();
        let (seen, wire) = writer_of(services, Port::Sinkage).unwrap();
        feed(services, "/traverse", MEASURED);
        keep_fed(services);
        assert!(services.get(&seen).is_none());
        let (telemetry, _) = writer_of(services, Port::Wheel).unwrap();
        assert_eq!(writer_of(services, Port::Sinkage), Some((telemetry, wire)));
        assert!(writer_of(services, Port::Frames).is_none());
    }
}
