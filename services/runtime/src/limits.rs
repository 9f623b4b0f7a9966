//! Limits of the system for a process, raised as far as they may be, and checked where too little would end in a crash.

use std::sync::Arc;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// The stack that a process needs; less overflows it. Twice what was found to suffice.
const STACK_BYTES: u64 = 512 << 10;
/// The usual stack: what is asked for where less is set.
const USUAL_STACK_BYTES: u64 = 8 << 20;
/// The files that a process of a run opens, each topic with several; twice what was found to suffice.
const FILES: u64 = 320;
/// What is asked for where less is set.
const USUAL_FILES: u64 = 4096;

/// How long a file of a run may become: the largest segment in shared memory, and most journals.
const FILE_BYTES: u64 = 64 << 20;

/// Raises the limits that are lower than usual, as far as this user may, for this process and its children. And a file that
/// becomes too long is an error, which can be told, in place of the end of the process.
pub fn raise() {
    let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default());
    for (resource, usual) in [(Resource::Stack, USUAL_STACK_BYTES), (Resource::Nofile, USUAL_FILES)]
    {
        let limits = getrlimit(resource);
        let wanted = limits.maximum.map_or(usual, |most| most.min(usual));
        if limits.current.is_some_and(|current| current < wanted) {
            // What is refused is found by the checks.
            let _ = setrlimit(resource, Rlimit { current: Some(wanted), ..limits });
        }
    }
}

/// Checks whether there is stack enough for anything at all.
///
/// # Errors
/// If there is not; the error says what to do.
pub fn check_stack() -> Result<(), String> {
    match getrlimit(Resource::Stack).current {
        Some(bytes) if bytes < STACK_BYTES => Err(format!(
            "the limit of the stack is {} KiB, and {} KiB are needed: ulimit -s {}",
            bytes >> 10,
            STACK_BYTES >> 10,
            USUAL_STACK_BYTES >> 10
        )),
        _ => Ok(()),
    }
}

/// Checks whether a process may open and write the files of a run.
///
/// # Errors
/// If it may not; the error says what to do.
pub fn check_files() -> Result<(), String> {
    match getrlimit(Resource::Nofile).current {
        Some(files) if files < FILES => Err(format!(
            "the limit of open files is {files}, and a run needs {FILES}: ulimit -n {USUAL_FILES}"
        )),
        _ => check_file_size(),
    }
}

fn check_file_size() -> Result<(), String> {
    match getrlimit(Resource::Fsize).current {
        Some(bytes) if bytes < FILE_BYTES => Err(format!(
            "the limit of a file's size is {} KiB, and {} KiB are needed: ulimit -f unlimited",
            bytes >> 10,
            FILE_BYTES >> 10
        )),
        _ => Ok(()),
    }
}
