//! A system of a bench's own: nothing of it is left when it is dropped.

use crate::Outcome;
use shell::SystemFile;
use std::os::unix::fs::DirBuilderExt;

/// A name, and so a folder and a prefix in shared memory, that no other system has.
#[derive(Debug)]
pub struct ScratchSystem(SystemFile);

impl ScratchSystem {
    /// Makes the folder.
    ///
    /// # Errors
    /// There is no space, or no shared memory.
    pub fn make() -> Outcome<Self> {
        let file = system_file(&format!("bench{}", std::process::id()))?;
        std::fs::DirBuilder::new().mode(0o700).create(file.root())?;
        Ok(Self(file))
    }

    /// Its system file, which holds nothing but the name.
    #[must_use]
    pub fn file(&self) -> &SystemFile {
        &self.0
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        self.0.system.name.get_ref()
    }

    /// The system file of a system of this name, which another process has made.
    ///
    /// # Errors
    /// The name is none.
    pub fn named(name: &str) -> Outcome<SystemFile> {
        system_file(name)
    }
}

impl Drop for ScratchSystem {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(self.0.root());
        let prefix = self.0.prefix();
        for entry in std::fs::read_dir("/dev/shm")
            .into_iter()
            .flatten()
            .filter_map(Result::ok)
        {
            let name = entry.file_name().to_string_lossy().into_owned();
            // The C library begins the files of semaphores so.
            if name.strip_prefix("sem.").unwrap_or(&name).starts_with(&prefix) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }
}

fn system_file(name: &str) -> Outcome<SystemFile> {
    Ok(SystemFile::parse("bench", &format!("[system]\nname = \"{name}\"\n"))?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::Wheel;
    use shell::{Domain, Port, Tap};

    #[test]
    fn a_scratch_system_carries_wires_and_leaves_nothing() {
        let system = ScratchSystem::make().unwrap();
        let prefix = format!("terrasense-{}", system.name());
        let domain = Domain::enter(system.file(), "bench").unwrap();
        let wire = domain.create("there", Port::Wheel).unwrap();
        Tap::<Wheel>::open(&domain, "there").unwrap();
        drop((wire, domain, system));
        let left = std::fs::read_dir("/dev/shm").unwrap().filter_map(Result::ok);
        assert_eq!(
            left.filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix))
                .count(),
            0
        );
    }
}
