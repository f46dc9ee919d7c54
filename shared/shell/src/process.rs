//! What a child process must be told between fork and exec, for which Rust has no safe words.

use std::os::unix::process::CommandExt;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Makes the child die with this process, however that ends, and gives it a process group of its own.
///
/// The thread that spawns must live as long as the child: the kernel watches the thread.
pub fn bind_to_parent(command: &mut Command) {
    let parent = rustix::process::getpid();
    let before_exec = move || {
        rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL))?;
        // The parent may have died before the kernel was told.
        if rustix::process::getppid() != Some(parent) {
            return Err(rustix::io::Errno::SRCH.into());
        }
        Ok(())
    };
    command.process_group(0);
    // SAFETY: between fork and exec only async-signal-safe calls are allowed: prctl and getppid are system calls without
    // locks, and nothing is allocated.
    #[allow(unsafe_code)]
    unsafe {
        command.pre_exec(before_exec);
    }
}

/// Lets the end of a child end this process's sleep, and set this flag: what is to be done about it is done at once.
///
/// # Errors
/// The system refuses to take a handler.
pub fn wake_when_children_end() -> std::io::Result<Arc<AtomicBool>> {
    let ended = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(signal_hook::consts::SIGCHLD, ended.clone())?;
    Ok(ended)
}

/// Keeps every descriptor that is open now, but for standard input, output and error, from being inherited.
pub fn harden_descriptors() {
    let Ok(entries) = std::fs::read_dir("/proc/self/fd") else {
        return;
    };
    let numbers = entries.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse::<i32>().ok());
    for number in numbers.filter(|number| *number > 2).collect::<Vec<_>>() {
        // SAFETY: the descriptor is only borrowed for one call, which fails harmlessly where it is closed by now.
        #[allow(unsafe_code)]
        let descriptor = unsafe { std::os::fd::BorrowedFd::borrow_raw(number) };
        let _ = rustix::io::fcntl_setfd(descriptor, rustix::io::FdFlags::CLOEXEC);
    }
}
