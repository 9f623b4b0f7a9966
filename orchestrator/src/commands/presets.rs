//! `pathtune config` and `pathtune schema`: print or write what is embedded in the binary.

use std::fs;
use std::path::{Path, PathBuf};

use toml::{Table, Value};

use crate::cli::{ConfigCommand, SchemaArgs};
use crate::words::Failure;
use crate::words::tables::table_of;
use crate::words::terminal::say;

/// Prints the messages and topics for another language, or the schema of results.
///
/// # Errors
/// If it cannot be written to standard output.
pub(crate) fn print_schema(args: &SchemaArgs) -> Result<(), Failure> {
    let text = match args {
        SchemaArgs { result: true, .. } => outcome::schema(),
        SchemaArgs { python: true, .. } => ipc_types::schema::python(),
        _ => ipc_types::schema::c(),
    };
    say!("{}", text.trim_end());
    Ok(())
}

/// Lists, prints or writes the embedded presets.
///
/// # Errors
/// If no preset matches, or a file exists already.
pub(crate) fn show_config(command: &ConfigCommand) -> Result<(), Failure> {
    match command {
        ConfigCommand::List => list()?,
        ConfigCommand::Show { name } => {
            let word = name.as_deref().unwrap_or_default();
            let shown: Vec<_> =
                config::presets().iter().filter(|preset| preset.path.contains(word)).collect();
            if shown.is_empty() {
                return show_key(word);
            }
            for preset in shown {
                say!("#### {}\n{}", preset.path, preset.text);
            }
        }
        ConfigCommand::Init { folder } => {
            let overlay = (config::overlay(), "overlay.toml");
            // As a layer the readings would undo what a manoeuvre sets; the overlay has their keys.
            let presets = config::presets().iter().filter(|it| it.path != "readings.toml");
            let files: Vec<(PathBuf, &str)> = std::iter::once((overlay.1, &*overlay.0))
                .chain(presets.map(|it| (it.path, it.text)))
                .map(|(path, text)| (folder.join(path), text))
                .collect();
            if let Some((path, _)) = files.iter().find(|(path, _)| path.exists()) {
                return Err(Failure::User(format!(
                    "{} exists already; name another folder",
                    path.display()
                )));
            }
            for (path, text) in files {
                path.parent()
                    .map_or(Ok(()), fs::create_dir_all)
                    .and_then(|()| fs::write(&path, text))
                    .map_err(|error| {
                        Failure::User(format!("{}: cannot be written: {error}", path.display()))
                    })?;
                say!("{}", path.display());
            }
        }
    }
    Ok(())
}

/// Prints a key of the presets wherever it is set, with what it means.
fn show_key(word: &str) -> Result<(), Failure> {
    let found = config::find_key(word);
    if found.is_empty() {
        let near = config::nearest_keys(word);
        let paths: Vec<_> = config::presets().iter().map(|preset| preset.path).collect();
        let names = paths.iter().filter_map(|path| Path::new(path).file_stem()?.to_str());
        let advice = match (near.is_empty(), config::nearest(word, names)) {
            (true, Some(name)) => format!("did you mean {name}?"),
            (true, None) => format!("there are the presets {}", paths.join(", ")),
            (false, _) => format!("did you mean {}?", near.join(", ")),
        };
        return Err(Failure::User(format!(
            "no preset's path contains {word:?}, and no key has this name; {advice}"
        )));
    }
    for key in found {
        say!("#### {}: {}\n{}\n", key.path, key.key, key.lines.join("\n"));
    }
    Ok(())
}

/// Folders of presets of which a run uses one, each with the option that selects it.
const CHOICES: [(&str, &str); 5] = [
    ("maneuvers", "MANEUVER"),
    ("vehicles", "--vehicle"),
    ("laws", "--law"),
    ("tuners", "--tuner"),
    ("objectives", "--objective"),
];

fn list() -> Result<(), Failure> {
    let mut table = table_of(&["option", "name", "what it is"]);
    for column in table.column_iter_mut() {
        column.set_cell_alignment(comfy_table::CellAlignment::Left);
    }
    for (folder, option) in CHOICES {
        let names: Vec<&str> = match folder {
            // The one that serves a path of the user's own is selected only by --path.
            "maneuvers" => config::maneuver_names().collect(),
            _ => config::names_in(folder).collect(),
        };
        for name in names {
            let path = format!("{folder}/{name}.toml");
            let text = config::presets().iter().find(|it| it.path == path).map(|it| it.text);
            table.add_row([option, name, &summary(text.unwrap_or_default())]);
        }
    }
    say!("{table}");
    Ok(())
}

/// What a preset is: its own words, or the first sentence of its comment.
fn summary(text: &str) -> String {
    let table: Table = text.parse().unwrap_or_default();
    if let Some(Value::String(summary)) = table.get("summary") {
        return summary.clone();
    }
    let comment: Vec<&str> =
        text.lines().map_while(|line| line.strip_prefix('#')).map(str::trim).collect();
    let comment = comment.join(" ");
    let end = ["; ", ": ", ". "].iter().filter_map(|end| comment.find(end)).min();
    comment[..end.unwrap_or(comment.len())].trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_choice_says_what_it_is() {
        for preset in config::presets() {
            if CHOICES.iter().any(|(folder, _)| preset.path.starts_with(folder)) {
                let summary = summary(preset.text);
                assert!((5..200).contains(&summary.len()), "{}: {summary:?}", preset.path);
            }
        }
    }
}
