//! `pathtune bench`: what a tick of the pipeline costs, beside a bare ring of the same bytes in the same run.

use std::io::Read;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, ensure};
use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, Table};
use config::Layers;
use config::launch::Launch;
use runtime::run::RunNames;
use runtime::{Attachment, Bus};
use serde_json::json;

use crate::Failure;
use crate::cli::BenchArgs;
use crate::cores::CoreClaim;
use crate::pipeline::{Interrupts, Plan};
use crate::restart::Budget;
use crate::terminal::{say, tell};
use crate::train::run;

/// Rounds of the ring that are measured at a time.
const RING_ROUNDS: u64 = 50_000;

/// Measures ring and pipeline in turn, several times, and prints medians.
///
/// # Errors
/// If a pipeline cannot be kept alive.
pub fn bench(args: &BenchArgs) -> Result<(), Failure> {
    let mut rows = Vec::new();
    for fleet in [1, 4, 16, 64] {
        let (mut ring, mut pipeline) = (Vec::new(), Vec::new());
        for round in 0..args.rounds {
            if !args.json {
                tell!("fleet of {fleet}: round {} of {}", round + 1, args.rounds);
            }
            ring.push(ring_ns(fleet)?);
            pipeline.push(pipeline_ns(fleet)?);
        }
        rows.push((format!("ring/iceoryx2/fleet={fleet}"), fleet, median(&mut ring)));
        rows.push((format!("pipeline/fleet={fleet}"), fleet, median(&mut pipeline)));
    }
    if args.json {
        let rows: Vec<_> = rows
            .iter()
            .map(|(name, fleet, ns)| {
                json!({
                    "name": name,
                    "tick_ns": ns,
                    "ticks_per_s": 1e9 / ns,
                    "vehicle_ticks_per_s": 1e9 / ns * *fleet as f64,
                })
            })
            .collect();
        say!("{}", json!({ "rows": rows }));
        return Ok(());
    }
    let mut table = Table::new();
    table.load_style(NOTHING).set_header(["", "µs a tick", "× bare ring", "ns a vehicle and tick"]);
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    for pair in rows.chunks(2) {
        let ring_ns = pair[0].2;
        for (name, fleet, ns) in pair {
            table.add_row([
                name.clone(),
                format!("{:.2}", ns / 1000.0),
                format!("{:.2}", ns / ring_ns),
                format!("{:.0}", ns / *fleet as f64),
            ]);
        }
    }
    say!("{table}");
    say!(
        "medians of {} rounds, ring and pipeline in turn, all processes of each on one core",
        args.rounds
    );
    Ok(())
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Nanoseconds a round of the bare ring.
fn ring_ns(fleet: usize) -> Result<f64, Failure> {
    let names = RunNames::create()?;
    let result = ring_ns_on(&names, fleet);
    names.remove();
    Ok(result?)
}

fn ring_ns_on(names: &RunNames, fleet: usize) -> anyhow::Result<f64> {
    let _bus = Bus::create(names, fleet)?;
    let claim = CoreClaim::new();
    let attachment = Attachment {
        names: names.clone(),
        folder: names.root.clone(),
        max_len: fleet,
        incarnation: 1,
        core: claim.as_ref().map(|claim| claim.core),
        parent: std::process::id() as i32,
        chaos: None,
    };
    let start = |arguments: &[&str]| -> anyhow::Result<Killed> {
        let child = Command::new("/proc/self/exe")
            .arg0("pathtune")
            .args(["service", "ring"])
            .args(arguments)
            .envs(attachment.to_env())
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()?;
        Ok(Killed(child))
    };
    // The first of the ring last, and a moment later: the others' ports are there by then.
    let _second = start(&["second"])?;
    let _third = start(&["third"])?;
    std::thread::sleep(Duration::from_millis(50));
    let mut first = start(&["first", &RING_ROUNDS.to_string()])?;
    let mut text = String::new();
    first.0.stdout.take().context("no output")?.read_to_string(&mut text)?;
    ensure!(first.0.wait()?.success(), "the ring failed");
    text.trim().parse().context("the ring printed no number")
}

/// A process that is gone when this is dropped.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Nanoseconds a tick of a training, from the request of a batch to its report.
fn pipeline_ns(fleet: usize) -> Result<f64, Failure> {
    let mut layers = Layers::maneuver("lane_change")?;
    layers.put("bench", "run.alphas", vec![0.5; fleet])?;
    layers.put("bench", "run.memo", false)?;
    layers.put("bench", "learning.episodes", if fleet == 1 { 4 } else { 2 })?;
    layers.put("bench", "learning.step_limit", 40)?;
    let folder = std::env::temp_dir().join(format!("pathtune-bench-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("logs"))?;
    let plan = Plan {
        config: layers.resolve()?,
        launch: Launch::train(),
        sweep: None,
        folder: folder.clone(),
        budget: Budget::default(),
        chaos: None,
        quiet: true,
        interrupted: Interrupts::new()?,
    };
    let facts = run(&plan);
    let _ = std::fs::remove_dir_all(folder);
    Ok(facts?.tick_ns)
}
