//! What iceoryx2 leaves open to other users in shared memory, closed.

use shell::{Error, SystemFile};
use std::io::Write;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;

/// Makes every file of a system that others could open the user's own. To be called once the launcher has entered the
/// system, and before anything is started in it.
///
/// iceoryx2 counts a domain's nodes in a file that everybody may write: who cuts it short keeps services from starting. A
/// copy takes its place, not another mode: whoever has the old file open holds on to nothing.
pub fn close(system: &SystemFile) -> Result<(), Error> {
    let failed = |error: std::io::Error| Error::unavailable(format!("cannot close /dev/shm to other users: {error}"));
    let folder = Path::new(system.root().as_str())
        .parent()
        .map(Path::to_path_buf)
        .unwrap_or_default();
    for entry in std::fs::read_dir(folder).map_err(failed)?.flatten() {
        let (path, name) = (entry.path(), entry.file_name());
        let is_ours = name.to_str().is_some_and(|name| name.starts_with(&system.prefix()));
        let is_open = entry
            .metadata()
            .is_ok_and(|about| about.is_file() && about.mode() & 0o077 != 0);
        if !is_ours || !is_open {
            continue;
        }
        let bytes = std::fs::read(&path).map_err(failed)?;
        // Under the same prefix: should this process be killed here, it is removed with the rest.
        let copy = path.with_extension("closed");
        let mut options = std::fs::OpenOptions::new();
        let mut file = options
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(&copy)
            .map_err(failed)?;
        file.write_all(&bytes).map_err(failed)?;
        std::fs::rename(&copy, &path).map_err(failed)?;
    }
    Ok(())
}
