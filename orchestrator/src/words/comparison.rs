//! The table of `pathtune compare`.

use outcome::{AfterDrives, CompareResult, Compared, Course, Quantile};

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
    if let Some(value) = it.textbook_value {
        let above = 100.0 * Course::regret(value, it.best_value);
        say!("the textbook parameters: {} {value:.4}, {above:.1} % above the best", it.objective);
    }
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

/// Prints how laws compare: what each tuner came to, by the objective itself.
pub(crate) fn print_laws(laws: &[Compared]) -> Result<(), Failure> {
    let Some(first) = laws.first().map(|it| &it.result) else { return Ok(()) };
    let after = format!("recommended after {}: median", first.drives);
    let header = ["law", "textbook", "tuner", &after, "95 % of seeds", "best known"];
    let mut table = table_of(&header);
    for it in laws.iter().map(|it| &it.result) {
        let number = |value: f64| format!("{value:.4}");
        let textbook = it.textbook_value.map_or_else(String::new, number);
        for (place, tuner) in it.tuners.iter().enumerate() {
            let of_law = |text: &str| if place == 0 { text.to_owned() } else { String::new() };
            let value = |regret: Option<f64>| {
                regret.map_or("–".to_owned(), |it_is| number(it.best_value * (1.0 + it_is)))
            };
            let last = tuner.after.last();
            let of_last = |quantile: fn(&AfterDrives) -> Quantile| {
                last.map_or_else(String::new, |last| {
                    let it = quantile(last);
                    format!("{} [{}, {}]", value(it.value), value(it.low), value(it.high))
                })
            };
            table.add_row([
                of_law(&it.law),
                of_law(&textbook),
                tuner.tuner.clone(),
                of_last(|it| it.regret_median),
                of_last(|it| it.regret_q95),
                of_law(&number(it.best_value)),
            ]);
        }
    }
    say!("{}, {}, by {}:", first.maneuver, first.vehicle, first.objective);
    say!("{table}");
    Ok(())
}

/// A row for each training, with its law if there are several.
pub(crate) fn csv(laws: &[Compared], with_law: bool) -> String {
    let first = laws.first().and_then(|it| it.result.tuners.first());
    let marks = first.into_iter().flat_map(|it| &it.after);
    let marks: String = marks.map(|it| format!(",regret_after_{}", it.drives)).collect();
    let law = if with_law { "law," } else { "" };
    let mut text =
        format!("{law}tuner,seed,drives_to_within_2_percent,drives_to_top_1_percent{marks}");
    for it in laws {
        let law = if with_law { format!("{},", it.result.law) } else { String::new() };
        for row in &it.rows {
            let drives = |drives: Option<u32>| drives.map_or(String::new(), |it| it.to_string());
            let regret: String = row.regret.iter().map(|it| format!(",{it}")).collect();
            let [near, top] = [row.to_within_2_percent, row.to_top_1_percent].map(drives);
            text += &format!("\n{law}{},{},{near},{top}{regret}", row.tuner, row.seed);
        }
    }
    text
}
