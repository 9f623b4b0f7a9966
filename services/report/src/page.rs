//! The page: its head, its sections one after the other, and its numbered figures.

use config::{LawConfig, NamedParameters, ParameterConfig, RunConfig};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use outcome::{Decided, Outcome, RunResult};

use crate::axis::short;
use crate::canvas::{HALF, Picture};

const STYLE: &str = include_str!("style.css");

/// A page that is being written.
pub(crate) struct Page {
    title: String,
    head: Markup,
    sections: Vec<Markup>,
    pictures: Vec<Picture>,
}

impl Page {
    pub(crate) fn new(result: &RunResult, config: &RunConfig) -> Self {
        let Decided { maneuver, vehicle, law, objective, seed, outcome, .. } = &result.decided;
        let kind = match outcome {
            Outcome::Train(_) => "training",
            Outcome::Validate(_) => "validation",
            Outcome::Grid(_) => "exhaustive grid",
            Outcome::Drive(_) => "drive",
        };
        let title = format!("{}: {kind}", maneuver.replace('_', " "));
        let noise = if config.noise.enabled { "with noise on the odometry" } else { "noise-free" };
        let head = html! {
            h1 { (title) }
            dl.facts {
                dt { "Manoeuvre" } dd { (maneuver) }
                @if let Some(after) = &result.run.stopped_after {
                    dt { "Stopped" } dd { "after " (after) ", before its end" }
                }
                dt { "Kind" } dd {
                    (kind) @if matches!(outcome, Outcome::Train(_)) { ", " (noise) }
                }
                dt { "Vehicle" } dd {
                    (vehicle)
                    @if !config.vehicle.borrowed.is_empty() {
                        "; " (config.vehicle.borrowed.len()) " of its keys are those of another car, tesla_model_3: "
                        (config.vehicle.borrowed.join(", "))
                    }
                }
                dt { "Law" } dd { (law) @if *law == config.law.name { " (" (config.law.summary) ")" } }
                dt { "Objective" } dd {
                    (objective) @if *objective == config.objective.name { " (" (config.objective.summary) ")" }
                }
                @if let Outcome::Train(train) = outcome { dt { "Tuner" } dd { (train.tuner) " (" (config.tuner.summary) ")" } }
                dt { "Seed" } dd { (seed) }
                dt { "Digest" } dd { code { (outcome.digest()) } }
            }
        };
        Self { title, head, sections: Vec::new(), pictures: Vec::new() }
    }

    /// A page of something else than a run, with these facts below its title.
    pub(crate) fn titled(title: &str, facts: Markup) -> Self {
        let head = html! { h1 { (title) } (facts) };
        Self { title: title.to_owned(), head, sections: Vec::new(), pictures: Vec::new() }
    }

    /// Adds a section after the others.
    pub(crate) fn section(&mut self, title: &str, body: Markup) {
        self.sections.push(html! { section { h2 { (title) } (body) } });
    }

    /// A numbered figure. The picture is also kept as a file with a unique name.
    pub(crate) fn figure(&mut self, mut picture: Picture, caption: &str) -> Markup {
        let wanted = slug(&picture.name);
        picture.name = wanted.clone();
        let mut count = 1;
        while self.pictures.iter().any(|other| other.name == picture.name) {
            count += 1;
            picture.name = format!("{wanted}-{count}");
        }
        let class = if picture.width <= HALF { "half" } else { "wide" };
        let width = format!("max-width: {:.0}px", picture.width);
        let number = self.pictures.len() + 1;
        let figure = html! {
            figure class=(class) {
                div style=(width) { (PreEscaped(&picture.svg)) }
                figcaption { b { "Figure " (number) "." } " " (caption) }
            }
        };
        self.pictures.push(picture);
        figure
    }

    /// The whole page, and its pictures.
    pub(crate) fn finish(mut self, config: &str) -> (String, Vec<Picture>) {
        self.section(
            "Configuration",
            html! {
                details {
                    summary { "The resolved configuration: passing it with `--config` repeats the run" }
                    pre { (config) }
                }
            },
        );
        self.finish_without_config()
    }

    /// The same for what has no configuration of its own.
    pub(crate) fn finish_without_config(self) -> (String, Vec<Picture>) {
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    title { (self.title) }
                    // Without this, browsers request an icon from the page's host.
                    link rel="icon" href="data:,";
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    main {
                        header { (self.head) }
                        @for section in &self.sections { (section) }
                    }
                }
            }
        };
        (page.into_string(), self.pictures)
    }
}

/// A name for a file, from any name of a file or a run.
pub(crate) fn slug(name: &str) -> String {
    let mut slug = String::new();
    for c in name.chars() {
        if c.is_ascii_alphanumeric() {
            slug.push(c.to_ascii_lowercase());
        } else if !slug.is_empty() && !slug.ends_with('-') {
            slug.push('-');
        }
    }
    let slug = slug.trim_end_matches('-');
    if slug.is_empty() { "picture".to_owned() } else { slug.chars().take(80).collect() }
}

/// A parameter with its unit, as axes show it.
pub(crate) fn parameter_title(parameter: &ParameterConfig) -> String {
    let unit = if parameter.unit.is_empty() { "no unit" } else { &parameter.unit };
    format!("{} [{unit}]", parameter.symbol)
}

/// The symbol of the parameter with this name.
pub(crate) fn symbol<'a>(law: &'a LawConfig, key: &'a str) -> &'a str {
    let parameter = law.parameters.iter().find(|it| it.key == key);
    parameter.map_or(key, |it| it.symbol.as_str())
}

/// Parameters in one line, in the law's order.
pub(crate) fn parameters_text(law: &LawConfig, named: &NamedParameters) -> String {
    let one = |(it, value): (&ParameterConfig, String)| format!("{} {value}", it.symbol);
    law.parameters.iter().zip(values(law, named)).map(one).collect::<Vec<_>>().join(", ")
}

/// The heads of the columns of parameters: symbol and unit.
pub(crate) fn parameter_heads(law: &LawConfig) -> Markup {
    html! {
        @for it in &law.parameters {
            th.number { (it.symbol) @if !it.unit.is_empty() { " [" (it.unit) "]" } }
        }
    }
}

/// The cells of parameters, in the law's order.
pub(crate) fn parameter_cells(law: &LawConfig, named: &NamedParameters) -> Markup {
    parameter_cells_marked(law, named, &[])
}

/// The cells of parameters; those that lie on a bound of the grid are marked.
pub(crate) fn parameter_cells_marked(
    law: &LawConfig,
    named: &NamedParameters,
    on_bound: &[String],
) -> Markup {
    html! {
        @for (key, value) in law.keys().zip(values(law, named)) {
            td.number {
                @if on_bound.iter().any(|bound| bound == key) { span.bound { (value) } span.mark { "†" } }
                @else { (value) }
            }
        }
    }
}

/// The cells of several sets, one for each manoeuvre of the path, below each other.
pub(crate) fn parameter_cells_of_all(law: &LawConfig, sets: &[NamedParameters]) -> Markup {
    html! {
        @for key in law.keys() {
            td.number {
                @for (index, set) in sets.iter().enumerate() {
                    @if index > 0 { br; }
                    (value(set, key))
                }
            }
        }
    }
}

fn values(law: &LawConfig, named: &NamedParameters) -> impl Iterator<Item = String> {
    law.keys().map(|key| value(named, key))
}

fn value(named: &NamedParameters, key: &str) -> String {
    named.get(key).map_or_else(|| "–".to_owned(), short)
}

/// A table that scrolls by itself if the page is narrower.
pub(crate) fn table(head: Markup, body: Markup) -> Markup {
    html! {
        div.table { table { thead { (head) } tbody { (body) } } }
    }
}

#[cfg(test)]
mod tests {
    use super::slug;

    #[test]
    fn names_of_files_are_harmless() {
        assert_eq!(slug("tuned noise-free"), "tuned-noise-free");
        assert_eq!(slug("../<&\"x"), "x");
        assert_eq!(slug("…"), "picture");
    }
}
