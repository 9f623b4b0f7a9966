//! `pathtune bench`: what a tick of the pipeline costs, compared with rings that only pass its bytes around, and with
//! plain calls. All are measured by turns in one run, because a machine's speed differs from minute to minute.

mod by_clock;
mod pipelines;
mod rings;

use config::{Layers, Scale};
use serde_json::{Value, json};

use self::pipelines::{pipeline, pipelines, waiting};
use self::rings::{Transport, calls, ring};
use crate::cli::BenchArgs;
use crate::words::Failure;
use crate::words::tables::{digits, table_of};
use crate::words::terminal::{say, tell};

/// The manoeuvre that all of them drive, plain calls as well: a tick costs more where the path is curved. Its drives
/// last half a minute, so that the time between drives hardly counts.
pub const MANEUVER: &str = "roundabout";

/// The law of all rows but those that name another.
pub const LAW: &str = "paper";

/// Settings of a law with a grid of `sets` sets (a power of two), spread over the law's whole grid in the manoeuvre: the
/// cost of a tick depends on the gains, too.
///
/// # Errors
/// If there is no such law.
pub fn spread(law: &str, sets: usize) -> anyhow::Result<Vec<String>> {
    let mut layers = Layers::maneuver(MANEUVER)?;
    layers.set_law("law", law)?;
    let config = layers.resolve()?;
    // Each doubling goes to another axis.
    let mut counts = vec![1_u32; config.law.count()];
    for doubling in 0..sets.ilog2() as usize {
        let axes = counts.len();
        counts[doubling % axes] *= 2;
    }
    let mut settings = vec![format!("law_preset={law}")];
    for (parameter, count) in config.law.parameters.iter().zip(counts) {
        let key = &parameter.key;
        let axis = config.grid[key.as_str()];
        // A single value is the textbook's. The values of a logarithmic axis are a step's factor apart.
        settings.push(match (count, parameter.scale) {
            (1, _) => {
                let value = parameter.default;
                format!("grid.{key}={{min={value:?},max={value:?},step={:?}}}", axis.step)
            }
            (_, Scale::Linear) => {
                format!("grid.{key}.step={:?}", (axis.max - axis.min) / f64::from(count - 1))
            }
            (_, Scale::Log) => {
                let factor = (axis.max / axis.min).powf(1.0 / f64::from(count - 1));
                format!("grid.{key}.step={factor:?}")
            }
        });
    }
    Ok(settings)
}

/// The laws that have rows of their own: all that follow a path but [`LAW`].
fn other_laws() -> impl Iterator<Item = &'static str> {
    config::names_in("laws")
        .filter(|name| *name != LAW && config::law_preset(name).is_some_and(|law| law.follows_path))
}

/// Nanoseconds a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Timing {
    tick_ns: f64,
    p50_ns: f64,
    p99_ns: f64,
}

impl Timing {
    /// As a process prints it: mean, median, 99th percentile.
    fn parse(text: &str) -> anyhow::Result<Self> {
        let numbers: Vec<f64> =
            text.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let [tick_ns, p50_ns, p99_ns] = numbers[..] else {
            anyhow::bail!("a measured process printed {text:?}");
        };
        Ok(Self { tick_ns, p50_ns, p99_ns })
    }

    /// Where only the mean is known.
    fn of_mean(tick_ns: f64) -> Self {
        Self { tick_ns, p50_ns: f64::NAN, p99_ns: f64::NAN }
    }
}

/// What is measured, as a row of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Subject {
    Ring(Transport, usize),
    Calls,
    Pipeline(usize),
    Pipelines(usize, usize),
    Observers(usize),
    CallsOf(&'static str),
    PipelineOf(&'static str),
}

impl Subject {
    fn name(self) -> String {
        match self {
            Subject::Ring(Transport::Pipe, _) => "ring/pipe".to_owned(),
            Subject::Ring(Transport::UnixSocket, _) => "ring/unix_socket".to_owned(),
            Subject::Ring(Transport::SharedMemory, 1) => "ring/iceoryx2".to_owned(),
            Subject::Ring(Transport::SharedMemory, fleet) => format!("ring/iceoryx2/fleet={fleet}"),
            Subject::Calls => "calls".to_owned(),
            Subject::Pipeline(fleet) => format!("pipeline/fleet={fleet}"),
            Subject::Pipelines(count, fleet) => format!("pipelines={count}/fleet={fleet}"),
            Subject::Observers(count) => format!("observers={count}"),
            Subject::CallsOf(law) => format!("law/{law}/calls"),
            Subject::PipelineOf(law) => format!("law/{law}/pipeline"),
        }
    }

    fn fleet(self) -> usize {
        match self {
            Subject::Ring(_, fleet) | Subject::Pipeline(fleet) | Subject::Pipelines(_, fleet) => {
                fleet
            }
            Subject::Calls
            | Subject::Observers(_)
            | Subject::CallsOf(_)
            | Subject::PipelineOf(_) => 1,
        }
    }

    fn measure(self) -> anyhow::Result<Timing> {
        match self {
            Subject::Ring(transport, fleet) => ring(transport, fleet),
            Subject::Calls => calls(LAW),
            Subject::Pipeline(fleet) => pipeline(LAW, fleet, 0),
            Subject::Observers(count) => pipeline(LAW, 1, count),
            Subject::CallsOf(law) => calls(law),
            Subject::PipelineOf(law) => pipeline(law, 1, 0),
            // As if they were one pipeline, to compare with one.
            Subject::Pipelines(count, fleet) => {
                Ok(Timing::of_mean(1e9 * fleet as f64 / pipelines(count, fleet)?))
            }
        }
    }
}

/// Every row; rows that belong together follow each other.
fn subjects() -> Vec<Subject> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut subjects = vec![Subject::Calls];
    for fleet in [1, 4, 16, 64] {
        subjects.extend([Subject::Ring(Transport::SharedMemory, fleet), Subject::Pipeline(fleet)]);
    }
    subjects.extend([Subject::Ring(Transport::Pipe, 1), Subject::Ring(Transport::UnixSocket, 1)]);
    subjects.extend([1, 16].map(|fleet| Subject::Pipelines(cores, fleet)));
    subjects.extend([1, 3, 6].map(Subject::Observers));
    subjects.extend(other_laws().flat_map(|law| [Subject::CallsOf(law), Subject::PipelineOf(law)]));
    subjects
}

/// Measures everything in turn, several times, and prints medians.
///
/// # Errors
/// If a pipeline cannot be kept alive.
pub(crate) fn bench(args: &BenchArgs) -> Result<(), Failure> {
    if let Some(time) = args.realtime {
        return by_clock::bench(time, args.json);
    }
    let mut subjects = subjects();
    if !args.only.is_empty() {
        subjects.retain(|it| args.only.iter().any(|only| it.name().starts_with(only)));
    }
    if subjects.is_empty() {
        let names: Vec<String> = self::subjects().iter().map(|it| it.name()).collect();
        let why = format!("--only: no row begins with this; there are {}", names.join(", "));
        return Err(Failure::User(why));
    }
    let mut rounds: Vec<Vec<Timing>> = vec![Vec::new(); subjects.len()];
    for round in 1..=args.rounds {
        for (subject, timings) in subjects.iter().zip(&mut rounds) {
            if !args.json {
                tell!("round {round} of {}: {}", args.rounds, subject.name());
            }
            timings.push(subject.measure()?);
        }
    }
    let rows: Vec<(Subject, Timing)> =
        subjects.into_iter().zip(rounds.iter().map(|timings| medians(timings))).collect();
    if !args.only.is_empty() {
        return if args.json {
            print_json(&rows, json!({}))
        } else {
            print_rows(&rows, args.rounds)
        };
    }
    if !args.json {
        tell!("waiting for a slow vehicle");
    }
    let (waiting, start_up) = waiting()?;
    if args.json {
        let processes: Vec<Value> = waiting
            .iter()
            .map(|process| {
                json!({
                    "name": process.name,
                    "cpu_waiting": process.cpu,
                    "rss_bytes": process.rss_bytes,
                    "shared_bytes": process.shared_bytes,
                })
            })
            .collect();
        let start_up_ms = start_up.as_secs_f64() * 1e3;
        return print_json(&rows, json!({ "processes": processes, "start_up_ms": start_up_ms }));
    }
    print_rows(&rows, args.rounds)?;
    let mut table = table_of(&[
        "waiting for a vehicle of 10 ms a tick",
        "% of a core",
        "RSS MiB",
        "of it shared",
    ]);
    for process in waiting {
        let mib = |bytes: u64| format!("{:.1}", bytes as f64 / f64::from(1 << 20));
        table.add_row([
            process.name,
            format!("{:.1}", 100.0 * process.cpu),
            mib(process.rss_bytes),
            mib(process.shared_bytes),
        ]);
    }
    say!("\n{table}");
    say!("from the start of a pipeline to its first drive: {:.0} ms", start_up.as_secs_f64() * 1e3);
    Ok(())
}

fn row_json(subject: Subject, timing: Timing) -> Value {
    json!({
        "name": subject.name(),
        "tick_ns": timing.tick_ns,
        "ticks_per_s": 1e9 / timing.tick_ns,
        "vehicle_ticks_per_s": 1e9 / timing.tick_ns * subject.fleet() as f64,
        "p50_ns": known(timing.p50_ns),
        "p99_ns": known(timing.p99_ns),
    })
}

fn print_json(rows: &[(Subject, Timing)], mut with: Value) -> Result<(), Failure> {
    with["rows"] = rows.iter().map(|(subject, timing)| row_json(*subject, *timing)).collect();
    say!("{with}");
    Ok(())
}

fn print_rows(rows: &[(Subject, Timing)], rounds: u32) -> Result<(), Failure> {
    let of = |subject: Subject| {
        let row = rows.iter().find(|(other, _)| *other == subject);
        row.map_or(f64::NAN, |(_, timing)| timing.tick_ns)
    };
    let calls = of(Subject::Calls);
    let mut table = table_of(&[
        "",
        "µs a tick",
        "p50",
        "p99",
        "× bare ring",
        "ns a vehicle and tick",
        "× calls",
    ]);
    for (subject, timing) in rows {
        let fleet = subject.fleet();
        let ring = of(Subject::Ring(Transport::SharedMemory, fleet));
        let each_ns = timing.tick_ns / fleet as f64;
        // With --only, what a row is compared with may not have been measured.
        let shown =
            |number: f64, count| known(number).map_or("–".to_owned(), |it| digits(it, count));
        let us = |ns: f64| shown(ns / 1e3, 2);
        table.add_row([
            subject.name(),
            us(timing.tick_ns),
            us(timing.p50_ns),
            us(timing.p99_ns),
            shown(timing.tick_ns / ring, 2),
            shown(each_ns, 0),
            shown(each_ns / calls, 1),
        ]);
    }
    say!("{table}");
    say!(
        "medians of {rounds} rounds, all rows in turn; the processes of a ring or pipeline share one core"
    );
    let median = |subject: Subject| {
        rows.iter().find(|(other, _)| *other == subject).map(|(_, timing)| timing.p50_ns)
    };
    let (ring, one) =
        (median(Subject::Ring(Transport::SharedMemory, 1)), median(Subject::Pipeline(1)));
    if let (Some(ring), Some(one)) = (ring, one) {
        say!("fleet of 1: the median tick is {:.2} of the bare ring's", one / ring);
    }
    if let (Some(ring), Some(sixteen), Some(calls)) =
        (ring, median(Subject::Pipeline(16)), known(calls))
    {
        say!(
            "fleet of 16: a vehicle and tick beyond plain calls costs {:.2} of a sixteenth of the bare ring's median tick",
            (sixteen / 16.0 - calls) / (ring / 16.0),
        );
    }
    if let Some(ratio) = known(of(Subject::Pipeline(64)) / 64.0 / calls) {
        say!("fleet of 64: a vehicle and tick costs {ratio:.2} × plain calls");
    }
    for count in [1, 3, 6] {
        if let (Some(one), Some(watched)) = (one, median(Subject::Observers(count))) {
            say!("{count} observers: the median tick is {:.3} of that without", watched / one);
        }
    }
    for (subject, timing) in rows {
        if let Subject::Pipelines(count, fleet) = *subject
            && let Some(gain) = known(of(Subject::Pipeline(fleet)) / timing.tick_ns)
        {
            say!("{count} pipelines with fleets of {fleet}: {gain:.2} × one");
        }
    }
    Ok(())
}

fn medians(timings: &[Timing]) -> Timing {
    let of = |number: fn(&Timing) -> f64| {
        let mut numbers: Vec<f64> = timings.iter().map(number).collect();
        numbers.sort_by(f64::total_cmp);
        numbers[numbers.len() / 2]
    };
    Timing {
        tick_ns: of(|timing| timing.tick_ns),
        p50_ns: of(|timing| timing.p50_ns),
        p99_ns: of(|timing| timing.p99_ns),
    }
}

fn known(number: f64) -> Option<f64> {
    number.is_finite().then_some(number)
}
