//! What a system creates is its user's alone: another user can neither read it nor write it, and no network hears of it.

use crate::recording::Traverse;
use crate::rover::{Rover, program, traces};
use std::collections::BTreeSet;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Nobody, on every Linux.
const STRANGER: u32 = 65_534;

/// Tries everything on every path it is given, and says what it was allowed. What has gone by then it must not make anew.
const INTRUSION: &str = r#"for path in "$@"; do
    (: < "$path") 2>/dev/null && echo "reads $path"
    dd if=/dev/null of="$path" conv=nocreat,notrunc 2>/dev/null && echo "writes $path"
    (ls "$path/") >/dev/null 2>&1 && echo "lists $path"
    (: > "$path/stranger") 2>/dev/null && echo "adds to $path"
    (mv "$path" "$path.moved") 2>/dev/null && echo "moves $path"
done
true"#;

/// What another user may do with these files. Who is not root cannot become another user; then the modes have to do.
fn allowed_to_a_stranger(paths: &[PathBuf]) -> Vec<String> {
    if !rustix::process::geteuid().is_root() {
        eprintln!("not root: no other user tries; only modes are looked at");
        return Vec::new();
    }
    let mut stranger = Command::new("/bin/sh");
    stranger.args(["-c", INTRUSION, "sh"]).args(paths);
    let output = stranger.uid(STRANGER).gid(STRANGER).current_dir("/").output().unwrap();
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout)
        .unwrap()
        .lines()
        .map(str::to_owned)
        .collect()
}

/// What a system has in shared memory that its modes leave open to others: what stands in a closed folder is closed.
fn left_open_by_mode(name: &str) -> Vec<String> {
    let paths = traces(name).into_iter().map(|file| Path::new("/dev/shm").join(file));
    // What is gone by now is closed, too.
    let open =
        |path: &PathBuf| std::fs::symlink_metadata(path).is_ok_and(|about| about.permissions().mode() & 0o077 != 0);
    paths.filter(open).map(|path| path.display().to_string()).collect()
}

/// All files of a system in shared memory, those in its folder included.
fn files(name: &str) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = traces(name)
        .iter()
        .map(|file| Path::new("/dev/shm").join(file))
        .collect();
    let mut next = 0;
    while let Some(path) = files.get(next).cloned() {
        next += 1;
        let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
        files.extend(entries.map(|entry| entry.path()));
    }
    files
}

/// The sockets of a process that others than its user, or other machines, could reach.
fn reachable_sockets(pid: u32, folder: &str) -> Vec<String> {
    let read = |file: &str| std::fs::read_to_string(format!("/proc/{pid}/net/{file}")).unwrap_or_default();
    let local = read("unix");
    // The last column is the path; a socket without a name is known to nobody.
    let closed: BTreeSet<&str> = local
        .lines()
        .map(|line| line.split_whitespace().collect::<Vec<_>>())
        .filter(|columns| columns.get(7).is_none_or(|path| path.starts_with(folder)))
        .filter_map(|columns| columns.get(6).copied())
        .collect();
    let targets = std::fs::read_dir(format!("/proc/{pid}/fd")).unwrap().flatten();
    let targets =
        targets.filter_map(|entry| Some(std::fs::read_link(entry.path()).ok()?.to_string_lossy().into_owned()));
    let is_reachable = |inode: &str| !closed.contains(inode);
    targets
        .filter(|target| {
            let inode = target.strip_prefix("socket:[").and_then(|rest| rest.strip_suffix(']'));
            inode.is_some_and(is_reachable)
        })
        .map(|target| format!("{pid}: {target}"))
        .collect()
}

#[test]
fn a_stranger_finds_what_is_left_open() {
    let folder = tempfile::tempdir_in("/dev/shm").unwrap();
    std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(0o777)).unwrap();
    let open = folder.path().join("open");
    std::fs::write(&open, "x").unwrap();
    std::fs::set_permissions(&open, std::fs::Permissions::from_mode(0o666)).unwrap();
    if rustix::process::geteuid().is_root() {
        let told = allowed_to_a_stranger(&[folder.path().to_path_buf(), open.clone()]).join("\n");
        for (word, path) in [
            ("lists", folder.path()),
            ("adds to", folder.path()),
            ("reads", &open),
            ("writes", &open),
            ("moves", &open),
        ] {
            assert!(told.contains(&format!("{word} {}", path.display())), "{word}: {told}");
        }
    }
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    assert_eq!(reachable_sockets(std::process::id(), "/nowhere").len(), 1);
    drop(listener);
}

#[test]
fn another_user_can_do_nothing_with_a_running_system_and_no_network_reaches_it() {
    let mut rover = Rover::new(|text| text);
    rover.up();
    let files = files(&rover.name);
    assert!(files.len() > 20, "{files:?}");
    assert_eq!(left_open_by_mode(&rover.name), [""; 0]);
    assert_eq!(allowed_to_a_stranger(&files), [""; 0]);
    let launcher = rover.launcher.as_ref().unwrap().id();
    let folder = format!("/dev/shm/terrasense-{}", rover.name);
    for pid in rover.pids().into_iter().chain([launcher]) {
        assert_eq!(reachable_sockets(pid, &folder), [""; 0]);
    }
    assert_eq!(rover.down(), Some(0), "{}", rover.log());
}

/// A user of the machine who is neither root nor the stranger.
const USER: u32 = 65_533;

/// What `up` says, run by an ordinary user, of what a stranger has prepared at a path of the system's.
fn prepared_by_a_stranger(prepare: &str, path: &str) -> (Option<i32>, String) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
    let name = format!("p{}", std::process::id());
    let text =
        format!("[system]\nname = \"{name}\"\n[service.camera]\nexec = [\"sleep\"]\noutputs = {{ frames = \"f\" }}\n");
    let (copy, system) = (folder.path().join("terrasense"), folder.path().join("rover.toml"));
    std::fs::copy(program("terrasense"), &copy).unwrap();
    std::fs::write(&system, text).unwrap();
    let home = folder.path().join("home");
    std::fs::create_dir(&home).unwrap();
    std::os::unix::fs::chown(&home, Some(USER), None).unwrap();
    let path = format!("/dev/shm/terrasense-{name}{path}");
    let stranger = Command::new("/bin/sh")
        .args(["-c", prepare, "sh", &path])
        .arg(&home)
        .uid(STRANGER)
        .gid(STRANGER)
        .status();
    assert!(stranger.unwrap().success());
    let output = Command::new(copy)
        .arg("up")
        .arg(system)
        .uid(USER)
        .gid(USER)
        .output()
        .unwrap();
    let _ = std::fs::remove_file(&path);
    let _ = std::fs::remove_dir_all(&path);
    assert_eq!(
        std::fs::read_dir(&home).unwrap().count(),
        0,
        "something was written into the user's own folder"
    );
    (
        output.status.code(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

#[test]
fn what_a_stranger_has_prepared_under_the_systems_name_is_not_touched() {
    if !rustix::process::geteuid().is_root() {
        eprintln!("not root: nobody can be another user");
        return;
    }
    for (prepare, path) in [
        ("ln -s \"$2\" \"$1\"", ""),
        ("mkdir -m 777 \"$1\"", ""),
        ("ln -s \"$2/lock\" \"$1\"", ".lock"),
        (": > \"$1\" && chmod 666 \"$1\"", ".lock"),
    ] {
        let (code, text) = prepared_by_a_stranger(prepare, path);
        assert_eq!(code, Some(69), "{prepare}: {text}");
        assert!(text.contains(": another user has made it; "), "{prepare}: {text}");
    }
}

#[test]
fn another_user_can_do_nothing_with_a_replay() {
    let traverse = Traverse::with_pictures(4);
    let mut replay = Command::new(program("terrasense"))
        .args(["replay", traverse.folder.path().to_str().unwrap(), "--out"])
        .arg(traverse.path("out"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let name = format!("replay_{}", replay.id());
    let mut most = 0;
    let code = loop {
        if let Some(status) = replay.try_wait().unwrap() {
            break status.code();
        }
        let files = files(&name);
        // Before its services there is nothing of it to be seen.
        if !files.iter().any(|path| path.ends_with("camera.generation")) {
            continue;
        }
        assert_eq!(left_open_by_mode(&name), [""; 0]);
        assert_eq!(allowed_to_a_stranger(&files), [""; 0]);
        most = most.max(files.len());
    };
    assert_eq!(code, Some(0));
    assert!(most > 20, "{most} files seen");
}
