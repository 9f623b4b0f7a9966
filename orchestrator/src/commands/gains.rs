//! `pathtune gains`: promotes the result of a training to a vehicle's file, and rolls it back.

use std::fs;
use std::path::Path;

use config::promote::{self, changes, geometry_difference, large_changes, rollback_place};
use config::slots;
use config::{
    LawConfig, Layers, MadeFor, NamedParameters, Parameters, Provenance, RunConfig, TunedGains,
    Vehicle, law_preset, read_small,
};
use outcome::{
    Margin, OUTCOME_FILE, Outcome, OutcomeError, RESULT_FILE, read_decided, read_result,
};
use serde_json::{Map, Value, json};

use crate::cli::GainsCommand;
use crate::commands::envelopes::TakenAlong;
use crate::runs::vehicle_file::VehicleFile;
use crate::runs::{preflight, resolved_config};
use crate::words::Failure;
use crate::words::plants::{self as words_of_plants, margin as said};
use crate::words::tables::{digits, set_cells, table_of, trim};
use crate::words::terminal::{say, tell};

/// Shows, promotes or rolls back the gains in a vehicle's file.
///
/// # Errors
/// On a user's mistake, or if a file cannot be written.
pub(crate) fn gains(command: &GainsCommand, margin_of: MarginOf) -> Result<(), Failure> {
    match command {
        GainsCommand::List { vehicle, json } => list(vehicle, *json),
        GainsCommand::Show { vehicle, maneuver, json } => show(vehicle, maneuver, *json),
        GainsCommand::Promote { run, vehicle, force, dry_run } => {
            promote(run, vehicle, *force, *dry_run, margin_of)
        }
        GainsCommand::Rollback { vehicle, maneuver, to } => {
            rollback(vehicle, maneuver.as_deref(), *to)
        }
    }
}

fn list(file: &Path, as_json: bool) -> Result<(), Failure> {
    let vehicle = resolve(file)?;
    if as_json {
        let gains: Map<String, Value> =
            vehicle.gains.iter().map(|(name, set)| (name.clone(), to_json(set))).collect();
        return print_json(&json!({ "schema": 1, "vehicle": vehicle.name, "gains": gains }));
    }
    if vehicle.gains.is_empty() {
        say!("{}: no gains yet; `pathtune gains promote RUN {0}` adds some", file.display());
        return Ok(());
    }
    let mut laws: Vec<&str> = vehicle.gains.values().map(|set| set.law.as_str()).collect();
    laws.sort_unstable();
    laws.dedup();
    for law in laws {
        let law = law_of(law);
        let mut table = table_of_law(&law, "manoeuvre", &["digest", "rank", "when"]);
        for (maneuver, set) in vehicle.gains.iter().filter(|(_, set)| set.law == law.name) {
            let mut cells = vec![maneuver.clone()];
            cells.extend(set_cells(&law, std::slice::from_ref(&set.parameters)));
            cells.extend(describe(set.provenance.as_ref()));
            table.add_row(cells);
        }
        say!("{table}");
    }
    Ok(())
}

/// A set as JSON, for scripts: its parameters are on the same level as the rest, under their own names.
fn to_json(set: &TunedGains) -> Value {
    let mut json = json!(set);
    flatten(&mut json);
    if let Some(Value::Array(history)) = json.get_mut("history") {
        history.iter_mut().for_each(flatten);
    }
    json
}

fn flatten(json: &mut Value) {
    let Value::Object(set) = json else { return };
    if let Some(Value::Object(parameters)) = set.remove("parameters") {
        set.extend(parameters);
    }
}

/// A table with a column for each parameter of a law. A law that is not the paper's is named in the first column's
/// title.
fn table_of_law(law: &LawConfig, first: &str, last: &[&str]) -> comfy_table::Table {
    let first = match &*law.name {
        "paper" => first.to_owned(),
        name => format!("{first} (law {name})"),
    };
    let header: Vec<&str> =
        std::iter::once(&*first).chain(law.symbols()).chain(last.iter().copied()).collect();
    table_of(&header)
}

/// The preset of a law that a vehicle's file names.
fn law_of(name: &str) -> LawConfig {
    law_preset(name).expect("a resolved vehicle's file names known laws only")
}

fn show(file: &Path, maneuver: &str, as_json: bool) -> Result<(), Failure> {
    let vehicle = resolve(file)?;
    let set = set_of(&vehicle, file, maneuver)?;
    if as_json {
        return print_json(&json!({
            "schema": 1, "vehicle": vehicle.name, "maneuver": maneuver, "gains": to_json(set),
        }));
    }
    let law = law_of(&set.law);
    let last = ["digest", "rank", "when", "replaced", "by"];
    let mut table = table_of_law(&law, "", &last);
    let mut cells = vec!["now".to_owned()];
    cells.extend(set_cells(&law, std::slice::from_ref(&set.parameters)));
    cells.extend(describe(set.provenance.as_ref()));
    table.add_row(cells);
    let mut others = Vec::new();
    for (index, past) in set.history.iter().rev().enumerate() {
        let mut cells = vec![format!("--to {}", index + 1)];
        if past.law == set.law {
            cells.extend(set_cells(&law, std::slice::from_ref(&past.parameters)));
        } else {
            // Its parameters have no columns here.
            others.push(format!("--to {}: law {}, {}", index + 1, past.law, past.parameters));
            cells.extend(law.keys().map(|_| "–".to_owned()));
        }
        cells.extend(describe(past.provenance.as_ref()));
        cells.extend([past.replaced_at.clone(), past.replaced_by.name().to_owned()]);
        table.add_row(cells);
    }
    say!("{table}");
    for other in others {
        say!("{other}");
    }
    let Some(it) = &set.provenance else {
        say!("no provenance: written by hand");
        return Ok(());
    };
    let alphas: Vec<String> = it.alphas.iter().map(f64::to_string).collect();
    let tuner = it.tuner.as_ref().map_or(String::new(), |tuner| format!(" by {tuner}"));
    let alphas = match alphas.is_empty() {
        true => String::new(),
        false => format!(", alphas {}", alphas.join(",")),
    };
    say!(
        "trained{tuner} on {} with {}, seed {}{alphas}, {} noise; run {}",
        it.maneuver,
        it.vehicle,
        it.seed,
        if it.noise { "with" } else { "without" },
        it.run,
    );
    let of_grid = |rank: Option<u64>| match (rank, it.grid_size) {
        (Some(rank), Some(size)) => format!(", rank {rank} of {size}"),
        _ => String::new(),
    };
    let of_drives = match it.drives {
        None => String::new(),
        Some(1) => " in a drive of the vehicle itself".to_owned(),
        Some(count) => format!(" over {count} drives of the vehicle itself"),
    };
    say!(
        "noise-free{of_drives}: distance {}, mse {} m²{}",
        digits(it.distance, 4),
        digits(it.mse_m2, 4),
        of_grid(it.rank_distance),
    );
    if let (Some(mean_m), Some(max_m)) = (it.path_mean_m, it.path_max_m) {
        say!("off the path: mean {} m, at most {} m", digits(mean_m, 4), digits(max_m, 4));
    }
    if let (Some(low), Some(high)) = (it.mean_low, it.mean_high) {
        let objective = it.objective.as_deref().unwrap_or("distance");
        let under_noise = if it.noise { "under noise: " } else { "" };
        say!(
            "{under_noise}mean {objective} in [{}, {}]{}",
            digits(low, 4),
            digits(high, 4),
            of_grid(it.rank_mean),
        );
    }
    say!("digest {}, promoted by pathtune {}", it.digest, it.pathtune);
    Ok(())
}

/// How much later the steering may act, see `Tools`.
type MarginOf = fn(&RunConfig, &Parameters, f64) -> Margin;

fn promote(
    run: &Path,
    file: &Path,
    force: bool,
    dry_run: bool,
    margin_of: MarginOf,
) -> Result<(), Failure> {
    let trained = Trained::read(run)?;
    check_is_file(file)?;
    // A second promotion at the same time waits for this one, so that neither is lost.
    let target = VehicleFile::lock(file)?;
    let vehicle = resolve(file)?;
    let Trained { law, parameters, provenance, .. } = &trained;
    let maneuver = &slots::place(&vehicle.gains, &trained.maneuver, law);
    if let Some((key, then, now)) = geometry_difference(&trained.config.vehicle, &vehicle)
        && !force
    {
        return Err(Failure::User(format!(
            "{}: {key} is {now}, but the training was of a vehicle with {then}; train again with --vehicle {0}, or \
             insist with --force",
            file.display()
        )));
    }
    let old = vehicle.gains.get(maneuver);
    let same = |old: &TunedGains| {
        old.law == *law
            && old.parameters == *parameters
            && old.provenance.as_ref().is_some_and(|it| it.digest == provenance.digest)
    };
    if old.is_some_and(same) {
        say!("{}: {maneuver} has these gains already", file.display());
        return Ok(());
    }
    // Earlier versions did not note the path.
    let is_same = |noted: &Provenance| match (&noted.path_hash, &provenance.path_hash) {
        (Some(noted), Some(_)) => trained.config.is_path(noted),
        (Some(_), None) => false,
        // Earlier versions noted no path.
        (None, Some(_)) => noted.maneuver == provenance.maneuver,
        (None, None) => true,
    };
    if old.and_then(|old| old.provenance.as_ref()).is_some_and(|it| !is_same(it)) && !force {
        return Err(Failure::User(format!(
            "{}: gains.{maneuver}: are for another path, which has the same name; give the path's file another name and \
             train again, or insist with --force",
            file.display()
        )));
    }
    if let Some(old) = old
        && !force
    {
        let large: Vec<String> = large_changes(&old.parameters, parameters)
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
    if trained.misses && !force {
        return Err(Failure::User(format!(
            "{}: a drive with the set does not arrive; train with more drives, other bounds or another law, or insist with \
             --force",
            run.display()
        )));
    }
    // With the car that is to drive with them, which may be later than the one of the training.
    let margin = trained.margin(&vehicle, margin_of);
    let by_margin = || Some(format!("with this vehicle {}", margin.as_ref()?.why_fragile()?));
    if let Some(why) = trained.fragile.clone().or_else(by_margin)
        && !force
    {
        return Err(Failure::User(format!(
            "{}: the set is fragile, {why}; {}; or insist with --force",
            run.display(),
            words_of_plants::steadier(&trained.config)
        )));
    }
    let along = trained.envelope(run, file, &vehicle, maneuver);
    let text = promote::promote(&target.text, maneuver, law, parameters, provenance)
        .map_err(|why| Failure::User(format!("{}: {why}", file.display())))?;
    if !dry_run {
        target.replace(&text)?;
        if let Ok(Some(envelope)) = &along {
            envelope.put()?;
        }
    }
    // Printed only once nothing can be refused any more: a refusal is one line.
    if !trained.on_bound.is_empty() {
        let bounds = trained.on_bound.join(", ");
        tell!(
            "pathtune: warning: on a bound of the training's grid: {bounds}; better gains may lie beyond it"
        );
    }
    let mut what = if dry_run { "would be promoted" } else { "promoted" }.to_owned();
    if let Some(hash) = &provenance.path_hash {
        what += &format!(" for the path {} ({hash:.8})", trained.maneuver);
    }
    let old = old.map(|old| (&*old.law, &old.parameters));
    say_changes(file, maneuver, &what, old, (law, parameters))?;
    if let Some(margin) = &margin {
        say!("{}", said(margin));
    }
    match &along {
        Ok(Some(envelope)) => say!("{}: the envelope of these gains", envelope.file().display()),
        Ok(None) => {}
        Err(why) => tell!("pathtune: warning: {why}"),
    }
    Ok(())
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
                "gains.{maneuver}: --to {to}: the history holds {held} sets; `pathtune gains show` lists them"
            ),
            None if held > 0 => format!(
                "gains.{maneuver}: there were no gains before these; --to N restores a set that was rolled back"
            ),
            None => format!("gains.{maneuver}: there were no gains before these"),
        })
    })?;
    let past = &set.history[place];
    let text = promote::rollback(&target.text, maneuver, place, &now())
        .map_err(|why| fail(why.to_string()))?;
    target.replace(&text)?;
    let old = Some((&*set.law, &set.parameters));
    say_changes(file, maneuver, "rolled back", old, (&past.law, &past.parameters))
}

/// What a vehicle needs of a finished training.
struct Trained {
    /// The manoeuvre that its gains are for.
    maneuver: String,
    /// Name of its law, and that law's parameters.
    law: String,
    parameters: NamedParameters,
    provenance: Provenance,
    config: RunConfig,
    /// The highest speed that its drive holds, if that is known.
    fastest_mps: Option<f64>,
    on_bound: Vec<String>,
    /// Why its gains are fragile, if they are.
    fragile: Option<String>,
    /// Whether a drive with them does not arrive although it is to.
    misses: bool,
}

impl Trained {
    fn read(run: &Path) -> Result<Self, Failure> {
        let fail = |why: String| Failure::User(format!("{}: {why}", run.display()));
        let folder = fs::canonicalize(run).map_err(|error| fail(error.to_string()))?;
        if !folder.is_dir() {
            return Err(fail("name the folder of a finished training".to_owned()));
        }
        // Held until everything is read, so that nobody resumes the training meanwhile.
        let _lock = preflight::look_into(run)?;
        let unfinished = |why: &str| {
            fail(format!(
                "is not a finished training: {why}; `pathtune train --resume {}` finishes it",
                run.display()
            ))
        };
        let read = |name: &str| {
            read_small(&folder.join(name)).map_err(|error| unfinished(&format!("{name}: {error}")))
        };
        let decided = match read_result(&folder) {
            Ok(result) => result.decided,
            Err(OutcomeError::Io { source, .. }) => {
                return Err(unfinished(&format!("{RESULT_FILE}: {source}")));
            }
            Err(error @ OutcomeError::Earlier { .. }) => {
                return Err(Failure::User(error.to_string()));
            }
            Err(OutcomeError::Malformed { problem, .. }) => {
                return Err(unfinished(&format!("{RESULT_FILE}: {problem}")));
            }
        };
        let Outcome::Train(training) = &decided.outcome else {
            let kind = decided.outcome.kind();
            return Err(fail(format!("is a run of {kind}; gains come from a training")));
        };
        let origin = run.join("config.toml").display().to_string();
        let config = resolved_config(&origin, &read("config.toml")?)?;
        // What the trainer wrote when it had finished.
        let finished = read_decided(&folder).map_err(|error| unfinished(&error.to_string()))?;
        if finished != decided {
            return Err(unfinished(&format!("{RESULT_FILE} does not belong to {OUTCOME_FILE}")));
        }
        for (key, differs) in [
            ("maneuver", decided.maneuver != config.maneuver),
            ("law", decided.law != config.law.name),
            ("objective", decided.objective != config.objective.name),
            ("seed", decided.seed != config.run.seed),
        ] {
            if differs {
                return Err(unfinished(&format!("config.toml and result.json differ in {key}")));
            }
        }
        // By the law as the training had it: its bounds go with the size of the car.
        config.law.parameters_of(&training.gains).map_err(|(name, problem)| {
            fail(format!("{RESULT_FILE}: gains.{name} {problem}, according to the law's bounds"))
        })?;
        let chosen = training.noise.as_ref().and_then(|noise| noise.finalists.first());
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        let grid = training.grid.as_ref();
        let provenance = Provenance {
            digest: training.digest.clone(),
            promoted_at: now(),
            // A folder's name may be anything.
            run: name.chars().filter(|c| !c.is_control()).take(64).collect(),
            maneuver: config.maneuver.clone(),
            path_hash: config.is_own_path().then(|| config.path_hash()),
            vehicle: config.vehicle.name.clone(),
            seed: config.run.seed,
            tuner: Some(training.tuner.clone()),
            objective: Some(decided.objective.clone()),
            alphas: training.learners.iter().filter_map(|learner| learner.alpha).collect(),
            compensate_dead_time: Some(config.controller.compensate_dead_time),
            noise: config.noise.enabled,
            drives: training.vehicle_drives.map(|_| training.spread.map_or(1, |it| it.drives)),
            distance: training.measures.distance,
            mse_m2: training.measures.mse_m2,
            path_mean_m: Some(training.measures.path_mean_m),
            path_max_m: Some(training.measures.path_max_m),
            grid_size: grid.map(|grid| grid.size as u64),
            rank_value: grid.map(|grid| grid.rank_value as u64),
            rank_distance: grid.map(|grid| grid.rank_distance as u64),
            rank_mean: grid.and_then(|grid| grid.rank_mean).map(|rank| rank as u64),
            mean_low: chosen.map(|chosen| chosen.low),
            mean_high: chosen.map(|chosen| chosen.high),
            pathtune: env!("CARGO_PKG_VERSION").to_owned(),
        };
        let plants = training.plants.as_ref();
        let maneuver = config.gains_name();
        let misses = config.is_to_arrive() && !training.measures.arrived;
        Ok(Self {
            maneuver,
            law: config.law.name.clone(),
            parameters: training.gains.clone(),
            provenance,
            fastest_mps: plants.and_then(|it| Some(it.margin.as_ref()?.speed_mps)),
            config,
            on_bound: training.on_bound.clone(),
            fragile: plants.and_then(|it| it.fragile.clone()),
            misses,
        })
    }

    /// The envelope that was calibrated for its gains, if there is one.
    fn envelope(
        &self,
        run: &Path,
        file: &Path,
        vehicle: &Vehicle,
        name: &str,
    ) -> Result<Option<TakenAlong>, String> {
        let made_for = MadeFor::of(&self.config, vec![self.parameters.clone()]);
        TakenAlong::read(run, (file, &vehicle.name), name, &made_for)
    }

    /// How much later the steering of a vehicle may act with its gains: at the highest speed of the training's drive, or, if
    /// that is not known, of the path.
    fn margin(&self, vehicle: &Vehicle, margin_of: MarginOf) -> Option<Margin> {
        let config = RunConfig { vehicle: vehicle.clone(), ..self.config.clone() };
        let set = config.law.parameters_of(&self.parameters).ok()?;
        let speeds = config.path.speeds_mps.iter().copied();
        let of_path = speeds.reduce(f64::max).unwrap_or(config.reference.speed_mps);
        Some(margin_of(&config, &set, self.fastest_mps.unwrap_or(of_path)))
    }
}

fn now() -> String {
    jiff::Timestamp::now().strftime("%Y-%m-%dT%H:%M:%SZ").to_string()
}

/// Checks that the vehicle is a file of the user's own.
fn check_is_file(file: &Path) -> Result<(), Failure> {
    let name = file.display().to_string();
    let preset = format!("vehicles/{}.toml", name.trim_end_matches(".toml"));
    let is_preset = config::presets().iter().any(|it| it.path == preset);
    if file.is_file() && (name.ends_with(".toml") || !is_preset) {
        return Ok(());
    }
    let why = if is_preset && !file.exists() {
        "is a preset, which cannot be changed; make a copy of your own: `pathtune config init DIR` writes all \
         presets, this one as"
    } else if file.exists() {
        "is not a vehicle's file; name a TOML file, such as, after `pathtune config init DIR`,"
    } else {
        "no such file; `pathtune config init DIR` writes presets to start from, such as"
    };
    let example = if is_preset { preset } else { "vehicles/tesla_model_3.toml".to_owned() };
    Err(Failure::User(format!("{name}: {why} DIR/{example}")))
}

fn resolve(file: &Path) -> Result<Vehicle, Failure> {
    check_is_file(file)?;
    let name = file.to_str().ok_or_else(|| {
        Failure::User(format!("{}: the name of a vehicle's file must be UTF-8", file.display()))
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
    let rank = match (it.rank_mean.or(it.rank_value).or(it.rank_distance), it.grid_size) {
        (Some(rank), Some(size)) => format!("{rank} of {size}"),
        _ => "–".to_owned(),
    };
    [it.digest.chars().take(12).collect(), rank, it.promoted_at.clone()]
}

/// Says how the parameters of a manoeuvre changed. Old and new are given as the law's name and its parameters.
fn say_changes(
    file: &Path,
    maneuver: &str,
    what: &str,
    old: Option<(&str, &NamedParameters)>,
    new: (&str, &NamedParameters),
) -> Result<(), Failure> {
    let (law, parameters) = new;
    let changes: Vec<String> = match old {
        Some((old_law, old)) if old_law == law => changes(old, parameters)
            .iter()
            .map(|it| match it.old == it.new {
                true => format!("{} {}", it.name, trim(it.new)),
                false => format!(
                    "{} {} -> {} ({:+.0} %)",
                    it.name,
                    trim(it.old),
                    trim(it.new),
                    it.percent()
                ),
            })
            .collect(),
        _ => parameters.0.iter().map(|(name, value)| format!("{name} {}", trim(*value))).collect(),
    };
    let of_law = match old {
        Some((old_law, _)) if old_law != law => format!(" (law {old_law} -> {law})"),
        None if law != "paper" => format!(" (law {law})"),
        _ => String::new(),
    };
    say!("{}: {maneuver} {what}{of_law}: {}", file.display(), changes.join(", "));
    Ok(())
}

fn print_json(value: &Value) -> Result<(), Failure> {
    say!("{}", serde_json::to_string_pretty(value).map_err(anyhow::Error::from)?);
    Ok(())
}
