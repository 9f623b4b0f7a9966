//! What many simulated plants and few drives of the vehicle say of a set.

use config::RunConfig;
use outcome::{OfDrives, SimulatedFirst};

use crate::words::Failure;
use crate::words::tables::digits;
use crate::words::terminal::say;

/// Prints what was simulated, what was driven, and what plants say that chose nothing.
pub(super) fn print(it: &SimulatedFirst, config: &RunConfig) -> Result<(), Failure> {
    let objective = &*config.objective.name;
    let within_m = digits(it.within_m, 2);
    say!(
        "\nsimulated first: the best {} of {} sets on {} plants like this car; {} of them stay within {within_m} m of the path \
         on all of these, and only those were driven",
        it.on_all,
        it.candidates,
        it.plants,
        it.within,
    );
    let share = |low: f64, high: f64| format!("{:.1} % to {:.1} %", 100.0 * low, 100.0 * high);
    say!(
        "{} of {} drives of the vehicle were beyond {within_m} m (95 % interval of their share: {}); the farthest was {} m",
        it.beyond,
        it.drives,
        share(it.beyond_low, it.beyond_high),
        digits(it.worst_m, 3),
    );
    if it.not_arrived > 0 {
        say!(
            "{} of {} drives of the vehicle did not arrive{}",
            it.not_arrived,
            it.drives,
            match (it.chosen_did_not_arrive, it.fresh.not_arrived) {
                (true, 0) =>
                    ", one with the chosen set among them; that set arrives on all plants that chose nothing, so this car is not \
                     like them: identify it, or look for what is wrong with a drive (pathtune drive)",
                (true, _) => ", one with the chosen set among them",
                (false, _) => "",
            }
        );
    }
    let predicted = |of: &OfDrives| {
        let [value, low, high] = [of.predicted, of.low, of.high].map(|it| digits(it, 4));
        let times = if of.drives == 1 { "drive" } else { "drives" };
        format!("{objective} {value} [{low}, {high}] after {} {times}", of.drives)
    };
    let if_like = "if the car is one of plants like these";
    say!("the chosen set: {}; the interval holds 95 %, {if_like}", predicted(&it.chosen));
    let textbook = &it.textbook;
    match &textbook.driven {
        _ if textbook.is_chosen => {
            say!("it is the textbook's set of this law: no other did better")
        }
        Some(of) => say!(
            "the textbook's set of this law, {}: {}",
            super::plants::named(&textbook.gains),
            predicted(of)
        ),
        None if textbook.simulated_worst_m > it.within_m => say!(
            "the textbook's set of this law was not driven: it leaves the path by {} m on a simulated plant",
            digits(textbook.simulated_worst_m, 2)
        ),
        None => say!(
            "the textbook's set of this law was not driven: that takes a budget of 3 drives or more"
        ),
    }
    match it.could_stop_after {
        Some(drives) => say!(
            "could stop at drive {drives}: after it no set was expected to be better by more than 1 %"
        ),
        None => say!("another set may still be better by more than 1 %: more --drives would tell"),
    }
    let fresh = &it.fresh;
    let missing = match fresh.not_arrived {
        count if count > 0 && config.is_to_arrive() => format!(", {count} did not arrive"),
        _ => String::new(),
    };
    say!(
        "on {} more plants like these, which chose nothing: {} beyond {within_m} m (95 % interval of their share: {}){missing}; \
         {} m from the path on average at 95 % of them",
        fresh.plants,
        fresh.beyond,
        share(fresh.beyond_low, fresh.beyond_high),
        digits(fresh.path_mean_p95_m, 4),
    );
    say!(
        "beside the best of {} sets on each of these plants: {:.1} mm farther from the path on average at half of them, {:.1} mm at \
         95 % ({objective} {:.1} % and {:.1} % more)",
        fresh.compared + 1,
        1000.0 * fresh.off_best_median_m,
        1000.0 * fresh.off_best_p95_m,
        100.0 * fresh.regret_median,
        100.0 * fresh.regret_p95,
    );
    Ok(())
}
