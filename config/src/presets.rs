//! The presets, embedded so that the binary runs from any folder.

/// One embedded file of this folder.
#[derive(Debug, Clone, Copy)]
pub struct Preset {
    /// Path below `config/`, as `pathtune config init` writes it.
    pub path: &'static str,
    /// The file, with its comments.
    pub text: &'static str,
}

/// Every embedded preset: all TOML files below `config/`, as the build finds them.
pub fn presets() -> &'static [Preset] {
    include!(concat!(env!("OUT_DIR"), "/presets.rs"))
}

/// The preset at `path` below `config/`.
pub(crate) fn preset(path: &str) -> Option<Preset> {
    presets().iter().copied().find(|preset| preset.path == path)
}

/// Names of the presets in one folder below `config/`, such as `laws`.
pub fn names_in(folder: &str) -> impl Iterator<Item = &'static str> {
    presets().iter().filter_map(move |preset| {
        preset.path.strip_prefix(folder)?.strip_prefix('/')?.strip_suffix(".toml")
    })
}

/// Name of the manoeuvre below a path of the user's own. It is of no use without such a path, so it is not listed.
pub(crate) const OWN_PATH: &str = "path";

/// Names of the manoeuvres that can be trained.
pub fn maneuver_names() -> impl Iterator<Item = &'static str> {
    names_in("maneuvers").filter(|name| *name != OWN_PATH)
}

/// The candidate that is most like `word`, if any is similar.
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(word, candidate), candidate))
        .filter(|(likeness, _)| *likeness > 0.7)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}

/// The advice for a user who wrote `word` instead of one of `names`.
pub(crate) fn hint(word: &str, names: &[&str]) -> String {
    match nearest(word, names.iter().copied()) {
        Some(near) => format!("did you mean {near}?"),
        None => format!("there are {}", names.join(", ")),
    }
}
