//! The page: its head, its sections one behind the other, its figures and how they are numbered.

use config::{Gains, RunConfig};
use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::axis::gain;
use crate::canvas::{HALF, Picture};
use crate::result::{Head, RunResult};

const STYLE: &str = include_str!("style.css");

/// Names of the gains with their units, as axes show them, in the order of [`Gains::NAMES`].
pub(crate) const GAIN_UNITS: [&str; 4] = ["Kv [1/s]", "Kl [rad/(m·s)]", "Ks [1/s]", "Ki [no unit]"];

/// A page that is being written.
pub(crate) struct Page {
    title: String,
    head: Markup,
    sections: Vec<Markup>,
    pictures: Vec<Picture>,
}

impl Page {
    pub(crate) fn new(head: &Head, result: &RunResult, config: &RunConfig) -> Self {
        let maneuver = head.maneuver.as_deref().unwrap_or(&config.maneuver);
        let kind = match result {
            RunResult::Train(_) => "training",
            RunResult::Validate(_) => "validation",
            RunResult::Grid(_) => "exhaustive grid",
            RunResult::Drive(_) => "drive",
        };
        let title = format!("{}: {kind}", maneuver.replace('_', " "));
        let noise = if config.noise.enabled { "with noise on the odometry" } else { "noise-free" };
        let head = html! {
            h1 { (title) }
            dl.facts {
                dt { "Manoeuvre" } dd { (maneuver) }
                dt { "Kind" } dd {
                    (kind) @if matches!(result, RunResult::Train(_)) { ", " (noise) }
                }
                dt { "Vehicle" } dd { (config.vehicle.name) }
                dt { "Seed" } dd { (head.seed.unwrap_or(config.run.seed)) }
                @if let Some(digest) = &head.digest {
                    dt { "Digest" } dd { code { (digest) } }
                }
            }
        };
        Self { title, head, sections: Vec::new(), pictures: Vec::new() }
    }

    /// Adds a section behind the others.
    pub(crate) fn section(&mut self, title: &str, body: Markup) {
        self.sections.push(html! { section { h2 { (title) } (body) } });
    }

    /// A numbered figure. The picture is kept as a file too, under a name of its own.
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
    pub(crate) fn finish(self, config: &str) -> (String, Vec<Picture>) {
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    title { (self.title) }
                    // Without it browsers ask the page's host for an icon.
                    link rel="icon" href="data:,";
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    main {
                        header { (self.head) }
                        @for section in &self.sections { (section) }
                        section {
                            h2 { "Configuration" }
                            details {
                                summary { "The resolved configuration: `--config` of it repeats the run" }
                                pre { (config) }
                            }
                        }
                    }
                }
            }
        };
        (page.into_string(), self.pictures)
    }
}

/// A name for a file from whatever a file or a run was called.
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

/// Gains in one line, in the paper's order.
pub(crate) fn gains_text(gains: &Gains) -> String {
    let [kv, kl, ks, ki] = gains.to_array().map(gain);
    format!("Kv {kv}, Kl {kl}, Ks {ks}, Ki {ki}")
}

/// The four heads of columns of gains.
pub(crate) fn gain_heads() -> Markup {
    html! { th.number { "Kv" } th.number { "Kl" } th.number { "Ks" } th.number { "Ki" } }
}

/// Four cells of gains.
pub(crate) fn gain_cells(gains: &Gains) -> Markup {
    html! { @for value in gains.to_array() { td.number { (gain(value)) } } }
}

/// A table that scrolls by itself where the page is narrower.
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
