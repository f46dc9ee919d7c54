//! Faults at random instants in a system that runs, and what became of each estimation cycle.

use crate::Outcome;
use messages::{Header, Soil, Status};
use rustix::process::{Pid, Signal};
use shell::{AnyTap, Domain, Port, SystemFile, Termination, now_ns, sleep_until};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use tempfile::TempDir;
use zerocopy::FromBytes;

const MS_NS: u64 = 1_000_000;
/// How long the system may take to start, to come back after a fault, and to see the last cycles through [ns].
const START_MAX_NS: u64 = 30_000 * MS_NS;
const BACK_MAX_NS: u64 = 20_000 * MS_NS;
const SETTLE_NS: u64 = 2500 * MS_NS;
/// Pause before the next fault [ns]: at least, and at most so much more.
const PAUSE_MIN_NS: u64 = 150 * MS_NS;
const PAUSE_MORE_NS: u64 = 350 * MS_NS;
/// A young process is killed within this time of its start [ns].
const YOUNG_NS: u64 = 50 * MS_NS;
/// A cycle that took longer from frame to terrain is late [ns].
const LATE_NS: u64 = 50 * MS_NS;

/// Lines of the log that an error shows.
const LOG_LINES: usize = 30;

/// The stages that faults happen to.
pub const STAGES: [&str; 4] = ["sinkage", "terramechanics", "vibration", "terrain"];

/// What happens to a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Fault {
    /// kill -9.
    Kill,
    /// kill -9, and again in the first milliseconds of the life of the process that takes its place.
    KillYoung,
    /// SIGTERM, which no launcher has sent.
    Terminate,
    /// SIGSTOP: it hangs until its silence is noticed.
    Stop,
    /// `terrasense swap` by the same program.
    Swap,
}

impl Fault {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Kill, Self::KillYoung, Self::Terminate, Self::Stop, Self::Swap];
}

/// What to do.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Where the `terrasense` program is.
    pub programs: PathBuf,
    /// Decides what happens to whom and when.
    pub seed: u64,
    /// How many faults.
    pub faults: usize,
    /// Frames per second.
    pub rate_hz: u32,
    /// Which faults.
    pub kinds: Vec<Fault>,
}

/// What became of the cycles, and what was left.
#[derive(Debug, Default)]
pub struct Verdict {
    /// A row for each fault and stage.
    pub rows: BTreeMap<(Fault, &'static str), Row>,
    /// Of the launcher: descriptors, files in shared memory and resident memory [KiB], before the first fault and after the
    /// last.
    pub held: [[u64; 3]; 2],
    /// Files in shared memory, and processes, after the end.
    pub left: [usize; 2],
    /// How the launcher ended.
    pub code: Option<i32>,
}

/// What became of the cycles after the faults of one kind.
#[derive(Clone, Debug, Default)]
pub struct Row {
    /// Faults.
    pub faults: u64,
    /// Frames published.
    pub expected: u64,
    /// Of these, those with a terrain sample.
    pub published: u64,
    /// Of these, those that took long.
    pub late: u64,
    /// Cycles that came twice.
    pub doubled: u64,
    /// Longest pause between two terrain samples after each fault [ms].
    pub gaps_ms: Vec<f64>,
    /// Faults after which the estimate had started over, though the soil was the same: it rested on fewer rows.
    pub started_over: u64,
    /// Faults after which cohesion or friction angle lay farther than its sigma from what it was before. Without any fault this
    /// is so in one of fifty spans of three cycles.
    pub moved: u64,
}

impl Row {
    /// Cycles without a terrain sample.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.expected - self.published
    }
}

/// One fault: when, what, to whom, and where its cycles begin.
struct Event {
    at_ns: u64,
    fault: Fault,
    stage: &'static str,
}

/// What was seen on the wires.
#[derive(Default)]
struct Seen {
    /// When each frame was published [ns].
    frames: BTreeMap<u64, u64>,
    /// Every terrain sample.
    terrain: Vec<Header>,
    /// Every soil sample.
    soil: Vec<Soil>,
}

/// The system that the faults happen to, and who looks at it.
struct Rover {
    folder: TempDir,
    programs: PathBuf,
    name: String,
    launcher: Child,
    taps: Option<(Domain, [AnyTap; 3])>,
    seen: Seen,
    random: u64,
}

/// Lets the plan happen.
///
/// # Errors
/// The system does not start, or does not come back after a fault.
pub fn run(plan: &Plan, termination: &Termination, mut progress: impl FnMut(usize)) -> Outcome<Verdict> {
    let mut rover = Rover::start(plan)?;
    rover.look_for(1500 * MS_NS)?;
    let before = rover.held();
    let mut events = Vec::new();
    for number in 0..plan.faults {
        if termination.requested() {
            return Err("told to end".into());
        }
        let pause_ns = PAUSE_MIN_NS + rover.below(PAUSE_MORE_NS);
        rover.look_for(pause_ns)?;
        let fault = plan.kinds[rover.below(plan.kinds.len() as u64) as usize];
        let stage = STAGES[rover.below(STAGES.len() as u64) as usize];
        events.push(Event {
            at_ns: now_ns(),
            fault,
            stage,
        });
        rover.suffer(fault, stage)?;
        progress(number + 1);
    }
    rover.look_for(SETTLE_NS)?;
    let mut verdict = judge(&events, &rover.seen);
    verdict.held = [before, rover.held()];
    let (code, left) = rover.end()?;
    verdict.code = code;
    verdict.left = left;
    Ok(verdict)
}

impl Rover {
    fn start(plan: &Plan) -> Outcome<Self> {
        let folder = tempfile::tempdir()?;
        let name = format!("chaos{}", std::process::id());
        let text = Command::new(plan.programs.join("terrasense"))
            .arg("default-system")
            .output()?
            .stdout;
        let text = String::from_utf8(text)?
            .replace("name = \"rover\"", &format!("name = \"{name}\""))
            .replace("rate_hz = 30", &format!("rate_hz = {}", plan.rate_hz))
            .replace("deadline_ms = 1000", "deadline_ms = 500");
        let path = folder.path().join("rover.toml");
        std::fs::write(&path, text)?;
        let launcher = Command::new(plan.programs.join("terrasense"))
            .arg("up")
            .arg(&path)
            .stdin(Stdio::null())
            .stderr(std::fs::File::create(folder.path().join("log"))?)
            .spawn()?;
        let mut rover = Self {
            folder,
            programs: plan.programs.clone(),
            name,
            launcher,
            taps: None,
            seen: Seen::default(),
            random: plan.seed,
        };
        let system = SystemFile::parse("chaos", &format!("[system]\nname = \"{}\"\n", rover.name))?;
        let last_ns = now_ns() + START_MAX_NS;
        while STAGES.iter().any(|stage| rover.pid(stage).is_none()) || rover.taps.is_none() {
            if now_ns() > last_ns {
                return Err("the system does not start".into());
            }
            sleep_until(now_ns() + 20 * MS_NS);
            // The wires are there some time after the folder is.
            let domain = Domain::enter(&system, "chaos")?;
            let ports = [
                ("front/frames", Port::Frames),
                ("front/soil", Port::Soil),
                ("front/terrain", Port::Terrain),
            ];
            if let [Ok(frames), Ok(soil), Ok(terrain)] = ports.map(|(wire, port)| domain.tap(wire, port)) {
                rover.taps = Some((domain, [frames, soil, terrain]));
            }
        }
        Ok(rover)
    }

    /// A number from 0 on, below `limit`.
    fn below(&mut self, limit: u64) -> u64 {
        // splitmix64
        self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % limit.max(1)
    }

    /// Looks at the wires for so long.
    fn look_for(&mut self, time_ns: u64) -> Outcome<()> {
        let until_ns = now_ns() + time_ns;
        while now_ns() < until_ns {
            self.look()?;
            sleep_until((now_ns() + 2 * MS_NS).min(until_ns));
        }
        Ok(())
    }

    fn look(&mut self) -> Outcome<()> {
        let (Some((_, [frames, soil, terrain])), seen) = (&self.taps, &mut self.seen) else {
            return Ok(());
        };
        while frames.poll(&mut |header, _| {
            seen.frames.insert(header.sequence, header.published_ns);
        })? {}
        while soil.poll(&mut |_, bytes| seen.soil.extend(Soil::read_from_bytes(bytes)))? {}
        while terrain.poll(&mut |header, _| seen.terrain.push(*header))? {}
        Ok(())
    }

    /// Lets a fault happen, and waits until another process has taken the place.
    fn suffer(&mut self, fault: Fault, stage: &'static str) -> Outcome<()> {
        let old = self.await_other(stage, None)?;
        match fault {
            Fault::Kill => send(old, Signal::KILL),
            Fault::Terminate => send(old, Signal::TERM),
            Fault::Stop => send(old, Signal::STOP),
            Fault::KillYoung => {
                send(old, Signal::KILL);
                let young = self.await_other(stage, Some(old))?;
                let age_ns = self.below(YOUNG_NS);
                self.look_for(age_ns)?;
                send(young, Signal::KILL);
                self.await_other(stage, Some(young))?;
            }
            Fault::Swap => {
                let mut swap = Command::new(self.programs.join("terrasense"))
                    .args(["swap", "--name", &self.name, "--cycles", "5", stage, "--"])
                    .arg(self.programs.join(format!("terrasense-{stage}")))
                    .stdout(Stdio::null())
                    .spawn()?;
                while swap.try_wait()?.is_none() {
                    self.look_for(5 * MS_NS)?;
                }
                if !swap.wait()?.success() {
                    return Err(format!("{stage}: the swap was refused").into());
                }
            }
        }
        self.await_other(stage, Some(old)).map(|_| ())
    }

    /// The process of a stage that is not `old`.
    fn await_other(&mut self, stage: &str, old: Option<Pid>) -> Outcome<Pid> {
        let last_ns = now_ns() + BACK_MAX_NS;
        loop {
            if let Some(pid) = self.pid(stage).filter(|pid| Some(*pid) != old) {
                return Ok(pid);
            }
            if now_ns() > last_ns {
                return Err(format!("{stage} does not come back:\n{}", self.log()).into());
            }
            self.look_for(MS_NS)?;
        }
    }

    /// The end of what the launcher and its services have said.
    fn log(&self) -> String {
        let text = std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default();
        let lines: Vec<&str> = text.lines().collect();
        lines[lines.len().saturating_sub(LOG_LINES)..].join("\n")
    }

    /// The youngest child of the launcher that runs a stage.
    fn pid(&self, stage: &str) -> Option<Pid> {
        let launcher = self.launcher.id();
        let children = std::fs::read_to_string(format!("/proc/{launcher}/task/{launcher}/children")).ok()?;
        let is_stage = |pid: &&str| {
            let command = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            let program = command.split(|byte| *byte == 0).next().unwrap_or_default();
            program.ends_with(format!("terrasense-{stage}").as_bytes())
        };
        let pid = children.split_whitespace().rfind(is_stage)?;
        Pid::from_raw(pid.parse().ok()?)
    }

    /// The launcher's descriptors, the system's files in shared memory, and the launcher's resident memory [KiB].
    fn held(&self) -> [u64; 3] {
        let entries = |path: &str| std::fs::read_dir(path).map_or(0, |entries| entries.count() as u64);
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.launcher.id())).unwrap_or_default();
        let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let resident = resident.and_then(|text| text.trim().trim_end_matches(" kB").parse().ok());
        [
            entries(&format!("/proc/{}/fd", self.launcher.id())),
            self.files().len() as u64,
            resident.unwrap_or(0),
        ]
    }

    fn files(&self) -> Vec<PathBuf> {
        let begin = format!("terrasense-{}", self.name);
        let entries = std::fs::read_dir("/dev/shm")
            .into_iter()
            .flatten()
            .filter_map(Result::ok);
        entries
            .filter(|entry| entry.file_name().to_string_lossy().starts_with(&begin))
            .map(|entry| entry.path())
            .collect()
    }

    fn end(mut self) -> Outcome<(Option<i32>, [usize; 2])> {
        let pids: Vec<Pid> = STAGES.iter().filter_map(|stage| self.pid(stage)).collect();
        self.taps = None;
        send(Pid::from_child(&self.launcher), Signal::TERM);
        let code = self.launcher.wait()?.code();
        let alive = pids
            .iter()
            .filter(|pid| rustix::process::test_kill_process(**pid).is_ok())
            .count();
        Ok((code, [self.files().len(), alive]))
    }
}

impl Drop for Rover {
    fn drop(&mut self) {
        let _ = self.launcher.kill();
        let _ = self.launcher.wait();
        for path in self.files() {
            let _ = std::fs::remove_dir_all(&path).or_else(|_| std::fs::remove_file(&path));
        }
    }
}

fn send(pid: Pid, signal: Signal) {
    // Who is gone already need not be told.
    let _ = rustix::process::kill_process(pid, signal);
}

/// Gives every cycle to the fault before it.
fn judge(events: &[Event], seen: &Seen) -> Verdict {
    let mut verdict = Verdict::default();
    let mut terrain: BTreeMap<u64, (u64, u64)> = BTreeMap::new();
    for sample in &seen.terrain {
        terrain.entry(sample.sequence).or_insert((sample.published_ns, 0)).1 += 1;
    }
    let first = terrain.first_key_value().map_or(u64::MAX, |(sequence, _)| *sequence);
    for (index, event) in events.iter().enumerate() {
        let end_ns = events
            .get(index + 1)
            .map_or(event.at_ns + SETTLE_NS / 2, |next| next.at_ns);
        // A cycle that is under way when the fault comes is the fault's too.
        let start_ns = event.at_ns.saturating_sub(LATE_NS);
        let row = verdict.rows.entry((event.fault, event.stage)).or_default();
        row.faults += 1;
        let span = |at_ns: u64| (start_ns..end_ns.saturating_sub(LATE_NS)).contains(&at_ns);
        for (sequence, sent_ns) in seen
            .frames
            .iter()
            .filter(|(sequence, at_ns)| **sequence >= first && span(**at_ns))
        {
            row.expected += 1;
            if let Some((published_ns, times)) = terrain.get(sequence) {
                row.published += 1;
                row.doubled += times - 1;
                row.late += u64::from(published_ns.saturating_sub(*sent_ns) > LATE_NS);
            }
        }
        let inside = |header: &&Header| (start_ns..end_ns).contains(&header.published_ns);
        let after: Vec<u64> = seen
            .terrain
            .iter()
            .filter(inside)
            .map(|header| header.published_ns)
            .collect();
        let gaps = after.windows(2).map(|pair| pair[1].saturating_sub(pair[0]));
        row.gaps_ms.extend(gaps.max().map(|gap_ns| gap_ns as f64 / 1e6));
        let before = seen.soil.iter().rfind(|sample| sample.header.published_ns < start_ns);
        let next = seen.soil.iter().find(|sample| sample.header.published_ns > event.at_ns);
        if let Some((before, next)) = of_one_soil(before, next) {
            row.started_over += u64::from(next.rows < before.rows || !next.cohesion_pa.is_finite());
            row.moved += u64::from(has_moved(before, next));
        }
    }
    verdict
}

/// Both estimates, where the soil is the same and the one before was sound.
fn of_one_soil<'a>(before: Option<&'a Soil>, next: Option<&'a Soil>) -> Option<(&'a Soil, &'a Soil)> {
    before
        .zip(next)
        .filter(|(before, next)| before.header.status == Status::OK && before.resets == next.resets)
}

fn has_moved(before: &Soil, next: &Soil) -> bool {
    let off = |before: f64, next: f64, sigma: f64| (next - before).abs() > sigma;
    off(before.cohesion_pa, next.cohesion_pa, before.cohesion_sigma_pa)
        || off(before.friction_rad, next.friction_rad, before.friction_sigma_rad)
}

impl Verdict {
    /// The sum of all rows.
    #[must_use]
    pub fn total(&self) -> Row {
        self.rows.values().fold(Row::default(), |mut total, row| {
            total.faults += row.faults;
            total.expected += row.expected;
            total.published += row.published;
            total.late += row.late;
            total.doubled += row.doubled;
            total.started_over += row.started_over;
            total.moved += row.moved;
            total.gaps_ms.extend(&row.gaps_ms);
            total
        })
    }

    /// As a Markdown table.
    #[must_use]
    pub fn table(&self) -> String {
        let mut text = String::from(
            "| fault | stage | faults | cycles | published | late | lost | doubled | gap p50 / p99 / max ms | started over | moved |\n\
             |---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|\n",
        );
        let rows = self
            .rows
            .iter()
            .map(|((fault, stage), row)| (format!("{fault:?}"), *stage, row.clone()));
        for (fault, stage, row) in rows.chain([("all".into(), "", self.total())]) {
            let mut gaps = row.gaps_ms.clone();
            gaps.sort_by(f64::total_cmp);
            let at = |share: f64| {
                gaps.get((share * (gaps.len() as f64 - 1.0)).ceil() as usize)
                    .copied()
                    .unwrap_or(0.0)
            };
            let _ = writeln!(
                text,
                "| {fault} | {stage} | {} | {} | {} | {} | {} | {} | {:.0} / {:.0} / {:.0} | {} | {} |",
                row.faults,
                row.expected,
                row.published,
                row.late,
                row.lost(),
                row.doubled,
                at(0.5),
                at(0.99),
                at(1.0),
                row.started_over,
                row.moved
            );
        }
        let [before, after] = self.held;
        let _ = writeln!(
            text,
            "\nThe launcher's descriptors, files in shared memory, resident KiB: {before:?} before, {after:?} after. Left \
             after the end: {} files, {} processes; exit code {}.",
            self.left[0],
            self.left[1],
            self.code.map_or("none".into(), |code| code.to_string())
        );
        text
    }
}
