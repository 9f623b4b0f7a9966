//! The file that `pathtune config init` writes for `--config`: every key with what it means, and none of them set.

use crate::presets::preset;

const HEAD: &str = "\
# For --config: every key that a run has beside its vehicle, its law, its tuner and its objective, with its default.
# Nothing is set here: take the # from the front of a key to set it. A manoeuvre's file may have another value than the
# one below; `pathtune config show KEY` prints them all.

";

/// All keys of readings.toml, each commented out.
pub fn overlay() -> String {
    let mut text = HEAD.to_owned();
    for line in preset("readings.toml").expect("embedded").text.lines() {
        let is_key = !line.is_empty() && !line.starts_with(['#', '[']);
        text += if is_key { "#" } else { "" };
        text += line;
        text += "\n";
    }
    text
}

/// A key in a preset.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// The preset's path below `config/`.
    pub path: &'static str,
    /// The key, as it is set in a run's configuration.
    pub key: String,
    /// The comment above it and its line.
    pub lines: Vec<&'static str>,
}

/// Every key of the presets of which `word` is the name, or the last parts.
pub fn find_key(word: &str) -> Vec<Found> {
    let below = format!(".{word}");
    all_keys().filter(|it| it.key == word || it.key.ends_with(&below)).collect()
}

/// The keys that are most like a word.
pub fn nearest_keys(word: &str) -> Vec<String> {
    let mut keys: Vec<String> = all_keys().map(|it| it.key).collect();
    keys.sort_unstable();
    keys.dedup();
    let likeness = |key: &str| {
        let last = key.rsplit('.').next().unwrap_or(key);
        let shares = last.contains(word) || word.contains(last);
        let like = strsim::jaro_winkler(word, key).max(strsim::jaro_winkler(word, last));
        if shares { like.max(0.9) } else { like }
    };
    let mut near: Vec<(f64, String)> =
        keys.into_iter().map(|key| (likeness(&key), key)).filter(|it| it.0 > 0.75).collect();
    near.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
    near.truncate(5);
    near.into_iter().map(|it| it.1).collect()
}

/// Every key that a preset sets, with its comment.
fn all_keys() -> impl Iterator<Item = Found> {
    crate::presets().iter().filter(|it| !it.path.starts_with("launch/")).flat_map(|preset| {
        let part = match preset.path.split_once('/') {
            Some(("vehicles", _)) => "vehicle.",
            Some(("laws", _)) => "law.",
            Some(("tuners", _)) => "tuner.",
            Some(("objectives", _)) => "objective.",
            _ => "",
        };
        let (mut table, mut comment, mut found) = (String::new(), Vec::new(), Vec::new());
        for line in preset.text.lines() {
            if let Some(header) = line.strip_prefix('[') {
                table = match header.split_once(']') {
                    Some((name, _)) if !header.starts_with('[') => format!("{name}."),
                    // One of a list of tables: its keys cannot be set one by one.
                    _ => "[].".to_owned(),
                };
                comment.clear();
            } else if line.starts_with('#') {
                comment.push(line);
            } else if let Some((name, _)) = line.split_once('=')
                && name.trim().chars().all(|it| it.is_ascii_alphanumeric() || it == '_')
                && !table.starts_with("[]")
            {
                let key = format!("{part}{table}{}", name.trim());
                let lines = comment.drain(..).chain([line]).collect();
                found.push(Found { path: preset.path, key, lines });
            } else if line.is_empty() {
                comment.clear();
            }
        }
        found
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Layers, maneuver_names};
    use toml::{Table, Value};

    /// Whether a table sets no key at all.
    fn is_empty(table: &Table) -> bool {
        table.values().all(|value| matches!(value, Value::Table(table) if is_empty(table)))
    }

    #[test]
    fn it_changes_nothing_until_it_is_edited() {
        let text = overlay();
        assert!(is_empty(&text.parse().unwrap()));
        for name in maneuver_names() {
            let mut layers = Layers::maneuver(name).unwrap();
            layers.add_document("overlay.toml", &text).unwrap();
            let plain = Layers::maneuver(name).unwrap().resolve().unwrap();
            assert_eq!(layers.resolve().unwrap(), plain);
        }
        let edited = text.replace("#loop_time_s", "loop_time_s");
        let mut layers = Layers::maneuver("roundabout").unwrap();
        layers.add_document("overlay.toml", &edited).unwrap();
        assert_eq!(layers.resolve().unwrap().drive.loop_time_s, 5.0);
        // Every key of it can be set by taking its # away.
        let lines = text.lines().filter_map(|line| line.strip_prefix('#'));
        let all: Vec<&str> = lines.filter(|line| !line.starts_with(' ')).collect();
        assert!(all.len() > 60, "{}", all.len());
    }

    #[test]
    fn a_key_is_found_by_its_name_and_a_mistyped_one_by_its_likeness() {
        let found = find_key("goal_radius_m");
        assert_eq!((found[0].path, &*found[0].key), ("readings.toml", "drive.goal_radius_m"));
        assert!(found[0].lines[0].starts_with("# A drive ends early"), "{found:?}");
        let all = find_key("vehicle.wheelbase_m");
        assert!(all.iter().any(|it| it.path == "vehicles/f1tenth.toml"));
        assert!(all.iter().any(|it| it.lines.last() == Some(&"wheelbase_m = 2.875")));
        assert_eq!(find_key("safety.jump_limit_m")[0].key, "vehicle.safety.jump_limit_m");
        assert_eq!(find_key("goal_radios_m"), []);
        assert_eq!(nearest_keys("goal_radios_m")[0], "drive.goal_radius_m");
        assert!(nearest_keys("wheelbase").contains(&"vehicle.wheelbase_m".to_owned()));
    }
}
