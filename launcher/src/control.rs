//! How `swap` and `apply` reach a running launcher: a socket in the system's folder, a line of JSON each way.

use crate::rehearsal::{Counts, Difference};
use serde::{Deserialize, Serialize};
use shell::{Error, now_ns};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The socket's name in the system's folder.
const SOCKET: &str = "control";
/// Bytes of a request at the most.
const REQUEST_MAX: usize = 1 << 20;
/// Time that a request may take to come in whole [ns]. Others wait.
const REQUEST_MAX_NS: u64 = 1_000_000_000;
/// The longest the launcher waits for a caller to take its answer.
const TELL_MAX: Duration = Duration::from_millis(20);

/// Another program, or another configuration, for a service.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SwapRequest {
    /// The service.
    pub service: String,
    /// Its new program and first arguments.
    pub exec: Vec<String>,
    /// Its new `config`, as TOML; none: as it is.
    pub config: Option<String>,
    /// Cycles to compare before the candidate is promoted.
    pub cycles: u64,
    /// Whether to stop after the comparison.
    pub dry_run: bool,
    /// Time within which the death of the candidate brings the incumbent back.
    pub probation_ms: u64,
    /// Largest allowed RMS difference of a field, by its name.
    pub require: Vec<(String, f64)>,
}

/// What the launcher says.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reply {
    /// What is going on.
    Progress(String),
    /// The candidate has been compared.
    Rehearsed(Rehearsed),
    /// Promoted: the first cycle that the candidate answers.
    Promoted(u64),
    /// The incumbent stays, as was asked for.
    Stays,
    /// The incumbent stays, and why.
    Refused(String),
}

/// What the comparison found.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Rehearsed {
    /// The service.
    pub service: String,
    /// What was counted.
    #[serde(flatten)]
    pub counts: Counts,
    /// From the triggering sample to the answer, median and 99th percentile [µs]: the incumbent's.
    pub incumbent_latency_us: [f64; 2],
    /// The same of the candidate.
    pub candidate_latency_us: [f64; 2],
    /// The fields.
    pub fields: Vec<(String, Difference)>,
}

/// The launcher's end.
#[derive(Debug)]
pub struct Ear {
    listener: UnixListener,
    /// Who is speaking, what they have said so far, and since when [ns].
    speaking: Option<(UnixStream, Vec<u8>, u64)>,
}

/// Who has asked, and is waiting.
#[derive(Debug)]
pub struct Caller(UnixStream);

impl Ear {
    /// Makes the socket in the system's folder, which only its user can enter.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn open(folder: &Path) -> Result<Self, Error> {
        let path = folder.join(SOCKET);
        let failed = |error: std::io::Error| Error::unavailable(format!("{}: {error}", path.display()));
        let listener = UnixListener::bind(&path).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        Ok(Self {
            listener,
            speaking: None,
        })
    }

    /// The next request that has come in whole. Never waits.
    pub fn next(&mut self) -> Option<(SwapRequest, Caller)> {
        if self.speaking.is_none() {
            let (stream, _) = self.listener.accept().ok()?;
            stream.set_nonblocking(true).ok()?;
            self.speaking = Some((stream, Vec::new(), now_ns()));
        }
        let (mut stream, mut said, since_ns) = self.speaking.take()?;
        let mut bytes = [0; 4096];
        loop {
            match stream.read(&mut bytes) {
                Ok(0) => return None,
                Ok(count) => said.extend_from_slice(&bytes[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(_) => return None,
            }
            if said.len() > REQUEST_MAX {
                return None;
            }
        }
        if said.last() != Some(&b'\n') {
            if now_ns() - since_ns < REQUEST_MAX_NS {
                self.speaking = Some((stream, said, since_ns));
            }
            return None;
        }
        stream.set_nonblocking(false).ok()?;
        stream.set_write_timeout(Some(TELL_MAX)).ok()?;
        let mut caller = Caller(stream);
        match serde_json::from_slice(&said) {
            Ok(request) => Some((request, caller)),
            Err(error) => {
                caller.tell(&Reply::Refused(format!("the launcher does not understand: {error}")));
                None
            }
        }
    }
}

impl Caller {
    /// Says something; false where nobody listens any more.
    pub fn tell(&mut self, reply: &Reply) -> bool {
        let line = serde_json::to_string(reply).unwrap_or_default() + "\n";
        self.0.write_all(line.as_bytes()).is_ok()
    }
}

/// Asks the launcher of a system, and hands over what it says until it is done.
///
/// # Errors
/// No launcher answers, or it ends in between.
pub fn ask(name: &str, request: &SwapRequest, mut on_reply: impl FnMut(Reply)) -> Result<(), Error> {
    let path = PathBuf::from(format!("/dev/shm/terrasense-{name}")).join(SOCKET);
    let failed = |error: &dyn std::fmt::Display| {
        Error::unavailable(format!(
            "no system `{name}` runs ({}: {error}); start it with `terrasense up` (names: --name)",
            path.display()
        ))
    };
    let mut stream = UnixStream::connect(&path).map_err(|error| failed(&error))?;
    let line = serde_json::to_string(request).map_err(|error| Error::internal(error.to_string()))? + "\n";
    stream.write_all(line.as_bytes()).map_err(|error| failed(&error))?;
    for line in BufReader::new(stream).lines() {
        let line = line.map_err(|error| failed(&error))?;
        let reply: Reply = serde_json::from_str(&line).map_err(|error| failed(&error))?;
        let is_last = !matches!(reply, Reply::Progress(_) | Reply::Rehearsed(_));
        on_reply(reply);
        if is_last {
            return Ok(());
        }
    }
    Err(Error::unavailable(format!("the launcher of `{name}` has ended")))
}
