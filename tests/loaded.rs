//! A machine on which many others compute: slow, but not broken. In a file of its own, so that no other test suffers.

mod support;

use support::Sandbox;
use support::load::Load;

#[test]
fn a_loaded_machine_is_not_taken_for_a_frozen_process() {
    let sandbox = Sandbox::new();
    let args = ["lane_change", "--episodes", "1"];
    let calm = sandbox.train("calm", &args);
    // A training takes minutes beside eight a core; that is for runs by hand.
    let load = Load::each_core(1);
    let loaded = sandbox.train("loaded", &args);
    drop(load);
    assert_eq!(loaded["digest"], calm["digest"]);
    for process in loaded["processes"].as_array().unwrap() {
        assert_eq!(process["restarts"], 0, "{process}");
    }
    sandbox.assert_clean();
}
