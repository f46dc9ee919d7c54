//! A system's place on the tmpfs: whose it is, what starts there, and nothing left behind.

use rustix::fs::{FlockOperation, flock};
use shell::{Domain, Error, SystemFile, now_ns, sleep_until};
use std::fs::File;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

const SHARED_MEMORY: &str = "/dev/shm";
const NAME: &str = "terrasense-";
/// How long to wait for the processes of a killed launcher to be gone [ns].
const VACATE_MAX_NS: u64 = 2_000_000_000;

/// The right to run a system of this name, and its folder. Dropping it leaves nothing behind.
#[derive(Debug)]
pub struct Root {
    /// The folder.
    pub folder: PathBuf,
    prefix: String,
    lock_path: PathBuf,
    /// `CLOCK_MONOTONIC` [ns] at the start of the system.
    pub started_ns: u64,
    _lock: File,
}

impl Root {
    /// Takes the system's folder, after wiping what a killed launcher left there.
    ///
    /// # Errors
    /// A system of this name runs, or processes of it do, or the folder is another user's.
    pub fn take(system: &SystemFile) -> Result<Self, Error> {
        let name = system.system.name.get_ref();
        let lock_path = lock_path(name);
        let Some(lock) = try_lock(&lock_path)? else {
            return Err(Error::unavailable(format!(
                "a system `{name}` runs already; see it with `terrasense status --name {name}`, or give this one another \
                 name: [system] name = \"…\""
            )));
        };
        let (folder, prefix) = (system.root().into(), system.prefix());
        let root = Self {
            folder,
            prefix,
            lock_path,
            started_ns: now_ns(),
            _lock: lock,
        };
        if is_own_folder(&root.folder)? {
            root.vacated(system)?;
        }
        wipe(&root.folder, &root.prefix);
        let failed = |error| Error::unavailable(format!("cannot make {}: {error}", root.folder.display()));
        match std::fs::DirBuilder::new().mode(0o700).create(&root.folder) {
            // Somebody who asks for the status has been faster.
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
                is_own_folder(&root.folder)?;
                std::fs::set_permissions(&root.folder, std::fs::Permissions::from_mode(0o700)).map_err(failed)?;
            }
            made => made.map_err(failed)?,
        }
        root.write("started_ns", &root.started_ns.to_string())?;
        Ok(root)
    }

    /// Writes a small file into the folder and returns its path. Who reads it at the same time finds the old one or the new.
    ///
    /// # Errors
    /// There is no space.
    pub fn write(&self, file: &str, text: &str) -> Result<String, Error> {
        let path = self.folder.join(file);
        let failed = |error: std::io::Error| Error::unavailable(format!("{}: {error}", path.display()));
        let new = self.folder.join("new");
        std::fs::write(&new, text)
            .and_then(|()| std::fs::rename(&new, &path))
            .map_err(failed)?;
        Ok(path.display().to_string())
    }

    /// Copies a file of the folder, if it is there.
    pub fn copy(&self, from: &str, to: &str) {
        // What cannot be copied is as if it were not there.
        let _ = std::fs::remove_file(self.folder.join(to));
        let _ = std::fs::copy(self.folder.join(from), self.folder.join(to));
    }

    /// Gives a file of the folder another name. Who has it open keeps it.
    pub fn rename(&self, from: &str, to: &str) {
        let _ = std::fs::rename(self.folder.join(from), self.folder.join(to));
    }

    /// Waits until no process lives in the folder: those of a killed launcher are dying.
    fn vacated(&self, system: &SystemFile) -> Result<(), Error> {
        let last_ns = now_ns() + VACATE_MAX_NS;
        loop {
            let pids = Domain::inhabitants(system).unwrap_or_default();
            if pids.is_empty() {
                return Ok(());
            }
            if now_ns() > last_ns {
                let list = pids.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ");
                return Err(Error::unavailable(format!(
                    "processes of an earlier run still use {}; end them: kill {list}",
                    self.folder.display()
                )));
            }
            sleep_until(now_ns() + 10_000_000);
        }
    }
}

impl Drop for Root {
    fn drop(&mut self) {
        wipe(&self.folder, &self.prefix);
        let _ = std::fs::remove_file(&self.lock_path);
    }
}

/// A system of which something is in shared memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Trace {
    /// The system's name.
    pub name: String,
    /// Whether its launcher runs.
    pub runs: bool,
    /// Its files in shared memory.
    pub files: usize,
}

/// Every system of this user of which something is in shared memory.
#[must_use]
pub fn traces() -> Vec<Trace> {
    let mut names: Vec<String> = own_entries()
        .iter()
        .filter_map(|entry| {
            let rest = entry.file_name()?.to_str()?.strip_prefix(NAME)?;
            Some(rest.split(['-', '.']).next()?.to_owned())
        })
        .collect();
    names.sort();
    names.dedup();
    names
        .into_iter()
        .map(|name| Trace {
            runs: runs(&name),
            files: entries_of(&name).len(),
            name,
        })
        .collect()
}

/// Whether a system can be entered: its launcher runs and has made its folder.
#[must_use]
pub fn stands(name: &str) -> bool {
    runs(name)
        && Path::new(SHARED_MEMORY)
            .join(format!("{NAME}{name}/started_ns"))
            .exists()
}

/// Whether the launcher of a system runs.
fn runs(name: &str) -> bool {
    lock_path(name).exists()
        && File::open(lock_path(name)).is_ok_and(|file| flock(&file, FlockOperation::NonBlockingLockShared).is_err())
}

/// Removes what a killed launcher left; false where the system runs.
///
/// # Errors
/// The lock cannot be taken.
pub fn clean(name: &str) -> Result<bool, Error> {
    let path = lock_path(name);
    let Some(_lock) = try_lock(&path)? else {
        return Ok(false);
    };
    wipe(
        &Path::new(SHARED_MEMORY).join(format!("{NAME}{name}")),
        &format!("{NAME}{name}-"),
    );
    let _ = std::fs::remove_file(path);
    Ok(true)
}

/// True for a folder of this user, false where there is none. Everybody may make entries in `/dev/shm`: what is anything else,
/// a link above all, is not followed.
fn is_own_folder(path: &Path) -> Result<bool, Error> {
    match std::fs::symlink_metadata(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(false),
        Ok(about) if about.is_dir() && is_own(&about) => Ok(true),
        _ => Err(not_own(path)),
    }
}

fn is_own(about: &std::fs::Metadata) -> bool {
    about.uid() == rustix::process::geteuid().as_raw()
}

fn not_own(path: &Path) -> Error {
    Error::unavailable(format!(
        "{}: another user has made it; have it removed, or give the system another name: [system] name = \"…\"",
        path.display()
    ))
}

fn lock_path(name: &str) -> PathBuf {
    Path::new(SHARED_MEMORY).join(format!("{NAME}{name}.lock"))
}

/// The lock, `None` where another process holds it.
fn try_lock(path: &Path) -> Result<Option<File>, Error> {
    let failed = |error: std::io::Error| match std::fs::symlink_metadata(path) {
        Ok(about) if !is_own(&about) => not_own(path),
        _ => Error::unavailable(format!("{}: {error}", path.display())),
    };
    loop {
        let file = std::fs::OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .mode(0o600)
            .custom_flags(rustix::fs::OFlags::NOFOLLOW.bits().cast_signed())
            .open(path)
            .map_err(failed)?;
        if !file.metadata().is_ok_and(|about| is_own(&about)) {
            return Err(not_own(path));
        }
        if flock(&file, FlockOperation::NonBlockingLockExclusive).is_err() {
            return Ok(None);
        }
        // The last holder may have removed the file between our opening and our locking it.
        let same = |there: std::fs::Metadata| file.metadata().is_ok_and(|here| here.ino() == there.ino());
        if std::fs::metadata(path).is_ok_and(same) {
            return Ok(Some(file));
        }
    }
}

fn own_entries() -> Vec<PathBuf> {
    let entries = std::fs::read_dir(SHARED_MEMORY).into_iter().flatten();
    entries
        .filter_map(Result::ok)
        .filter(|entry| entry.metadata().is_ok_and(|about| is_own(&about)))
        .map(|entry| entry.path())
        .collect()
}

fn entries_of(name: &str) -> Vec<PathBuf> {
    let (whole, prefix) = (format!("{NAME}{name}"), format!("{NAME}{name}-"));
    let belongs = |file: &str| file == whole || file.starts_with(&prefix);
    own_entries()
        .into_iter()
        .filter(|path| path.file_name().and_then(|file| file.to_str()).is_some_and(belongs))
        .collect()
}

fn wipe(folder: &Path, prefix: &str) {
    let _ = std::fs::remove_dir_all(folder);
    for path in own_entries() {
        if path
            .file_name()
            .and_then(|file| file.to_str())
            .is_some_and(|file| file.starts_with(prefix))
        {
            let _ = std::fs::remove_file(path);
        }
    }
}
