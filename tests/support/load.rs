//! Others that compute on the same machine.

use std::process::{Child, Command};

/// Processes that keep the cores busy, until this is dropped.
pub struct Load(Vec<Child>);

impl Load {
    /// As many as `PATHTUNE_LOAD` says for each core; otherwise as many as are given.
    pub fn each_core(otherwise: usize) -> Self {
        let each =
            std::env::var("PATHTUNE_LOAD").map_or(otherwise, |number| number.parse().unwrap());
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let busy = || Command::new("sh").args(["-c", "while :; do :; done"]).spawn().unwrap();
        Self((0..each * cores).map(|_| busy()).collect())
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
