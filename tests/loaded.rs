//! A machine on which many others compute: slow, but not broken. In a file of its own, so that no other test suffers.

mod support;

use std::process::{Child, Command};

use support::Sandbox;

/// Processes that keep every core busy, until this is dropped.
struct Load(Vec<Child>);

impl Load {
    fn of(processes: usize) -> Self {
        let busy = || Command::new("sh").args(["-c", "while :; do :; done"]).spawn().unwrap();
        Self((0..processes).map(|_| busy()).collect())
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

#[test]
fn a_loaded_machine_is_not_taken_for_a_frozen_process() {
    let sandbox = Sandbox::new();
    let args = ["lane_change", "--episodes", "1"];
    let calm = sandbox.train("calm", &args);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    // A training takes minutes beside eight a core; that is for runs by hand.
    let each: usize = std::env::var("PATHTUNE_LOAD").map_or(1, |text| text.parse().unwrap());
    let load = Load::of(each * cores);
    let loaded = sandbox.train("loaded", &args);
    drop(load);
    assert_eq!(loaded["digest"], calm["digest"]);
    for process in loaded["processes"].as_array().unwrap() {
        assert_eq!(process["restarts"], 0, "{process}");
    }
    sandbox.assert_clean();
}
