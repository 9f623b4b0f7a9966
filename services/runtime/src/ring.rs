//! Bare rings: three processes that pass the pipeline's bytes around and do nothing else.
//!
//! They are the baselines of the benchmarks. One uses the pipeline's own transport: the same topics, messages and
//! yielding in the same order, but no work and no checks. The others use pipes or sockets, whichever the processes
//! were given as standard input and output, and block in the kernel.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::AsFd;
use std::thread::yield_now;

use anyhow::Result;
use ipc_types::{Command, Message, Odometry, RawCommand};

use crate::clock::now_ns;
use crate::periods::Periods;
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

/// Runs one process of the ring over the pipeline's transport; the others end when killed. The first one
/// prints nanoseconds a round: mean, median and 99th percentile.
///
/// # Errors
/// If the process was not started by an orchestrator, or the transport fails.
pub fn run(hop: Hop) -> Result<()> {
    let attachment = Attachment::from_env()?;
    attachment.tie_to_parent()?;
    attachment.take_place();
    let bus = Bus::attach(&attachment.names, attachment.max_len)?;
    let len = attachment.max_len;
    match hop {
        Hop::First { rounds } => {
            let (outlet, inlet) = (bus.outlet::<Odometry>()?, bus.inlet::<Command>()?);
            measure(rounds, |round| {
                send(&outlet, len)?;
                let mut looks = 0u32;
                while inlet.receive()?.is_none() {
                    looks += 1;
                    // The other processes may have joined after the first message.
                    if round == 0 && looks.is_multiple_of(1000) {
                        send(&outlet, len)?;
                    }
                    yield_now();
                }
                Ok(())
            })
        }
        Hop::Second => {
            pass_on(&bus.inlet::<Odometry>()?, &bus.outlet::<RawCommand>()?, len, |_| {})
        }
        Hop::Third => {
            // Otherwise the ring would often run in the order that takes two rounds of the scheduler.
            let mut order = RingOrder::new(attachment.names.run);
            let note = |late| order.note(late);
            pass_on(&bus.inlet::<RawCommand>()?, &bus.outlet::<Command>()?, len, note)
        }
    }
}

/// Runs one process of a ring over standard input and output, with the bytes of one vehicle's messages. The
/// first one prints to standard error what [`run`] prints.
///
/// # Errors
/// If the process was not started by an orchestrator, or a neighbour is gone.
pub fn run_over_streams(hop: Hop) -> Result<()> {
    let attachment = Attachment::from_env()?;
    attachment.tie_to_parent()?;
    attachment.take_place();
    let mut input = File::from(io::stdin().as_fd().try_clone_to_owned()?);
    let mut output = File::from(io::stdout().as_fd().try_clone_to_owned()?);
    let (odometry, raw_command, command) =
        (bytes_of::<Odometry>(), bytes_of::<RawCommand>(), bytes_of::<Command>());
    let mut relay = |mut taken: Vec<u8>, sent: Vec<u8>| -> Result<()> {
        loop {
            input.read_exact(&mut taken)?;
            output.write_all(&sent)?;
        }
    };
    match hop {
        Hop::First { rounds } => {
            let mut taken = command;
            measure(rounds, |_| {
                output.write_all(&odometry)?;
                Ok(input.read_exact(&mut taken)?)
            })
        }
        Hop::Second => relay(odometry, raw_command),
        Hop::Third => relay(raw_command, command),
    }
}

/// As many bytes as a message of one vehicle has, header included.
fn bytes_of<M: Message>() -> Vec<u8> {
    vec![0; size_of::<M::Header>() + size_of::<M>()]
}

fn measure(rounds: u64, mut round_trip: impl FnMut(u64) -> Result<()>) -> Result<()> {
    let mut periods = Periods::default();
    for round in 0..WARM_UP + rounds {
        round_trip(round)?;
        if round + 1 >= WARM_UP {
            periods.note(now_ns());
        }
    }
    // Standard output may be the ring itself.
    eprintln!("{}", periods.summary());
    Ok(())
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
