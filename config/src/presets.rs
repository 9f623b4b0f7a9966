//! The presets, embedded so that the binary runs from any folder.

/// One embedded file of this folder.
#[derive(Debug, Clone, Copy)]
pub struct Preset {
    /// Path below `config/`, as `pathtune config init` writes it.
    pub path: &'static str,
    /// The file, with its comments.
    pub text: &'static str,
}

macro_rules! embed {
    ($($path:literal),+ $(,)?) => {
        &[$(Preset { path: $path, text: include_str!(concat!("../", $path)) }),+]
    };
}

/// Every embedded preset.
pub fn presets() -> &'static [Preset] {
    embed!(
        "readings.toml",
        "maneuvers/lane_change.toml",
        "maneuvers/roundabout.toml",
        "maneuvers/circuit.toml",
        "maneuvers/path.toml",
        "vehicles/tesla_model_3.toml",
        "vehicles/tesla_model_3_dynamic.toml",
        "vehicles/tesla_model_3_guarded.toml",
        "vehicles/ackermann.toml",
        "vehicles/carla.toml",
        "vehicles/f1tenth.toml",
        "launch/train.toml",
    )
}

/// The preset at `path` below `config/`.
pub(crate) fn preset(path: &str) -> Option<Preset> {
    presets().iter().copied().find(|preset| preset.path == path)
}

/// Name of the manoeuvre below a path of the user's own. It is of no use without one, so nobody is offered it.
pub(crate) const OWN_PATH: &str = "path";

/// Names of the manoeuvres that can be trained.
pub fn maneuver_names() -> impl Iterator<Item = &'static str> {
    presets()
        .iter()
        .filter_map(|preset| preset.path.strip_prefix("maneuvers/")?.strip_suffix(".toml"))
        .filter(|name| *name != OWN_PATH)
}

/// The candidate that looks most like `word`, where one does at all.
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(word, candidate), candidate))
        .filter(|(likeness, _)| *likeness > 0.7)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}
