//! The table of plausible plants.

use config::RunConfig;
use maud::{Markup, html};
use outcome::{Extent, Margin, PlantCheck};

use crate::axis::number;
use crate::page::{parameters_text, table};

/// What a set does on the plants, and whether it is fragile.
pub(crate) fn section(it: &PlantCheck, config: &RunConfig) -> Markup {
    let (objective, is_to_arrive) = (&*config.objective.name, config.is_to_arrive());
    let fresh = &it.fresh;
    html! {
        p {
            @match &it.fragile {
                Some(why) => { "The set is " b { "fragile" } ": " (why) ". It may shake on the car." }
                None => {
                    "The set is " b { "not fragile" } ": no such plant takes it more than twice as far from the path."
                }
            }
            @if let Some(margin) = &it.margin {
                " " (late(margin))
            }
        }
        (table(
            html! { tr {
                th { "plant" } th.number { (objective) } th.number { "regret [%]" }
                th.number { "off the path, mean [m]" } th.number { "largest [m]" }
                @if is_to_arrive { th { "arrived" } }
            } },
            html! {
                @for plant in &it.plants {
                    tr {
                        td { (plant.name) }
                        td.number { (number(plant.value, 4)) }
                        td.number { @match plant.regret { Some(by) => (number(100.0 * by, 1)), None => "–" } }
                        td.number { (number(plant.path_mean_m, 4)) }
                        td.number { (number(plant.path_max_m, 3)) }
                        @if is_to_arrive { td { @if plant.arrived { "yes" } @else { "no" } } }
                    }
                }
            },
        ))
        p {
            "Vehicles that the car may really be, driven by our simulator without noise; what drives them believes in the "
            "vehicle’s file. "
            @if it.compared > 0 {
                "Regret is how much more the value is than the best on that plant of the " (it.compared)
                " nominally best sets and this one. "
            }
            "On " (fresh.plants) " more plants like these, which chose nothing" @if fresh.noise { ", with noise" } ": "
            (number(fresh.path_mean_p95_m, 4)) " m off the path on average at 95 % of them, "
            (number(fresh.path_mean_max_m, 4)) " m at most; " (fresh.beyond_1_m) " drives went beyond 1 m."
        }
        @if let Some(other) = &it.alternative {
            p {
                "Steadier over these plants: " (parameters_text(&config.law, &other.gains)) ", at worst " (number(other.worst_value, 4))
                " instead of " (number(it.worst_value, 4)) ", and " (number(other.value, 4)) " with the vehicle’s file."
            }
        }
    }
}

/// How much later the steering may act, or why that is not known, and from where the loop converges.
fn late(it: &Margin) -> String {
    let late = match (it.additional_dead_time_s, &it.unknown) {
        (_, Some(why)) => format!("Additional dead time: {why}."),
        (Some(margin_s), None) => format!(
            "Additional dead time Δ at {:.2} m/s, the highest speed that the drive holds for a second: {:.0} ms; below {:.0} ms a set is fragile.",
            it.speed_mps,
            1000.0 * margin_s,
            1000.0 * it.fragile_below_s
        ),
        (None, None) => {
            format!("Additional dead time Δ at {:.2} m/s: without bound.", it.speed_mps)
        }
    };
    let extent = |it: Extent| format!("± {:.3} m and ± {:.3} rad", it.offset_m, it.heading_rad);
    let certified = match (it.certified, &it.no_certificate) {
        (Some(it), _) => {
            format!(" From {} beside a straight path it is certain to come back.", extent(it))
        }
        (None, Some(why)) => format!(" {}.", capitalised(why)),
        (None, None) => String::new(),
    };
    let simulated = it
        .simulated
        .map_or(String::new(), |it| format!(" Simulated, it comes back from {}.", extent(it)));
    late + &certified + &simulated
}

fn capitalised(words: &str) -> String {
    let mut letters = words.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}
