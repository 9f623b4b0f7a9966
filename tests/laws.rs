//! Each law by the clock: its controller is killed on the way, and the successor goes on from what the law knew.

mod support;

use std::time::Duration;

use ipc_types::Safety;
use rustix::process::Signal;
use support::Sandbox;
use support::onlooker::{Onlooker, ROUNDABOUT};

/// Time from the start until the car is well on the arc and its steering at rest.
const SETTLED: Duration = Duration::from_secs(8);

/// Kills the controller of a car on an arc whose steering answers late, PATHTUNE_LAW_KILLS times. The successor's first
/// steering angle may differ from its predecessor's last one by at most `departure_rad`. Without what its law knew, the
/// successor's filter would begin at straight wheels, 0.16 rad away.
fn survives_kills(law: &str, gains: &str, departure_rad: f64) {
    let kills: usize = std::env::var("PATHTUNE_LAW_KILLS").map_or(1, |text| text.parse().unwrap());
    let sandbox = Sandbox::new();
    let args = [
        ROUNDABOUT,
        &["--realtime", "--vehicle", "tesla_model_3_guarded", "--law", law, "--gains", gains],
        &["--set", "vehicle.steering_delay_s=0.1", "--set", "vehicle.steering_lag_s=0.1"],
        &["--set", "controller.compensate_dead_time=true"],
    ]
    .concat();
    let mut drive = sandbox.start("drive", "out", &args);
    drive.wait_for("the run", || sandbox.has_living_run());
    let mut onlooker = Onlooker::new(&sandbox.living_run());
    onlooker.until_it_drives();
    onlooker.look_for(SETTLED);
    let (mut worst_rad, mut judged): (f64, usize) = (0.0, 0);
    for _ in 0..kills {
        onlooker.look_for(Duration::from_secs(1));
        let stopped = onlooker.until_it_drives();
        if stopped {
            onlooker.look_for(SETTLED);
        }
        let pid = sandbox.service("controller").unwrap();
        onlooker.strike("controller", pid, Signal::KILL);
        onlooker.look_until("the successor's first command", |it| it.raw_again.is_some());
        // A successor that a busy machine has kept for too long finds the car stopping, its wheels straightened.
        if onlooker.state <= Safety::DEGRADED {
            let [before, again] = [onlooker.raw, onlooker.raw_again].map(|it| it.unwrap());
            worst_rad = worst_rad.max((again.steering_rad - before.steering_rad).abs());
            judged += 1;
        }
    }
    println!(
        "{law}: {kills} kills, {judged} before the car had to stop: the successor asked for at most {worst_rad:.4} rad more or less; at most {:.4} rad in a tick; off the path at most {:.2} m",
        onlooker.step_rad, onlooker.off_path_m
    );
    assert!(worst_rad < departure_rad, "{law}: {worst_rad} rad");
    // The gate's limit is 0.6 rad/s; a tick has 0.01 s.
    assert!(onlooker.step_rad < 0.006 + 1e-9, "{law}: {} rad in a tick", onlooker.step_rad);
    drop(onlooker);
    drive.interrupt();
    drive.finish();
    sandbox.assert_clean();
}

/// One test for each law, with parameters whose filter makes what the law knows matter.
macro_rules! laws {
    ($($name:ident: $gains:literal, $departure_rad:expr);+ $(;)?) => {
        $(#[test]
        fn $name() {
            survives_kills(stringify!($name), $gains, $departure_rad);
        })+
    };
}

laws! {
    // It turns the reference's heading into 21 times its angle, and the reference has moved on while nobody answered: the
    // gate alone bounds what it asks for.
    paper: "3,21,21,0.98", f64::INFINITY;
    stanley: "1,1,1,0.95", 0.04;
    pure_pursuit: "1,2,0.8,0.95", 0.04;
    lqr: "1,1,1,0.1", 0.04;
    mpc: "1,1,1,0.1,2", 0.04;
}
