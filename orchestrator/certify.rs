//! `pathtune certify`: tables of what the certificate computes, and its files.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;

use certificate::{
    AtSpeed, CLAIM, Certificate, Certified, Extent, LARGEST_LEVEL, SetAtSpeed, Start, Subject,
};
use config::{Parameters, PlantChange, RunConfig, read_small};
use orchestrator::cli::CertifyArgs;
use orchestrator::commands::{Certifiable, certifiable};
use orchestrator::words::{Failure, print_line, print_table};
use serde_json::json;

use crate::tools::refuse_others;

/// Certifies, or verifies a certificate; returns whether what was to be verified holds.
pub(crate) fn certify(args: &CertifyArgs) -> Result<bool, Failure> {
    if let Some(file) = &args.check {
        return check(file, args.json);
    }
    let Certifiable { config, sets, plants, note } = certifiable(args)?;
    if let Some(file) = args.write.as_deref().filter(|file| file.exists()) {
        return Err(Failure::User(format!("--write {}: exists already", file.display())));
    }
    let subject = Subject::new(&config, &sets).map_err(Failure::User)?;
    let speeds =
        if args.speeds.is_empty() { vec![own_speed(&config)] } else { args.speeds.clone() };
    // Each speed by itself: the figures do not depend on it.
    let all: Vec<AtSpeed> = std::thread::scope(|scope| {
        let subject = &subject;
        let work = speeds.iter().map(|speed| scope.spawn(move || subject.at(*speed)));
        let work: Vec<_> = work.collect();
        work.into_iter().map(|it| it.join().expect("the certificate does not panic")).collect()
    });
    let of_plants = plants
        .iter()
        .map(|plant| OnPlant::new(&config, plant, &sets, &speeds))
        .collect::<Result<Vec<OnPlant>, String>>()
        .map_err(Failure::User)?;
    if let Some(folder) = &args.report {
        draw(folder, &config, &note, &subject, &all)?;
    }
    if args.json {
        let text = json!({
            "plants": of_plants, "note": note, "car": subject.car(), "condition": CLAIM, "fragile_below_s": config.over.fragile_below_s,
            "no_certificate": subject.uncertain(), "speeds": all,
        });
        print_line(&serde_json::to_string_pretty(&text).map_err(anyhow::Error::from)?)?;
    } else {
        print(&subject, &note, &all, &of_plants, config.over.fragile_below_s)?;
    }
    if let Some(file) = &args.write {
        let regions: Vec<Certified> = all.into_iter().flat_map(|it| it.regions).collect();
        if regions.is_empty() {
            let why = "there is no certified region to write";
            return Err(Failure::User(format!("--write {}: {why}", file.display())));
        }
        write(file, &Certificate::new(&config.vehicle.name, subject.car(), regions))?;
    }
    Ok(true)
}

/// The highest speed of the path's reference.
fn own_speed(config: &RunConfig) -> f64 {
    config.path.speeds_mps.iter().copied().reduce(f64::max).unwrap_or(config.reference.speed_mps)
}

fn print(
    subject: &Subject,
    note: &str,
    all: &[AtSpeed],
    of_plants: &[OnPlant],
    fragile_below_s: f64,
) -> Result<(), Failure> {
    print_line(note)?;
    let header = [
        "gains for",
        "m/s",
        "stable",
        "Δ ms",
        "",
        "certified region",
        "simulated region",
        "rate used",
    ];
    let rows = all.iter().flat_map(|at| {
        at.sets.iter().map(|it| {
            let mut cells = cells(it, at.speed_mps);
            let share = at.steering_rate_share;
            cells.push(share.map_or("–".to_owned(), |it| format!("{:.0} %", 100.0 * it)));
            cells
        })
    });
    print_table(&header, rows)?;
    if !of_plants.is_empty() {
        let header = [&["on plants like this car"], &header[..header.len() - 1]].concat();
        let rows = of_plants.iter().flat_map(|plant| {
            plant.speeds.iter().flat_map(|(speed_mps, sets)| {
                let of = |it| [vec![plant.name.clone()], cells(it, *speed_mps)].concat();
                sets.iter().map(of)
            })
        });
        print_table(&header, rows)?;
    }
    for at in all {
        for it in &at.sets {
            if let Some(why) = &it.no_certificate {
                print_line(&format!("{} at {} m/s: {why}", it.maneuver, at.speed_mps))?;
            }
        }
    }
    if all.iter().any(|at| !at.joints.is_empty()) {
        let curve = |curvature: f64| match curvature {
            0.0 => "straight".to_owned(),
            it => format!("{} R{:.1}", if it > 0.0 { "left" } else { "right" }, 1.0 / it.abs()),
        };
        let header = ["joint of the path", "m/s", "at m", "V", "simulated up to", ""];
        let rows = all.iter().flat_map(|at| {
            at.joints.iter().map(|it| {
                let kink = if it.kink_rad.abs() > 1e-6 {
                    format!(", kink {:+.2} rad", it.kink_rad)
                } else {
                    String::new()
                };
                let [from, to] = it.curvatures.map(curve);
                let number = |it: Option<f64>| it.map_or("–".to_owned(), |it| format!("{it:.2}"));
                let simulated = match it.simulated_value {
                    Some(value) if value >= LARGEST_LEVEL => format!("{LARGEST_LEVEL} or more"),
                    other => number(other),
                };
                vec![
                    format!("{from} → {to}{kink}"),
                    format!("{}", at.speed_mps),
                    format!("{:.1}", it.along_m),
                    number(it.value),
                    simulated,
                    if it.is_outside() { "outside" } else { "" }.to_owned(),
                ]
            })
        });
        print_table(&header, rows)?;
    }
    let outside = all.iter().flat_map(|at| &at.joints).filter(|it| it.is_outside()).count();
    if outside > 0 {
        print_line(&format!(
            "warning: {outside} joints lie outside of the simulated region: with noise, a drive may be lost there"
        ))?;
    }
    if subject.passed_over() > 0 {
        print_line(&format!(
            "V at joints: not for this path, which is a line through points with {} joints",
            subject.passed_over()
        ))?;
    }
    print_line(&format!(
        "Δ: how much later the steering may act until the loop oscillates; below {:.0} ms a set is fragile",
        1000.0 * fragile_below_s
    ))?;
    print_line(
        "simulated region: 300 of 300 random starts converge, which is at least 99 % with a confidence of 95 %; none \
         larger than ± 2 m, ± 0.6 rad (for a full-size car) is tried",
    )?;
    if all.iter().flat_map(|at| &at.sets).all(|it| it.certified.is_none()) {
        return Ok(());
    }
    print_line(&format!("what a certified region means: {CLAIM}"))
}

/// What is said of a set: for a row.
fn cells(it: &SetAtSpeed, speed_mps: f64) -> Vec<String> {
    let extent = |it: Option<Extent>| match it {
        Some(it) => format!("± {:.3} m, ± {:.3} rad", it.offset_m, it.heading_rad),
        None => "–".to_owned(),
    };
    let margin = match it.additional_dead_time_s {
        Some(margin_s) => format!("{:.0}", 1000.0 * margin_s),
        None if it.stable.is_none() => "–".to_owned(),
        None => "no bound".to_owned(),
    };
    let stable = match it.stable {
        Some(true) => "yes",
        Some(false) => "no",
        None => "–",
    };
    vec![
        it.maneuver.clone(),
        format!("{speed_mps}"),
        stable.to_owned(),
        margin,
        if it.fragile { "fragile" } else { "" }.to_owned(),
        extent(it.certified),
        extent(it.simulated),
    ]
}

/// What is said of the sets on a plant, by what drives it.
#[derive(Debug, serde::Serialize)]
struct OnPlant {
    name: String,
    /// Each speed, as the plant has it, with what is said of the sets.
    speeds: Vec<(f64, Vec<SetAtSpeed>)>,
}

impl OnPlant {
    fn new(
        config: &RunConfig,
        change: &PlantChange,
        sets: &[Parameters],
        speeds: &[f64],
    ) -> Result<Self, String> {
        let (driving, plant) = (config.driving_plant(change), config.with_plant(change));
        let faster = driving.reference.speed_mps / config.reference.speed_mps;
        let subject = Subject::on_plant(&driving, &plant, sets)?;
        let at = |speed: &f64| (speed * faster, subject.sets_at(speed * faster));
        Ok(Self { name: change.name.clone(), speeds: speeds.iter().map(at).collect() })
    }
}

/// Speeds at which Δ is drawn.
const DRAWN: u32 = 40;

/// Draws the regions and Δ.
fn draw(
    folder: &Path,
    config: &RunConfig,
    note: &str,
    subject: &Subject,
    all: &[AtSpeed],
) -> Result<(), Failure> {
    refuse_others("--report", folder)?;
    let region = |at: &AtSpeed, (set, starts): (&SetAtSpeed, Vec<Start>)| {
        let is_it = |it: &&Certified| {
            let of = &it.region.equilibrium;
            it.maneuver == set.maneuver && of.curvature == 0.0 && of.reference_mps == at.speed_mps
        };
        let known = at.regions.iter().find(is_it).filter(|_| set.certified.is_some());
        let cut = |it: &Certified| [0, 1].map(|row| [0, 1].map(|column| it.region.p[row][column]));
        report::RegionPicture {
            maneuver: set.maneuver.clone(),
            speed_mps: at.speed_mps,
            p: known.map(cut),
            simulated: set.simulated.map(|it| (it.offset_m, it.heading_rad)),
            starts: starts.iter().map(|it| (it.offset_m, it.heading_rad, it.converges)).collect(),
            no_certificate: set.no_certificate.clone(),
        }
    };
    let regions = all.iter().flat_map(|at| {
        let starts = subject.starts_at(at.speed_mps);
        at.sets.iter().zip(starts).map(|of| region(at, of)).collect::<Vec<_>>()
    });
    let fastest_mps = all.iter().map(|at| at.speed_mps).fold(own_speed(config), f64::max);
    let points: Vec<(f64, Vec<f64>)> = (1..=DRAWN)
        .map(|step| 1.25 * fastest_mps * f64::from(step) / f64::from(DRAWN))
        .map(|speed_mps| (speed_mps, subject.additional_dead_times_s(speed_mps)))
        .collect();
    let curve = |(index, set): (usize, &SetAtSpeed)| report::MarginCurve {
        maneuver: set.maneuver.clone(),
        points: points.iter().map(|(speed_mps, of)| (*speed_mps, of[index])).collect(),
    };
    let mut notes = vec![format!(
        "Δ: how much later the steering may act until the loop oscillates; below {:.0} ms a set is fragile.",
        1000.0 * config.over.fragile_below_s
    )];
    match subject.uncertain() {
        Some(why) => notes.push(why),
        None => notes.push(format!("What a certified region means: {CLAIM}")),
    }
    let page = report::CertifiedGains {
        note: note.to_owned(),
        vehicle: config.vehicle.name.clone(),
        regions: regions.collect(),
        margins: all[0].sets.iter().enumerate().map(curve).collect(),
        fragile_below_s: config.over.fragile_below_s,
        notes,
    };
    let page = report::write_certified(folder, &page)
        .map_err(|why| Failure::User(format!("--report {why}")))?;
    eprintln!("pathtune: wrote {}", page.display());
    Ok(())
}

fn write(file: &Path, certificate: &Certificate) -> Result<(), Failure> {
    let wrong = |why: String| Failure::User(format!("--write {}: {why}", file.display()));
    let text = serde_json::to_string_pretty(certificate).map_err(anyhow::Error::from)?;
    let mut out = OpenOptions::new()
        .write(true)
        .create_new(true)
        .open(file)
        .map_err(|error| wrong(error.to_string()))?;
    out.write_all(format!("{text}\n").as_bytes()).map_err(|error| wrong(error.to_string()))?;
    eprintln!("pathtune: wrote {} with {} regions", file.display(), certificate.regions.len());
    Ok(())
}

/// Verifies a file; returns whether all of it holds.
fn check(file: &Path, as_json: bool) -> Result<bool, Failure> {
    let wrong = |why: String| Failure::User(format!("--check {}: {why}", file.display()));
    let text = read_small(file).map_err(|error| wrong(error.to_string()))?;
    let certificate: Certificate = serde_json::from_str(&text)
        .map_err(|error| wrong(format!("is no certificate: {error}")))?;
    let verdicts = certificate.verify().map_err(wrong)?;
    let refused = verdicts.iter().filter(|it| it.is_err()).count();
    if as_json {
        let each = certificate.regions.iter().zip(&verdicts).map(|(it, verdict)| {
            let at = &it.region.equilibrium;
            let why = verdict.as_ref().err().map(ToString::to_string);
            json!({
                "maneuver": it.maneuver, "gains": it.gains, "speed_mps": at.reference_mps,
                "curvature": at.curvature, "holds": verdict.is_ok(), "refused": why,
            })
        });
        let text = json!({ "vehicle": certificate.vehicle, "regions": each.collect::<Vec<_>>() });
        print_line(&serde_json::to_string_pretty(&text).map_err(anyhow::Error::from)?)?;
    } else {
        let header = ["gains for", "m/s", "curvature 1/m", "verdict"];
        let rows = certificate.regions.iter().zip(&verdicts).map(|(it, verdict)| {
            let at = &it.region.equilibrium;
            vec![
                it.maneuver.clone(),
                format!("{}", at.reference_mps),
                format!("{:.4}", at.curvature),
                verdict.as_ref().err().map_or("holds".to_owned(), |why| format!("refused: {why}")),
            ]
        });
        print_table(&header, rows)?;
        let count = verdicts.len();
        print_line(&match refused {
            0 => format!("all {count} regions hold for {}", certificate.vehicle),
            _ => format!("{refused} of {count} regions are refused"),
        })?;
    }
    Ok(refused == 0)
}
