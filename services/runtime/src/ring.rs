//! A bare ring: three processes that pass the pipeline's bytes around and do nothing else.
//!
//! The baseline of the benchmarks: same transport, same topics, same messages, same yielding in the same order, no work, no
//! clock, no checks.

use std::thread::yield_now;

use anyhow::Result;
use ipc_types::{Command, Message, Odometry, RawCommand};

use crate::clock::now_ns;
use crate::serve::RingOrder;
use crate::{Attachment, Bus, Inlet, Outlet};

/// Rounds before the clock starts.
const WARM_UP: u64 = 2_000;

/// The place of a process in the ring.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hop {
    /// Starts each round, and measures; stops after `rounds`.
    First {
        /// Rounds to be measured.
        rounds: u64,
    },
    /// Answers the first.
    Second,
    /// Answers the second.
    Third,
}

/// Runs one process of the ring; the first one prints nanoseconds per round, and the others end when killed.
///
/// # Errors
/// If the process was not started by an orchestrator, or the transport fails.
pub fn run(hop: Hop) -> Result<()> {
    let attachment = Attachment::from_env()?;
    attachment.tie_to_parent()?;
    attachment.pin();
    let bus = Bus::attach(&attachment.names, attachment.max_len)?;
    let len = attachment.max_len;
    match hop {
        Hop::First { rounds } => {
            let (outlet, inlet) = (bus.outlet::<Odometry>()?, bus.inlet::<Command>()?);
            let mut start_ns = 0;
            for round in 0..WARM_UP + rounds {
                if round == WARM_UP {
                    start_ns = now_ns();
                }
                send(&outlet, len)?;
                let mut looks = 0u32;
                while inlet.receive()?.is_none() {
                    looks += 1;
                    // The others may have come later than the first message.
                    if round == 0 && looks.is_multiple_of(1000) {
                        send(&outlet, len)?;
                    }
                    yield_now();
                }
            }
            println!("{}", (now_ns() - start_ns) as f64 / rounds as f64);
            Ok(())
        }
        Hop::Second => {
            pass_on(&bus.inlet::<Odometry>()?, &bus.outlet::<RawCommand>()?, len, |_| {})
        }
        Hop::Third => {
            // Else the ring would often run in the order that takes two rounds of the scheduler.
            let mut order = RingOrder::new(attachment.names.run);
            let note = |late| order.note(late);
            pass_on(&bus.inlet::<RawCommand>()?, &bus.outlet::<Command>()?, len, note)
        }
    }
}

fn pass_on<A: Message, B: Message>(
    inlet: &Inlet<A>,
    outlet: &Outlet<B>,
    len: usize,
    mut note: impl FnMut(bool),
) -> Result<()> {
    let mut late = false;
    loop {
        if inlet.receive()?.is_some() {
            send(outlet, len)?;
            note(late);
            late = false;
        } else {
            late = true;
        }
        yield_now();
    }
}

fn send<M: Message>(outlet: &Outlet<M>, len: usize) -> Result<()> {
    outlet.send_quietly(M::Header::default(), len, |_| M::default())?;
    Ok(())
}
