//! Terrasense itself: `terrasense up`, the services' own programs, and this program as their source.

use bench::compare::{
    Part, Point, Read, Role, SourceEnds, Stamps, WAIT_MAX, Write, WriteFrames, play_source, write_frame,
};
use bench::{Outcome, Processes, programs};
use messages::{Frame, Header, Sinkage, Soil, Terrain, Wheel};
use shell::{Domain, Error, Output, SystemFile, Tap, Termination, now_ns};
use std::cell::RefCell;
use std::path::Path;
use std::process::ExitCode;
use std::rc::Rc;
use zerocopy::IntoBytes;

/// The source as a service: `compare SYSTEM.TOML source`.
pub fn serve() -> ExitCode {
    shell::main(|shell| {
        let part: Part = shell.config(|_| Ok(()))?;
        let frames = shell.output::<Frame>("frames")?;
        let wheel = shell.output::<Wheel>("wheel")?;
        let failed = |error: Box<dyn std::error::Error>| Error::internal(error.to_string());
        // A graph has no cycles: what comes back is looked at from outside, as a rover's control would.
        let file = SystemFile::read(&std::env::args().nth(1).unwrap_or_default())?;
        let domain = Domain::enter(&file, "control")?;
        let stamps = Rc::new(RefCell::new(Stamps::default()));
        let control = Control {
            terrain: Tap::open(&domain, "front/terrain")?,
            sinkage: Tap::open(&domain, "front/sinkage")?,
            soil: Tap::open(&domain, "front/soil")?,
            stamps: stamps.clone(),
        };
        let ends = SourceEnds {
            wheel: Box::new(Readings(wheel)),
            frames: Box::new(Pictures(frames)),
            terrain: Box::new(control),
        };
        let sent = play_source(&part, ends).map_err(failed)?;
        let write = |stamps: &Stamps, role| stamps.write(&Part::stamps(&part.folder, role)).map_err(failed);
        write(&stamps.borrow(), Role::Terrain)?;
        write(&sent, Role::Source)
    })
}

struct Readings(Output<Wheel>);

impl Write<Wheel> for Readings {
    fn send(&mut self, sample: &Wheel) -> Outcome<()> {
        Ok(self.0.send(*sample)?)
    }
}

struct Pictures(Output<Frame>);

impl WriteFrames for Pictures {
    fn send(&mut self, header: Header, picture: &[u8]) -> Outcome<u64> {
        let mut published_ns = 0;
        self.0.send_with(|frame| {
            published_ns = write_frame(frame.as_mut_bytes(), header, picture);
            Ok(())
        })?;
        Ok(published_ns)
    }
}

/// Reads the terrain; the other two wires are read for their stamps, after the cycle.
struct Control {
    terrain: Tap<Terrain>,
    sinkage: Tap<Sinkage>,
    soil: Tap<Soil>,
    stamps: Rc<RefCell<Stamps>>,
}

impl Control {
    fn note(&self) -> Outcome<()> {
        let mut stamps = self.stamps.borrow_mut();
        while let Some(header) = self.sinkage.poll(|sample| sample.header)? {
            stamps.note(Point::Sinkage, header.sequence, header.published_ns);
        }
        while let Some(header) = self.soil.poll(|sample| sample.header)? {
            stamps.note(Point::Soil, header.sequence, header.published_ns);
        }
        Ok(())
    }
}

impl Read<Terrain> for Control {
    fn each(&mut self, act: &mut dyn FnMut(Option<&Terrain>) -> Outcome<bool>) -> Outcome<()> {
        let mut last_ns = now_ns();
        loop {
            if let Some(goes_on) = self.terrain.poll(|sample| act(Some(sample)))? {
                self.note()?;
                last_ns = now_ns();
                if !goes_on? {
                    return Ok(());
                }
            } else if now_ns() > last_ns + u64::try_from(WAIT_MAX.as_nanos())? {
                last_ns = now_ns();
                if !act(None)? {
                    return Ok(());
                }
            } else {
                self.terrain.wait()?;
            }
        }
    }

    fn poll(&mut self, act: &mut dyn FnMut(&Terrain)) -> Outcome<bool> {
        self.note()?;
        Ok(self.terrain.poll(act)?.is_some())
    }
}

/// Runs the system until its source has left its stamps. `lines` are more lines of its first table, `place` those of a
/// service's table that say where and how it runs.
pub fn run(
    part: &Part,
    lines: &str,
    place: impl Fn(Role) -> String,
    last_ns: u64,
    termination: &Termination,
) -> Outcome<()> {
    let head = format!("[system]\nname = \"compare{}\"\n{lines}", std::process::id());
    let mut system = Processes::launch(&(head + &services(part, place)?))?;
    system.wait_until(last_ns, termination, |_| {
        Part::stamps(&part.folder, Role::Source).exists()
    })?;
    system.end()
}

fn services(part: &Part, place: impl Fn(Role) -> String) -> Outcome<String> {
    let here = std::env::current_exe()?;
    let programs = programs()?;
    let service = |role: Role, wires: &str, config: &str| {
        let program = match role {
            Role::Source => here.clone(),
            _ => programs.join(format!("terrasense-{}", role.name())),
        };
        let place = place(role);
        let name = role.name();
        format!("[service.{name}]\nexec = [{program:?}]\n{wires}\n{place}{config}\n")
    };
    let config = format!(
        "restart = \"never\"\nconfig = {{ role = \"source\", folder = {:?}, pace = {:?}, cycles = {}, warm_up = {} }}",
        Path::new(&part.folder),
        part.pace.name(),
        part.cycles,
        part.warm_up
    );
    let services = [
        service(
            Role::Source,
            "outputs = { frames = \"front/frames\", wheel = \"front/wheel\" }",
            &config,
        ),
        service(
            Role::Sinkage,
            "inputs = { frames = \"front/frames\" }\noutputs = { sinkage = \"front/sinkage\" }",
            "",
        ),
        service(
            Role::Terramechanics,
            "inputs = { sinkage = \"front/sinkage\", wheel = \"front/wheel\" }\noutputs = { soil = \"front/soil\" }",
            "",
        ),
        service(
            Role::Terrain,
            "inputs = { soil = \"front/soil\", sinkage = \"front/sinkage\" }\noutputs = { terrain = \"front/terrain\" }",
            "",
        ),
    ];
    Ok(services.concat())
}
