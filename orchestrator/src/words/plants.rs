//! What a set does on plausible plants.

use config::{NamedParameters, RunConfig};
use outcome::{Extent, Margin, PlantCheck, PlantDrive};

use crate::words::Failure;
use crate::words::tables::{digits, or_dash, table_of, trim};
use crate::words::terminal::say;

/// Prints a set's drives on the plants, and whether it is fragile.
pub(super) fn print(it: &PlantCheck, config: &RunConfig) -> Result<(), Failure> {
    let objective = &*config.objective.name;
    let mut columns =
        vec!["on plants like this car", objective, "regret", "off the path: mean m", "max m"];
    if config.is_to_arrive() {
        columns.push("arrived");
    }
    let mut table = table_of(&columns);
    for plant in &it.plants {
        let PlantDrive { name, value, regret, path_mean_m, path_max_m, arrived } = plant;
        let mut cells = vec![
            name.clone(),
            digits(*value, 4),
            regret.map_or("–".to_owned(), |it| format!("{:.1} %", 100.0 * it)),
            digits(*path_mean_m, 4),
            digits(*path_max_m, 3),
        ];
        if config.is_to_arrive() {
            cells.push(if *arrived { "yes" } else { "no" }.to_owned());
        }
        table.add_row(cells);
    }
    say!("\n{table}");
    if it.compared > 0 {
        say!(
            "regret: how much more than the best on that plant of the {} nominally best sets and this one",
            it.compared
        );
    }
    if let Some(line) = it.margin.as_ref().map(margin) {
        say!("{line}");
    }
    say!("{}", verdict(it, config));
    let fresh = &it.fresh;
    let missing = match fresh.not_arrived {
        count if count > 0 && config.is_to_arrive() => format!(", {count} did not arrive"),
        _ => String::new(),
    };
    say!(
        "on {} more plants like these, which chose nothing{}: {} m off the path on average at 95 % of them, {} at most; {} \
         beyond 1 m{missing}",
        fresh.plants,
        if fresh.noise { ", with noise" } else { "" },
        digits(fresh.path_mean_p95_m, 4),
        digits(fresh.path_mean_max_m, 4),
        fresh.beyond_1_m,
    );
    if let Some(other) = &it.alternative {
        say!(
            "steadier over these plants: {} with {objective} {} at worst instead of {}, and {} with the vehicle's file",
            named(&other.gains),
            digits(other.worst_value, 4),
            digits(it.worst_value, 4),
            or_dash(Some(other.value), 4),
        );
    }
    Ok(())
}

/// A set with its names, as short as tables show it.
pub(super) fn named(set: &NamedParameters) -> String {
    let pairs: Vec<String> =
        set.0.iter().map(|(name, value)| format!("{name}={}", trim(*value))).collect();
    pairs.join(", ")
}

/// From where beside a straight path the loop converges.
fn regions(it: &Margin) -> String {
    let extent = |it: &Extent| format!("± {:.3} m and ± {:.3} rad", it.offset_m, it.heading_rad);
    let mut words = String::new();
    if let Some(certified) = &it.certified {
        words +=
            &format!("; it is certain to come back to a straight path from {}", extent(certified));
    }
    if let Some(simulated) = &it.simulated {
        let begins =
            if it.certified.is_some() { ", and" } else { "; it comes back to a straight path" };
        words += &format!("{begins} from {} when simulated", extent(simulated));
    }
    match (&it.certified, &it.no_certificate) {
        (None, Some(why)) => words + "; " + why,
        _ => words,
    }
}

/// How much later the steering may act and from where the loop converges, or why that is not known.
pub(crate) fn margin(it: &Margin) -> String {
    let Margin { speed_mps, additional_dead_time_s, unknown, .. } = it;
    let late = match (additional_dead_time_s, unknown) {
        (_, Some(why)) => why.clone(),
        (Some(margin_s), None) => format!(
            "the steering may act {:.0} ms later at {speed_mps:.2} m/s until the loop oscillates (Δ)",
            1000.0 * margin_s
        ),
        (None, None) => {
            format!(
                "however late the steering acts at {speed_mps:.2} m/s, the loop does not oscillate (Δ)"
            )
        }
    };
    late + &regions(it)
}

/// What helps where a set is fragile. A training over plants chooses one that is not, if it has driven one.
pub(crate) fn steadier(config: &RunConfig) -> String {
    if !config.is_over_plants() {
        return "train with --over default or with another law, or take a steadier set".to_owned();
    }
    // That of the training does not help.
    let other = if config.law.name == "pure_pursuit" { "stanley" } else { "pure_pursuit" };
    format!(
        "none of the best sets that were driven over plants holds: drive more slowly (reference.speed_mps, or the path's \
         speeds), or train another law, as in --law {other}"
    )
}

/// Whether the set is fragile, and why.
pub(crate) fn verdict(it: &PlantCheck, config: &RunConfig) -> String {
    match &it.fragile {
        Some(why) => {
            format!("the set is fragile: {why}. It may shake on the car; {}", steadier(config))
        }
        None => {
            let known = it.margin.as_ref().and_then(|it| it.additional_dead_time_s);
            let and = known.map_or(String::new(), |margin_s| {
                format!(", and its steering may act {:.0} ms later", 1000.0 * margin_s)
            });
            format!(
                "the set is not fragile: no such plant takes it more than twice as far from the path{and}"
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use config::Layers;

    #[test]
    fn what_may_hold_instead_is_another_law() {
        for (law, other) in [("pure_pursuit", "--law stanley"), ("stanley", "--law pure_pursuit")] {
            let mut layers = Layers::maneuver("smooth_lane").unwrap();
            layers.set_law("--law", law).unwrap();
            let alone = super::steadier(&layers.clone().resolve().unwrap());
            assert!(alone.contains("--over default"), "{alone}");
            layers.set("over.by=mean").unwrap();
            let over = super::steadier(&layers.resolve().unwrap());
            assert!(over.contains(other), "{over}");
        }
    }
}
