//! The table of `pathtune compare`.

use outcome::{CompareResult, CompareRow, Quantile};

use crate::words::Failure;
use crate::words::tables::table_of;
use crate::words::terminal::say;

/// Prints a comparison.
pub(crate) fn print(it: &CompareResult) -> Result<(), Failure> {
    let mut noise = if it.noise { "with noise" } else { "without noise" }.to_owned();
    if it.plants > 1 {
        noise += &format!(", over {} plants", it.plants);
    }
    say!(
        "{}, {}, {}, law {}: {} trainings with each tuner, {} drives in each; in brackets 95 % intervals",
        it.maneuver,
        it.vehicle,
        noise,
        it.law,
        it.seeds,
        it.drives
    );
    say!("");
    let header = [
        "drives to a set",
        "within 2 % of the best: median",
        "95 % of seeds",
        "in the top 1 %: median",
        "95 % of seeds",
        "seeds that reached it",
    ];
    let mut table = table_of(&header);
    for tuner in &it.tuners {
        let (near, top) = (&tuner.to_within_2_percent, &tuner.to_top_1_percent);
        let drives = |quantile: &Quantile| quantile.as_drives(it.drives);
        table.add_row([
            tuner.tuner.clone(),
            drives(&near.median),
            drives(&near.q95),
            drives(&top.median),
            drives(&top.q95),
            top.reached.as_percent(),
        ]);
    }
    say!("{table}");
    say!("");
    let mut header = vec!["recommended, above the best".to_owned()];
    for after in it.tuners.iter().take(1).flat_map(|it| &it.after) {
        header.push(format!("after {}: median", after.drives));
        header.push("95 % of seeds".to_owned());
        header.push("within 5 %".to_owned());
    }
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let mut table = table_of(&header);
    for tuner in &it.tuners {
        let mut cells = vec![tuner.tuner.clone()];
        for after in &tuner.after {
            cells.push(after.regret_median.as_percent());
            cells.push(after.regret_q95.as_percent());
            cells.push(after.within_5_percent.as_percent());
        }
        table.add_row(cells);
    }
    say!("{table}");
    say!("");
    let best: Vec<String> =
        it.best_gains.0.iter().map(|(key, value)| format!("{key} {value}")).collect();
    say!("the best set: {}; {} {:.4}", best.join(", "), it.objective, it.best_value);
    if it.noise {
        say!(
            "a set's true value is its mean over {} drives{} that no tuner saw, and over {} others if it seems nearly as good as \
             the best",
            it.drives_of_truth,
            if it.plants > 1 { " on each plant" } else { "" },
            if it.plants > 1 { 16 } else { 480 },
        );
    }
    Ok(())
}

/// A row for each training.
pub(crate) fn csv(it: &CompareResult, rows: &[CompareRow]) -> String {
    let marks = it.tuners.iter().take(1).flat_map(|it| &it.after);
    let marks: String = marks.map(|it| format!(",regret_after_{}", it.drives)).collect();
    let mut text = format!("tuner,seed,drives_to_within_2_percent,drives_to_top_1_percent{marks}");
    for row in rows {
        let drives = |drives: Option<u32>| drives.map_or(String::new(), |it| it.to_string());
        let regret: String = row.regret.iter().map(|it| format!(",{it}")).collect();
        let [near, top] = [row.to_within_2_percent, row.to_top_1_percent].map(drives);
        text += &format!("\n{},{},{near},{top}{regret}", row.tuner, row.seed);
    }
    text
}
