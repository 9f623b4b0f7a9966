//! The table of our own services: all that `pathtune service NAME` can run. A new service is a new row here.

use std::time::Duration;

use anyhow::{Context, bail};
use config::launch::Role;
use orchestrator::pipeline::guardian::guard;
use orchestrator::pipeline::process::exec;
use orchestrator::words::Failure;
use orchestrator::{Service, Services, bench};
use runtime::clock::now_ns;
use runtime::ring::Hop;
use trainer::journal::JournalError;
use trainer::service::CannotBegin;

/// The first service in the table that can fill a role is the usual one for it.
pub(crate) const SERVICES: Services = Services(&[
    Service::new("simulator", Some(Role::Vehicle), |_| Ok(simulator::service::run()?)),
    Service::new("replayer", Some(Role::Vehicle), |words| {
        // Answers from a recording whatever drive is requested, instead of following the run's order.
        Ok(replayer::vehicle::run(words.first().map(AsRef::as_ref))?)
    }),
    Service {
        missing: if cfg!(feature = "ros2") {
            None
        } else {
            Some(
                "this build has no ros2-vehicle; build it with `cargo build --release --features ros2`",
            )
        },
        ..Service::new("ros2-vehicle", Some(Role::Vehicle), |_| drive_ros2())
    },
    Service::new("supervisor", Some(Role::Supervisor), |_| Ok(supervisor::service::run()?)),
    Service::new("controller", Some(Role::Controller), |_| Ok(controller::service::run()?)),
    Service::new("trainer", Some(Role::Trainer), |_| train()),
    Service::new("schedule", Some(Role::Trainer), |_| Ok(trainer::schedule::run()?)),
    Service::new("reviewer", Some(Role::Trainer), |_| Ok(replayer::reviewer::run()?)),
    Service::new("recorder", Some(Role::Recorder), |_| Ok(recorder::service::run()?)),
    // Removes dead nodes from the bus, and ends.
    Service::new("cleaner", None, |_| Ok(runtime::cleanup::run_helper()?)),
    // Wakes a frozen process after some milliseconds.
    Service::new("wake", None, |words| Ok(wake(words)?)),
    // Starts a user's program, and lets nothing of it outlive it.
    Service::new("guardian", None, |words| Ok(guard(words)?)),
    // Becomes a user's program.
    Service::new("exec", None, |words| Err(exec(words).into())),
    // For the benchmark: one process of the bare ring, the same over standard input and output, and plain calls.
    Service::new("ring", None, |words| Ok(runtime::ring::run(hop(words)?)?)),
    Service::new("stream-ring", None, |words| Ok(runtime::ring::run_over_streams(hop(words)?)?)),
    Service::new("calls", None, |words| Ok(time_calls(words)?)),
]);

/// A journal that cannot be gone on with is not mended by another start of the trainer, nor is a training with nothing to drive.
fn train() -> Result<(), Failure> {
    trainer::service::run().map_err(|error| {
        let is_final = error.downcast_ref().is_some_and(JournalError::is_final);
        match is_final || error.is::<CannotBegin>() {
            true => Failure::User(error.to_string()),
            false => Failure::Other(error),
        }
    })
}

fn drive_ros2() -> Result<(), Failure> {
    ros2_vehicle::run().map_err(|error| match error.downcast::<ros2_vehicle::Refused>() {
        Ok(refused) => Failure::User(refused.to_string()),
        Err(error) => Failure::Other(error),
    })
}

/// `wake PID MILLISECONDS`.
fn wake(words: &[String]) -> anyhow::Result<()> {
    let [pid, after_ms] = words else { bail!("wake takes a process id and milliseconds") };
    let after = Duration::from_millis(after_ms.parse().context("the milliseconds")?);
    runtime::chaos::wake_later(pid.parse().context("the process id")?, after);
    Ok(())
}

/// The place of a process in the bare ring: `first ROUNDS`, `second` or `third`.
fn hop(words: &[String]) -> anyhow::Result<Hop> {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words[..] {
        ["first", rounds] => Ok(Hop::First { rounds: rounds.parse().context("the rounds")? }),
        ["second"] => Ok(Hop::Second),
        ["third"] => Ok(Hop::Third),
        _ => bail!("a ring has the places first ROUNDS, second and third"),
    }
}

/// `calls [LAW]`: times plain calls over the grid that the benchmark's pipelines drive. Prints nanoseconds per tick to
/// standard error, as a ring does: the mean, and the median and 99th percentile over the drives.
fn time_calls(words: &[String]) -> anyhow::Result<()> {
    let law = words.first().map_or(bench::LAW, String::as_str);
    // A tick of another law may cost a thousand times as much.
    let sets = if law == bench::LAW { 512 } else { 16 };
    let mut layers = config::Layers::maneuver(bench::MANEUVER)?;
    for setting in bench::spread(law, sets)? {
        layers.set(&setting)?;
    }
    let config = layers.resolve()?;
    let grid = config.grid();
    let mut rollout = rollout::Rollout::new(&config);
    let mut ticks_ns: Vec<f64> = grid
        .positions()
        .map(|position| {
            let started_ns = now_ns();
            let drive = rollout.drive(grid.set(position), None);
            (now_ns() - started_ns) as f64 / drive.ticks as f64
        })
        .collect();
    ticks_ns.sort_by(f64::total_cmp);
    let mean_ns = ticks_ns.iter().sum::<f64>() / ticks_ns.len() as f64;
    let at = |share: f64| ticks_ns[((ticks_ns.len() - 1) as f64 * share) as usize];
    eprintln!("{mean_ns} {} {}", at(0.5), at(0.99));
    Ok(())
}
