//! `pathtune config` and `pathtune schema`: what the binary carries, printed or written.

use std::fs;

use crate::cli::{ConfigCommand, SchemaArgs};
use crate::words::Failure;
use crate::words::terminal::say;

/// Prints the messages and topics for another language.
///
/// # Errors
/// If standard output does not take it.
pub fn print_schema(args: &SchemaArgs) -> Result<(), Failure> {
    let text = if args.python { ipc_types::schema::python() } else { ipc_types::schema::c() };
    say!("{}", text.trim_end());
    Ok(())
}

/// Prints or writes the embedded presets.
///
/// # Errors
/// If no preset is meant, or a file is there already.
pub fn show_config(command: &ConfigCommand) -> Result<(), Failure> {
    match command {
        ConfigCommand::Show { name } => {
            let word = name.as_deref().unwrap_or_default();
            let shown: Vec<_> =
                config::presets().iter().filter(|preset| preset.path.contains(word)).collect();
            if shown.is_empty() {
                let paths: Vec<_> = config::presets().iter().map(|preset| preset.path).collect();
                return Err(Failure::User(format!(
                    "no preset's path holds {word:?}; there are {}",
                    paths.join(", ")
                )));
            }
            for preset in shown {
                say!("#### {}\n{}", preset.path, preset.text);
            }
        }
        ConfigCommand::Init { folder } => {
            for preset in config::presets() {
                let path = folder.join(preset.path);
                if path.exists() {
                    return Err(Failure::User(format!(
                        "{} is there already; name another folder",
                        path.display()
                    )));
                }
            }
            for preset in config::presets() {
                let path = folder.join(preset.path);
                path.parent()
                    .map_or(Ok(()), fs::create_dir_all)
                    .and_then(|()| fs::write(&path, preset.text))
                    .map_err(|error| {
                        Failure::User(format!("{}: cannot be written: {error}", path.display()))
                    })?;
                say!("{}", path.display());
            }
        }
    }
    Ok(())
}
