//! `pathtune rearm`: lets a vehicle that was stopped drive again.

use std::time::{Duration, Instant};

use ipc_types::{Attempt, BatchHeader, Rearm, Safety, has};
use runtime::clock::now_ns;
use runtime::observer::Observer;

use crate::pipeline::main_loop::describe_reasons;
use crate::runs::living_run;
use crate::words::Failure;
use crate::words::terminal::say;

/// The supervisor reports its state with every command: it answers within this time, or not at all.
const ANSWERS_WITHIN: Duration = Duration::from_secs(2);
const LOOK_EVERY: Duration = Duration::from_millis(5);

/// Lets one stopped vehicle of a living run drive again, or all of them.
///
/// # Errors
/// If `run` matches no run, if no vehicle is stopped, or if a vehicle is not allowed to drive, with the reason.
pub(crate) fn rearm(run: Option<&str>, vehicle: Option<u32>) -> Result<(), Failure> {
    let run = living_run(run)?;
    let observer = Observer::attach(&run.names).map_err(|why| Failure::User(why.to_string()))?;
    let states = observer.bus().observe::<Safety>()?;
    let rearms = observer.bus().outlet::<Rearm>()?;
    let until = Instant::now() + ANSWERS_WITHIN;
    let newest = || -> Result<Option<Vec<Safety>>, Failure> {
        Ok(states.receive_newest()?.map(|message| message.items().to_vec()))
    };
    let mut meant: Option<Vec<u32>> = None;
    let mut reasons = 0;
    loop {
        if let Some(states) = newest()? {
            match &meant {
                None => meant = Some(stopped(&states, vehicle)?),
                Some(slots) => {
                    let is_latched = |slot: &&u32| {
                        let state = states.get(**slot as usize).map(|it| it.state);
                        matches!(state, Some(Safety::STOPPING | Safety::STOPPED))
                    };
                    let latched = slots.iter().filter(is_latched);
                    reasons = latched.fold(0, |all, slot| all | states[*slot as usize].reasons);
                    if !slots.iter().any(|slot| is_latched(&slot)) {
                        for slot in slots {
                            say!("vehicle {slot} is rearmed");
                        }
                        return Ok(());
                    }
                }
            }
            if let Some(slots) = &meant {
                // Sent repeatedly: the supervisor obeys it only while the vehicle stands.
                let attempt = Attempt::between_batches(run.names.run);
                let header = BatchHeader { attempt, sent_ns: now_ns(), ..BatchHeader::default() };
                for slot in slots {
                    rearms.send(header, 1, |_| Rearm { slot: *slot, reserved: 0 })?;
                }
            }
        }
        if Instant::now() > until {
            let why = match meant {
                None => {
                    "the run's supervisor does not report a state: only vehicles that drive in real time are stopped and rearmed"
                }
                Some(_) if has(reasons, Safety::NO_LEG) => {
                    "the vehicle may not drive yet: no leg of the path within its reach fits its heading; bring it \
                     nearer to the path, and turn it the way that the path goes"
                }
                Some(_) => {
                    "the vehicle may not drive yet: it still moves, or its odometry is missing or implausible; see \
                     `pathtune monitor`"
                }
            };
            return Err(Failure::User(why.to_owned()));
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

/// The slots to rearm: those that are stopped or are being stopped.
fn stopped(states: &[Safety], vehicle: Option<u32>) -> Result<Vec<u32>, Failure> {
    let latched: Vec<u32> = (0..)
        .zip(states)
        .filter(|(slot, it)| {
            (it.state == Safety::STOPPED || it.state == Safety::STOPPING)
                && vehicle.is_none_or(|vehicle| vehicle == *slot)
        })
        .map(|(slot, it)| {
            tracing::info!(slot, reasons = describe_reasons(it.reasons), "stopped");
            slot
        })
        .collect();
    if latched.is_empty() {
        let which = vehicle.map_or("no vehicle".to_owned(), |slot| format!("vehicle {slot}"));
        let verb = if vehicle.is_some() { "is not stopped" } else { "is stopped" };
        return Err(Failure::User(format!("{which} {verb}: there is nothing to rearm")));
    }
    Ok(latched)
}
