//! Terrasense itself: `terrasense up`, the services' own programs, and this program as their source.

use bench::compare::{
    Part, Point, Read, Role, SourceEnds, Stamps, WAIT_MAX, Write, WriteFrames, play_source, write_frame,
};
use bench::{Outcome, programs};
use messages::{Frame, Header, Sinkage, Soil, Terrain, Wheel};
use shell::{Domain, Error, Output, SystemFile, Tap, Termination, now_ns, sleep_until};
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::rc::Rc;
use zerocopy::IntoBytes;

/// Between two looks for the end of a run [ns].
const LOOK_NS: u64 = 50_000_000;

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

/// A running system. It ends with this value.
pub struct Rover {
    launcher: Child,
    folder: PathBuf,
    name: String,
}

impl Rover {
    /// Starts the system. `place` are the lines of a service's table that say where and how it runs.
    pub fn start(part: &Part, place: impl Fn(Role) -> String) -> Outcome<Self> {
        let name = format!("compare{}", std::process::id());
        let (file, log) = (part.folder.join("rover.toml"), part.folder.join("log"));
        std::fs::write(&file, system_file(&name, part, place)?)?;
        let mut command = Command::new(programs()?.join("terrasense"));
        command
            .arg("up")
            .arg(&file)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(log)?);
        shell::bind_to_parent(&mut command);
        Ok(Self {
            launcher: command.spawn()?,
            folder: part.folder.clone(),
            name,
        })
    }

    /// Waits until the source has left its stamps.
    pub fn wait(mut self, last_ns: u64, termination: &Termination) -> Outcome<()> {
        while !Part::stamps(&self.folder, Role::Source).exists() {
            let ended = self.launcher.try_wait()?.is_some();
            if ended || termination.requested() || now_ns() > last_ns {
                return Err(format!("the system does not come to its end:\n{}", self.log()).into());
            }
            sleep_until(now_ns() + LOOK_NS);
        }
        self.signal();
        let status = self.launcher.wait()?;
        if status.success() {
            return Ok(());
        }
        Err(format!("{status}:\n{}", self.log()).into())
    }

    fn signal(&self) {
        let pid = i32::try_from(self.launcher.id())
            .ok()
            .and_then(rustix::process::Pid::from_raw);
        let _ = pid.map(|pid| rustix::process::kill_process(pid, rustix::process::Signal::TERM));
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.join("log")).unwrap_or_default()
    }
}

impl Drop for Rover {
    fn drop(&mut self) {
        if let Ok(None) = self.launcher.try_wait() {
            self.signal();
            let _ = self.launcher.wait();
        }
        let clean = |programs: PathBuf| {
            Command::new(programs.join("terrasense"))
                .args(["clean", "--name", &self.name])
                .output()
        };
        drop(programs().map(clean));
    }
}

fn system_file(name: &str, part: &Part, place: impl Fn(Role) -> String) -> Outcome<String> {
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
    Ok(format!("[system]\nname = \"{name}\"\n{}", services.concat()))
}
