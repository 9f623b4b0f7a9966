//! `pathtune gains`: the result of a training, promoted to a vehicle's file, and back.

use std::fs;
use std::path::Path;

use config::promote::{self, changes, geometry_difference, large_changes, rollback_place};
use config::{Gains, Layers, Provenance, RunConfig, TunedGains, Vehicle, check_gains};
use serde_json::{Value, json};

use crate::cli::GainsCommand;
use crate::runs::preflight;
use crate::runs::vehicle_file::VehicleFile;
use crate::words::Failure;
use crate::words::tables::{digits, table_of, trim};
use crate::words::terminal::{say, tell};

/// Shows, promotes or brings back the gains of a vehicle's file.
///
/// # Errors
/// The user's mistakes; a file that cannot be written.
pub fn gains(command: &GainsCommand) -> Result<(), Failure> {
    match command {
        GainsCommand::List { vehicle, json } => list(vehicle, *json),
        GainsCommand::Show { vehicle, maneuver, json } => show(vehicle, maneuver, *json),
        GainsCommand::Promote { run, vehicle, force, dry_run } => {
            promote(run, vehicle, *force, *dry_run)
        }
        GainsCommand::Rollback { vehicle, maneuver, to } => {
            rollback(vehicle, maneuver.as_deref(), *to)
        }
    }
}

fn list(file: &Path, as_json: bool) -> Result<(), Failure> {
    let vehicle = resolve(file)?;
    if as_json {
        return print_json(
            &json!({ "schema": 1, "vehicle": vehicle.name, "gains": vehicle.gains }),
        );
    }
    if vehicle.gains.is_empty() {
        say!("{}: no gains yet; `pathtune gains promote RUN {0}` brings some", file.display());
        return Ok(());
    }
    let mut table = table_of(&["manoeuvre", "Kv", "Kl", "Ks", "Ki", "digest", "rank", "when"]);
    for (maneuver, set) in &vehicle.gains {
        let mut cells = vec![maneuver.clone()];
        cells.extend(set.gains().to_array().map(trim));
        cells.extend(describe(set.provenance.as_ref()));
        table.add_row(cells);
    }
    say!("{table}");
    Ok(())
}

fn show(file: &Path, maneuver: &str, as_json: bool) -> Result<(), Failure> {
    let vehicle = resolve(file)?;
    let set = set_of(&vehicle, file, maneuver)?;
    if as_json {
        return print_json(&json!({
            "schema": 1, "vehicle": vehicle.name, "maneuver": maneuver, "gains": set,
        }));
    }
    let header = ["", "Kv", "Kl", "Ks", "Ki", "digest", "rank", "when", "replaced", "by"];
    let mut table = table_of(&header);
    let mut cells = vec!["now".to_owned()];
    cells.extend(set.gains().to_array().map(trim));
    cells.extend(describe(set.provenance.as_ref()));
    table.add_row(cells);
    for (index, past) in set.history.iter().rev().enumerate() {
        let mut cells = vec![format!("--to {}", index + 1)];
        cells.extend(past.gains().to_array().map(trim));
        cells.extend(describe(past.provenance.as_ref()));
        cells.extend([past.replaced_at.clone(), past.replaced_by.name().to_owned()]);
        table.add_row(cells);
    }
    say!("{table}");
    let Some(it) = &set.provenance else {
        say!("no provenance: written by hand");
        return Ok(());
    };
    let alphas: Vec<String> = it.alphas.iter().map(f64::to_string).collect();
    say!(
        "trained on {} with {}, seed {}, alphas {}, {} noise; run {}",
        it.maneuver,
        it.vehicle,
        it.seed,
        alphas.join(","),
        if it.noise { "with" } else { "without" },
        it.run,
    );
    let number = |number: f64| digits(&number.into(), 4);
    let noise_free = format!(
        "noise-free: distance {}, mse {} m², rank {}/{}",
        number(it.distance),
        number(it.mse_m2),
        it.rank_distance,
        it.grid_size
    );
    say!("{noise_free}");
    if let (Some(low), Some(high)) = (it.mean_distance_low, it.mean_distance_high) {
        let rank = it.rank_mean_distance.map_or("–".to_owned(), |rank| rank.to_string());
        say!(
            "under noise: mean distance in [{}, {}], rank {rank}/{}",
            number(low),
            number(high),
            it.grid_size
        );
    }
    say!("digest {}, promoted by pathtune {}", it.digest, it.pathtune);
    Ok(())
}

fn promote(run: &Path, file: &Path, force: bool, dry_run: bool) -> Result<(), Failure> {
    let trained = Trained::read(run)?;
    check_is_file(file)?;
    // A second promotion at the same time waits for this one: neither is lost.
    let target = VehicleFile::lock(file)?;
    let vehicle = resolve(file)?;
    let Trained { maneuver, gains, provenance, .. } = &trained;
    if let Some((key, then, now)) = geometry_difference(&trained.vehicle, &vehicle)
        && !force
    {
        return Err(Failure::User(format!(
            "{}: {key} is {now}, and the training was of a vehicle with {then}; train again with --vehicle {0}, or \
             insist with --force",
            file.display()
        )));
    }
    let old = vehicle.gains.get(maneuver);
    let same = |old: &TunedGains| {
        old.gains() == *gains
            && old.provenance.as_ref().is_some_and(|it| it.digest == provenance.digest)
    };
    if old.is_some_and(same) {
        say!("{}: {maneuver} has these gains already", file.display());
        return Ok(());
    }
    if let Some(old) = old
        && !force
    {
        let large: Vec<String> = large_changes(old.gains(), *gains)
            .iter()
            .map(|it| format!("{} from {} to {} ({:+.0} %)", it.name, it.old, it.new, it.percent()))
            .collect();
        if !large.is_empty() {
            return Err(Failure::User(format!(
                "{}: gains.{maneuver}: {} is a change of more than {:.0} %; try it in simulation, then insist with \
                 --force",
                file.display(),
                large.join(", "),
                100.0 * promote::CHANGE_LIMIT
            )));
        }
    }
    let text = promote::promote(&target.text, maneuver, *gains, provenance)
        .map_err(|why| Failure::User(format!("{}: {why}", file.display())))?;
    if !dry_run {
        target.replace(&text)?;
    }
    // Behind whatever may be refused: that is one line.
    if !trained.on_bound.is_empty() {
        let bounds = trained.on_bound.join(", ");
        tell!(
            "pathtune: warning: on a bound of the training's grid: {bounds}; better gains may lie beyond it"
        );
    }
    let what = if dry_run { "would be promoted" } else { "promoted" };
    say_changes(file, maneuver, what, old.map(TunedGains::gains), *gains)
}

fn rollback(file: &Path, maneuver: Option<&str>, to: Option<usize>) -> Result<(), Failure> {
    check_is_file(file)?;
    let target = VehicleFile::lock(file)?;
    let vehicle = resolve(file)?;
    let fail = |why: String| Failure::User(format!("{}: {why}", file.display()));
    let names: Vec<&str> = vehicle.gains.keys().map(String::as_str).collect();
    let maneuver = match (maneuver, &names[..]) {
        (Some(maneuver), _) => maneuver,
        (None, [only]) => only,
        (None, []) => return Err(fail("has no gains to roll back".to_owned())),
        (None, _) => return Err(fail(format!("name a manoeuvre: {}", names.join(", ")))),
    };
    let set = set_of(&vehicle, file, maneuver)?;
    let place = rollback_place(set, to).ok_or_else(|| {
        let held = set.history.len();
        fail(match to {
            Some(to) => format!(
                "gains.{maneuver}: --to {to}: the history holds {held}; `pathtune gains show` lists them"
            ),
            None if held > 0 => format!(
                "gains.{maneuver}: nothing stood there before; --to N brings back what was rolled back"
            ),
            None => format!("gains.{maneuver}: nothing stood there before"),
        })
    })?;
    let past = set.history[place].gains();
    let text = promote::rollback(&target.text, maneuver, place, &now())
        .map_err(|why| fail(why.to_string()))?;
    target.replace(&text)?;
    say_changes(file, maneuver, "rolled back", Some(set.gains()), past)
}

/// A finished training, as far as it concerns a vehicle.
struct Trained {
    /// The manoeuvre that its gains are for.
    maneuver: String,
    gains: Gains,
    provenance: Provenance,
    vehicle: Vehicle,
    on_bound: Vec<String>,
}

impl Trained {
    fn read(run: &Path) -> Result<Self, Failure> {
        let fail = |why: String| Failure::User(format!("{}: {why}", run.display()));
        let folder = fs::canonicalize(run).map_err(|error| fail(error.to_string()))?;
        if !folder.is_dir() {
            return Err(fail("name the folder of a finished training".to_owned()));
        }
        // Held until everything is read: nobody goes on with it meanwhile.
        let _lock = preflight::look_into(run)?;
        let unfinished = |why: &str| {
            fail(format!(
                "is no finished training: {why}; `pathtune train --resume {}` finishes one",
                run.display()
            ))
        };
        let read = |name: &str| {
            fs::read_to_string(folder.join(name))
                .map_err(|error| unfinished(&format!("{name}: {error}")))
        };
        let result: Value = serde_json::from_str(&read("result.json")?)
            .map_err(|error| unfinished(&format!("result.json: {error}")))?;
        if result["kind"] != "train" {
            let kind = result["kind"].as_str().unwrap_or("nothing known");
            return Err(fail(format!("is a run of {kind}; gains come from a training")));
        }
        let config = RunConfig::from_resolved(&read("config.toml")?)
            .map_err(|error| fail(error.to_string()))?;
        // A line is a step, behind the one that opens the journal.
        let steps = read("journal")?.lines().count().saturating_sub(1) as u64;
        if result["drives"]["asked"] != steps {
            return Err(unfinished("result.json does not belong to the journal"));
        }
        for (key, ours) in
            [("maneuver", Value::from(&*config.maneuver)), ("seed", config.run.seed.into())]
        {
            if result[key] != ours {
                return Err(unfinished(&format!("config.toml has another {key} than result.json")));
            }
        }
        let number = |pointer: &str| {
            let number = result.pointer(pointer).and_then(Value::as_f64);
            number.ok_or_else(|| fail(format!("result.json: {pointer} is no number")))
        };
        let mut gains = [0.0; 4];
        for (gain, name) in gains.iter_mut().zip(Gains::NAMES) {
            *gain = number(&format!("/gains/{name}"))?;
        }
        let gains = Gains::from_array(gains);
        check_gains(gains)
            .map_err(|(name, problem)| fail(format!("result.json: gains.{name} {problem}")))?;
        let chosen = &result["noise"]["finalists"][0];
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        let provenance = Provenance {
            digest: result["digest"].as_str().unwrap_or_default().to_owned(),
            promoted_at: now(),
            // A folder's name may be anything.
            run: name.chars().filter(|c| !c.is_control()).take(64).collect(),
            maneuver: config.maneuver.clone(),
            vehicle: config.vehicle.name.clone(),
            seed: config.run.seed,
            alphas: config.run.alphas.clone(),
            noise: config.noise.enabled,
            distance: number("/distance")?,
            mse_m2: number("/mse_m2")?,
            grid_size: number("/grid/size")? as u64,
            rank_distance: number("/grid/rank_distance")? as u64,
            rank_mean_distance: result["grid"]["rank_mean_distance"].as_u64(),
            mean_distance_low: chosen["low"].as_f64(),
            mean_distance_high: chosen["high"].as_f64(),
            pathtune: env!("CARGO_PKG_VERSION").to_owned(),
        };
        let maneuver = match config.maneuvers_due()[..] {
            [one] => one.to_owned(),
            // One set for the whole path.
            _ => config.maneuver.clone(),
        };
        let bounds = result["on_bound"].as_array().into_iter().flatten();
        let on_bound = bounds.filter_map(Value::as_str).map(str::to_owned).collect();
        Ok(Self { maneuver, gains, provenance, vehicle: config.vehicle, on_bound })
    }
}

fn now() -> String {
    jiff::Timestamp::now().strftime("%Y-%m-%dT%H:%M:%SZ").to_string()
}

/// Checks that a vehicle is a file of the user's.
fn check_is_file(file: &Path) -> Result<(), Failure> {
    let name = file.display().to_string();
    let preset = format!("vehicles/{}.toml", name.trim_end_matches(".toml"));
    let is_preset = config::presets().iter().any(|it| it.path == preset);
    if file.is_file() && (name.ends_with(".toml") || !is_preset) {
        return Ok(());
    }
    let why = if is_preset && !file.exists() {
        "is a preset, which cannot be changed; write your own file on top of it: `pathtune config init DIR` writes all \
         presets, this one as"
    } else if file.exists() {
        "is no vehicle's file of yours; name a TOML file, such as, behind `pathtune config init DIR`,"
    } else {
        "there is no such file; `pathtune config init DIR` writes the presets to start from, such as"
    };
    let example = if is_preset { preset } else { "vehicles/tesla_model_3.toml".to_owned() };
    Err(Failure::User(format!("{name}: {why} DIR/{example}")))
}

fn resolve(file: &Path) -> Result<Vehicle, Failure> {
    check_is_file(file)?;
    let name = file.to_str().ok_or_else(|| {
        Failure::User(format!("{}: a vehicle's file needs a name in UTF-8", file.display()))
    })?;
    Ok(Layers::vehicle_of_file(name)?)
}

fn set_of<'a>(
    vehicle: &'a Vehicle,
    file: &Path,
    maneuver: &str,
) -> Result<&'a TunedGains, Failure> {
    vehicle.gains.get(maneuver).ok_or_else(|| {
        let names: Vec<&str> = vehicle.gains.keys().map(String::as_str).collect();
        let there = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        Failure::User(format!("{}: no gains for {maneuver}; there are {there}", file.display()))
    })
}

/// Digest, rank and time of gains.
fn describe(provenance: Option<&Provenance>) -> [String; 3] {
    let Some(it) = provenance else { return ["by hand", "", ""].map(str::to_owned) };
    let rank = it.rank_mean_distance.unwrap_or(it.rank_distance);
    [
        it.digest.chars().take(12).collect(),
        format!("{rank}/{}", it.grid_size),
        it.promoted_at.clone(),
    ]
}

fn say_changes(
    file: &Path,
    maneuver: &str,
    what: &str,
    old: Option<Gains>,
    new: Gains,
) -> Result<(), Failure> {
    let Some(old) = old else {
        let gains = new.to_array().map(trim).join(" ");
        say!("{}: {maneuver} {what}: {gains} (Kv Kl Ks Ki)", file.display());
        return Ok(());
    };
    let each = changes(old, new).map(|it| {
        if it.old == it.new {
            return format!("{} {}", it.name, trim(it.new));
        }
        format!("{} {} -> {} ({:+.0} %)", it.name, trim(it.old), trim(it.new), it.percent())
    });
    say!("{}: {maneuver} {what}: {}", file.display(), each.join(", "));
    Ok(())
}

fn print_json(value: &Value) -> Result<(), Failure> {
    say!("{}", serde_json::to_string_pretty(value).map_err(anyhow::Error::from)?);
    Ok(())
}
