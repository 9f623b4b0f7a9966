//! `pathtune replay`: runs a recording through the ordinary pipeline, with the vehicle and the trainer replaced.

use std::fs;
use std::time::Duration;

use anyhow::Context;
use config::RunConfig;
use config::launch::{Launch, Role};
use serde_json::Value;
use toml::{Table, Value as Toml};

use crate::cli::ReplayArgs;
use crate::pipeline::interrupts::Interrupts;
use crate::pipeline::plan::Plan;
use crate::pipeline::restart::Budget;
use crate::pipeline::services::Services;
use crate::pipeline::strays::sweep_dead_runs;
use crate::runs::folder::{refuse_earlier, resolved_config};
use crate::runs::preflight;
use crate::runs::running::run;
use crate::runs::setup::read;
use crate::runs::temporary::{self, TemporaryFolder};
use crate::words::Failure;

/// The recorded configuration, with the keys that the user overrides.
///
/// # Errors
/// On a user's mistake.
pub fn replay_config(args: &ReplayArgs, recorded: &str) -> Result<RunConfig, Failure> {
    refuse_earlier(&args.file.display().to_string(), recorded)?;
    let mut config: Table = toml::from_str(recorded).context("the recorded configuration")?;
    if let Some(file) = &args.config {
        let origin = file.display();
        let text = read(file, "--config")?;
        refuse_earlier(&format!("--config {origin}"), &text)?;
        let layer: Table = toml::from_str(&text)
            .map_err(|why| Failure::User(format!("--config {origin}: {}", why.message())))?;
        lay(&mut config, layer);
    }
    for assignment in &args.set {
        let wrong = |why: &str| Failure::User(format!("--set {assignment}: {why}"));
        let Some((key, value)) = assignment.split_once('=') else {
            return Err(wrong("has no '='; write --set key=value"));
        };
        // What is not a number, a flag or a list is a word.
        let value = toml::from_str::<Table>(&format!("it = {value}"))
            .ok()
            .and_then(|mut table| table.remove("it"))
            .unwrap_or_else(|| Toml::String(value.trim().to_owned()));
        let (path, last) = key.trim().rsplit_once('.').unwrap_or(("", key.trim()));
        let mut table = &mut config;
        for part in path.split('.').filter(|part| !part.is_empty()) {
            table = table
                .get_mut(part)
                .and_then(Toml::as_table_mut)
                .ok_or_else(|| wrong("no such key in the recorded configuration"))?;
        }
        let Some(old) = table.get_mut(last) else {
            return Err(wrong("no such key in the recorded configuration"));
        };
        // A whole number is accepted where the key holds any number.
        *old = match (&*old, value) {
            (Toml::Float(_), Toml::Integer(whole)) => Toml::Float(whole as f64),
            (_, value) => value,
        };
    }
    let text = toml::to_string(&config).context("the configuration")?;
    let origin = match &args.config {
        Some(file) => format!("--config {}, laid over what was recorded", file.display()),
        None => "the recorded configuration".to_owned(),
    };
    resolved_config(&origin, &text)
}

/// Overrides the keys of one document by those of another.
fn lay(under: &mut Table, over: Table) {
    for (key, value) in over {
        match (under.get_mut(&key), value) {
            (Some(Toml::Table(under)), Toml::Table(over)) => lay(under, over),
            (_, value) => {
                under.insert(key, value);
            }
        }
    }
}

/// Runs a replay in a folder of its own, which is removed afterwards; returns its outcome. `order` is passed to the
/// processes in a file named `order_file`.
///
/// # Errors
/// If the pipeline cannot be kept alive; then the folder is kept, with its logs.
pub fn replay(
    config: RunConfig,
    services: Services,
    order_file: &str,
    order: &str,
) -> Result<Value, Failure> {
    let interrupted = Interrupts::new()?;
    let mut launch = Launch::train();
    launch.prefer_service(Role::Vehicle, "replayer");
    launch.prefer_service(Role::Trainer, "reviewer");
    sweep_dead_runs();
    preflight::check_resources(config.fleet().max(config.learners()))?;
    temporary::sweep();
    let made = TemporaryFolder::make()?;
    let folder = made.path().to_owned();
    let _lock = preflight::lock_folder(&folder)?;
    fs::write(folder.join(order_file), order)?;
    let plan = Plan {
        config,
        launch,
        services,
        sweep: None,
        folder,
        budget: Budget { restarts: 5, within: Duration::from_secs(10) },
        chaos: None,
        quiet: true,
        wait: None,
        rings: Some(1),
        fifo: None,
        interrupted,
    };
    let facts = match run(&plan) {
        Ok(facts) => facts,
        Err(failure) => {
            if !matches!(failure, Failure::User(_)) {
                made.keep();
            }
            return Err(failure);
        }
    };
    if let Some(signal) = facts.pipeline.stopped_by {
        let left = "the replay has compared nothing".to_owned();
        return Err(Failure::Interrupted(signal, left));
    }
    let outcome = fs::read(plan.folder.join(outcome::OUTCOME_FILE)).context("the outcome")?;
    let outcome = serde_json::from_slice(&outcome).context("the outcome")?;
    Ok(outcome)
}
