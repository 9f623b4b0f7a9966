//! The textbook sets beside a tuned one, and whether it beats them.

use config::RunConfig;
use outcome::{Baseline, Baselines, Measures, TrainResult};

use crate::words::Failure;
use crate::words::plants::named;
use crate::words::tables::{digits, table_of};
use crate::words::terminal::say;

/// Prints the textbook sets and the verdict on the tuned one; or why there are none, where there could be.
pub(super) fn print(it: &TrainResult, config: &RunConfig) -> Result<(), Failure> {
    let Some(beside) = &it.baselines else {
        if it.vehicle_drives.is_some() && !config.has_figures_of_the_paper() {
            say!(
                "not compared with textbook sets: they are driven by our simulator alone, and these figures are of drives \
                 that the vehicle made"
            );
        }
        return Ok(());
    };
    let columns = ["off the path: mean m", "max m", "steering travel rad/s", "arrived", "set"];
    let mut table = table_of(&[&["textbook sets"][..], &columns].concat());
    let mut row = |name: String, it: &Measures, set: String| {
        table.add_row([
            name,
            digits(it.path_mean_m, 4),
            digits(it.path_max_m, 3),
            digits(it.steering_travel_radps, 3),
            if it.arrived { "yes" } else { "no" }.to_owned(),
            set,
        ]);
    };
    for set in &beside.sets {
        row(name_of(set), &set.measures, named(&set.gains));
    }
    row("tuned".to_owned(), &it.measures, named(&it.gains));
    say!("\n{table}");
    say!("{}", verdict(beside, &it.measures));
    Ok(())
}

fn name_of(set: &Baseline) -> String {
    let compensated = match set.compensated {
        None => "",
        Some(true) => ", dead time compensated",
        Some(false) => ", not compensated",
    };
    format!("{}{compensated}", set.law)
}

/// What the tuned set is worth beside the best textbook set.
fn verdict(beside: &Baselines, tuned: &Measures) -> String {
    let best = &beside.sets[beside.best];
    let name = name_of(best);
    let figures = format!(
        "{} m against {} m off the path, at a steering travel of {} against {} rad/s",
        digits(tuned.path_mean_m, 4),
        digits(best.measures.path_mean_m, 4),
        digits(tuned.steering_travel_radps, 3),
        digits(best.measures.steering_travel_radps, 3),
    );
    let by = beside.ratio.map_or(String::new(), |ratio| {
        format!(" ({} % of its distance)", digits(100.0 * ratio, 0))
    });
    // What rounds to the same distance is no win.
    let is_as_near = |ratio: f64| (0.995..1.0).contains(&ratio);
    match (beside.beaten, tuned.arrived || !best.measures.arrived) {
        (true, _) if beside.ratio.is_some_and(is_as_near) => format!(
            "the tuned set is as near to the path as the best textbook set, {name}: {figures}{by}"
        ),
        (true, _) => format!("the tuned set beats the best textbook set, {name}: {figures}{by}"),
        (false, true) if tuned.value < best.measures.value => format!(
            "the best textbook set, {name}, is nearer to the path: {figures}{by}; by the objective, with its limits and prices, the \
             tuned set is better: {} against {}",
            digits(tuned.value, 4),
            digits(best.measures.value, 4)
        ),
        (false, true) => format!(
            "the tuned set does not beat the best textbook set, {name}: {figures}{by}; drive that one, or tune its law with more \
             drives"
        ),
        (false, false) => format!(
            "the tuned set does not arrive at the end of the path, and the best textbook set does, {name}: {figures}"
        ),
    }
}

#[cfg(test)]
mod tests {
    use config::NamedParameters;

    use super::*;

    #[test]
    fn a_set_that_does_not_beat_the_textbook_is_told_so() {
        let of = |path_mean_m, arrived| {
            let value = if path_mean_m == 0.3 { 0.05 } else { path_mean_m };
            Measures { path_mean_m, value, arrived, ..Measures::default() }
        };
        let beside = |beaten, ratio| Baselines {
            sets: vec![Baseline {
                law: "stanley".to_owned(),
                compensated: Some(true),
                gains: NamedParameters::default(),
                measures: of(0.1, true),
            }],
            best: 0,
            ratio: Some(ratio),
            beaten,
        };
        let words = |beaten, ratio, tuned| verdict(&beside(beaten, ratio), &tuned);
        let better = words(true, 0.25, of(0.025, true));
        assert!(better.contains("beats the best textbook set, stanley, dead time compensated"));
        assert!(better.contains("0.0250 m against 0.1000 m") && better.contains("25 %"));
        let same = words(true, 0.996, of(0.0996, true));
        assert!(same.contains("is as near") && !same.contains("beats"), "{same}");
        assert!(words(false, 1.5, of(0.15, true)).contains("does not beat"));
        let calmer = words(false, 3.0, of(0.3, true));
        assert!(
            calmer.contains("by the objective") && !calmer.contains("drive that one"),
            "{calmer}"
        );
        assert!(words(false, 0.5, of(0.05, false)).contains("does not arrive"));
    }
}
