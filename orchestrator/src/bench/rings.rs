//! Bare rings and plain calls: what the pipeline is measured against.

use std::io::{Read, pipe};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use runtime::run::RunNames;
use runtime::{Attachment, Bus, Wait};

use super::Timing;
use crate::pipeline::cores::CoreClaim;

/// Rounds of a ring that are measured at a time.
const ROUNDS: u64 = 50_000;

/// What the messages of a ring travel over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Transport {
    /// The transport of the pipeline.
    SharedMemory,
    /// Anonymous pipes.
    Pipe,
    /// Unix stream sockets.
    UnixSocket,
}

/// A round of the ring of three processes on one core, with messages of `fleet` vehicles.
pub(super) fn ring(transport: Transport, fleet: usize) -> Result<Timing> {
    let names = RunNames::create()?;
    let result = ring_on(&names, transport, fleet);
    names.remove();
    result
}

fn ring_on(names: &RunNames, transport: Transport, fleet: usize) -> Result<Timing> {
    let claim = CoreClaim::unshared().or_else(CoreClaim::shared);
    let attachment = Attachment {
        names: names.clone(),
        folder: names.root.clone(),
        max_len: fleet,
        ring: 0,
        incarnation: 1,
        core: claim.as_ref().map(|claim| claim.core),
        wait: Wait::default(),
        fifo: None,
        parent: std::process::id() as i32,
        chaos: None,
    };
    let rounds = ROUNDS.to_string();
    let start = |service: &str, hop: &[&str], input: Stdio, output: Stdio| -> Result<Killed> {
        let mut command = Command::new("/proc/self/exe");
        attachment.give_to(&mut command);
        let child = command
            .arg0("pathtune")
            .args(["service", service])
            .args(hop)
            .process_group(0)
            .stdin(input)
            .stdout(output)
            .stderr(Stdio::piped())
            .spawn()?;
        Ok(Killed(child))
    };
    let first = ["first", rounds.as_str()];
    if transport == Transport::SharedMemory {
        let _bus = Bus::create(names, fleet)?;
        let none = || (Stdio::null(), Stdio::null());
        let start = |hop: &[&str]| start("ring", hop, none().0, none().1);
        // The first process of the ring starts last, and a moment later: by then the ports of the others exist.
        let _others = [start(&["second"])?, start(&["third"])?];
        std::thread::sleep(Duration::from_millis(50));
        return start(&first)?.timing();
    }
    let links = [transport.link()?, transport.link()?, transport.link()?];
    let [(from_first, to_second), (from_second, to_third), (from_third, to_first)] = links;
    let start = |hop: &[&str], input: OwnedFd, output: OwnedFd| {
        start("stream-ring", hop, input.into(), output.into())
    };
    let _others =
        [start(&["second"], to_second, from_second)?, start(&["third"], to_third, from_third)?];
    start(&first, to_first, from_first)?.timing()
}

impl Transport {
    /// The two ends of a link: the end for writing, and the end for reading.
    fn link(self) -> Result<(OwnedFd, OwnedFd)> {
        if self == Transport::UnixSocket {
            let (one, other) = UnixStream::pair()?;
            return Ok((one.into(), other.into()));
        }
        let (reader, writer) = pipe()?;
        Ok((writer.into(), reader.into()))
    }
}

/// A tick of one vehicle with this law by plain calls, in a process of its own, because this crate links no service.
pub(super) fn calls(law: &str) -> Result<Timing> {
    let child = Command::new("/proc/self/exe")
        .arg0("pathtune")
        .args(["service", "calls", law])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()?;
    Killed(child).timing()
}

/// A process that is killed when this is dropped.
pub(super) struct Killed(pub(super) Child);

impl Killed {
    /// The timing that the process prints at its end.
    fn timing(mut self) -> Result<Timing> {
        let mut text = String::new();
        self.0.stderr.take().context("no output")?.read_to_string(&mut text)?;
        ensure!(self.0.wait()?.success(), "a process of a ring failed: {}", text.trim());
        Timing::parse(&text)
    }
}

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
