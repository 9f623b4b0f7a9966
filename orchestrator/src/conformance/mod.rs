//! `pathtune conformance`: whether a program keeps to the vehicle's part of the contract.
//!
//! The program runs alone on a bus of its own. The `stand` plays the orchestrator, the supervisor and the recorder.
//! What is asked of the program is listed in one table, `checks`. Each check fails for its own reason only: where one
//! has failed, those that depend on it do not report the same fault again.

mod checks;
mod credits;
mod life;
mod motion;
mod protocol;
mod realtime;
mod stand;

use std::fs;
use std::path::Path;

use anyhow::Context;
use comfy_table::Table;
use comfy_table::presets::NOTHING;
use config::launch::{Launch, Role};
use config::{Layers, RunConfig};
use ipc_types::Status;
use runtime::{Attachment, Wait};
use serde_json::json;

use crate::cli::ConformanceArgs;
use crate::pipeline::interrupts::Interrupts;
use crate::pipeline::process::{Program, last_lines};
use crate::pipeline::strays::sweep_dead_runs;
use crate::runs::preflight;
use crate::runs::running::PrivateNames;
use crate::words::Failure;
use crate::words::terminal::say;
use checks::{Findings, Verdict};
use stand::{MAX_SLOTS, Stand};

/// Checks a vehicle; returns whether nothing failed.
///
/// # Errors
/// On a user's mistake, or if the stand itself fails.
pub(crate) fn conformance(args: &ConformanceArgs) -> Result<bool, Failure> {
    let interrupted = Interrupts::new()?;
    let config = resolve(args)?;
    let mut launch = Launch::train();
    let command = command_of(&args.command)?;
    launch.replace(&format!("{}={command}", Role::Vehicle.name()), args.deterministic)?;
    preflight::check_commands(&launch)?;

    sweep_dead_runs();
    preflight::check_resources(MAX_SLOTS)?;
    let private = PrivateNames::create()?;
    // Removed with the names, unless the user wants to keep it.
    let usual = private.names.root.join("conformance");
    let folder = preflight::make_folder(args.out.as_deref().unwrap_or(&usual))?;
    let text = toml::to_string(&config).context("the configuration")?;
    fs::write(folder.join("config.toml"), text)?;

    let attachment = Attachment {
        names: private.names.clone(),
        folder: folder.clone(),
        max_len: MAX_SLOTS,
        ring: 0,
        incarnation: 0,
        core: None,
        wait: Wait::default(),
        fifo: None,
        parent: std::process::id() as i32,
        chaos: None,
    };
    let mut findings = Findings::default();
    let mut stand = Stand::new(config, Program::Command(command), attachment, interrupted)?;
    examine(args, &mut stand, &mut findings)?;
    drop(stand);
    tell(args, &findings, &folder)
}

/// All checks, in their order.
fn examine(args: &ConformanceArgs, stand: &mut Stand, to: &mut Findings) -> Result<(), Failure> {
    if !life::becomes_ready(stand, to)? {
        return life::ends(stand, to);
    }
    // A vehicle that sets its own pace is taken at its word.
    let wanted = stand.realtime;
    let says_so = ipc_types::has(stand.told().pacing, Status::REAL_TIME);
    stand.realtime |= says_so;
    to.note(
        "pacing",
        stand.told().pacing & !3 == 0
            && (stand.realtime == ipc_types::has(stand.told().pacing, Status::REAL_TIME)),
        format!("pacing {}, run.realtime {wanted}", stand.told().pacing),
    );
    if protocol::begins(stand, to)? {
        if stand.realtime {
            to.skip(checks::LOCKSTEP_ALONE, "the vehicle paces by the clock");
            realtime::check(stand, to)?;
        } else {
            to.skip(
                checks::REAL_TIME_ALONE,
                "the vehicle drives in lockstep; --realtime asks for real time",
            );
            protocol::check(stand, to)?;
            credits::check(stand, to)?;
        }
        if args.allow_motion {
            motion::check(stand, to)?;
            if !stand.realtime {
                motion::repeats(stand, to, args.deterministic || is_ours(&args.command))?;
            }
        } else {
            to.skip(checks::MOVING, "moves the vehicle: --allow-motion");
        }
        protocol::goes_on_behind_a_restart(stand, to)?;
        life::restarts(stand, to)?;
    }
    protocol::sum_up(stand, to);
    life::ends(stand, to)
}

fn is_ours(words: &[String]) -> bool {
    words.first().is_some_and(|word| word == "pathtune")
}

/// The words of the command as one line; `pathtune` is this very program.
fn command_of(words: &[String]) -> Result<String, Failure> {
    let mut words = words.to_vec();
    if is_ours(&words) {
        words[0] = std::env::current_exe()?.display().to_string();
    }
    Ok(shell_words::join(words))
}

fn resolve(args: &ConformanceArgs) -> Result<RunConfig, Failure> {
    let mut layers = Layers::maneuver(&args.maneuver)?;
    if let Some(vehicle) = &args.vehicle {
        layers.set_vehicle("--vehicle", vehicle)?;
    }
    for assignment in &args.set {
        layers.set(assignment)?;
    }
    if args.realtime {
        layers.put("--realtime", "run.realtime", true)?;
    }
    Ok(layers.resolve()?)
}

/// How many characters of what was seen a row shows. For a failure, the full text follows below the table.
const SEEN_WIDTH: usize = 60;

/// Prints what was found; returns whether nothing failed.
fn tell(args: &ConformanceArgs, findings: &Findings, folder: &Path) -> Result<bool, Failure> {
    let count = |verdict| findings.rows().filter(|(_, it, _)| *it == verdict).count();
    let failed = count(Verdict::Fail);
    let log = last_lines(&folder.join("logs/vehicle.log"), 5);
    if args.json {
        let rows: Vec<_> = findings
            .rows()
            .map(|(check, verdict, seen)| {
                json!({ "id": check.id, "name": check.name, "verdict": verdict, "seen": seen, "mend": check.mend })
            })
            .collect();
        let told = json!({
            "checks": rows,
            "passed": count(Verdict::Pass),
            "failed": failed,
            "skipped": count(Verdict::Skipped),
            "log": log,
        });
        say!("{}", serde_json::to_string_pretty(&told).context("the findings")?);
        return Ok(failed == 0);
    }
    let mut table = Table::new();
    table.load_style(NOTHING).set_header(["", "check", "what", "seen"]);
    for (check, verdict, seen) in findings.rows() {
        let word = match verdict {
            Verdict::Pass => "pass",
            Verdict::Fail => "FAIL",
            Verdict::Skipped => "skipped",
        };
        let short: String = seen.chars().take(SEEN_WIDTH).collect();
        table.add_row([word, check.id, check.name, &short]);
    }
    say!("{table}");
    for (check, _, seen) in findings.rows().filter(|(_, verdict, _)| *verdict == Verdict::Fail) {
        say!("{}: {} ({seen}); {}", check.id, check.name, check.mend);
    }
    if failed > 0 && !log.is_empty() {
        say!("its log ends with: {}", log.join(" | "));
    }
    say!("{} passed, {failed} failed, {} skipped", count(Verdict::Pass), count(Verdict::Skipped));
    Ok(failed == 0)
}
