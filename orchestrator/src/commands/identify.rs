//! `pathtune identify`: what it prints, and what it does to the vehicle's file. The identification itself is a tool that is
//! handed in.

use std::fs;
use std::path::{Path, PathBuf};

use config::{Layers, Vehicle, identified};
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::runs::vehicle_file::VehicleFile;
use crate::words::Failure;
use crate::words::tables::table_of;
use crate::words::terminal::{say, tell, tell_once};

/// What was identified, ready to be printed.
#[derive(Debug, Clone)]
pub struct Identified {
    /// The table: key, before, after, interval, verdict.
    pub rows: Vec<[String; 5]>,
    /// What is said below it.
    pub notes: Vec<String>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// All of it for scripts.
    pub json: Value,
    /// What is for the vehicle's file; of where it comes from, what the fit itself knows.
    pub found: identified::Found,
    /// The recordings.
    pub drives: Vec<PathBuf>,
    /// Why the values are not to be written, if they are not.
    pub refusal: Option<String>,
}

/// The vehicle of a file, or of a preset.
///
/// # Errors
/// If there is none, or it is not valid.
pub fn vehicle_of(file: &Path) -> Result<Vehicle, Failure> {
    let name = file.to_str().ok_or_else(|| {
        Failure::User(format!("{}: the name of a vehicle's file must be UTF-8", file.display()))
    })?;
    let layers = Layers::of_vehicle("--vehicle", name)?;
    if let Some(borrowed) = layers.borrowed() {
        tell_once(&borrowed);
    }
    Ok(layers.resolve()?.vehicle)
}

/// Prints what was identified, and writes it if the user wants it.
///
/// # Errors
/// If it is to be written, and is refused or cannot be.
pub fn conclude(found: &Identified, file: &Path, json: bool, write: bool) -> Result<(), Failure> {
    if json {
        say!("{}", serde_json::to_string_pretty(&found.json).map_err(anyhow::Error::from)?);
    } else {
        let mut table = table_of(&["", "before", "after", "95 % interval", "identified"]);
        for row in &found.rows {
            table.add_row(row);
        }
        if let Some(column) = table.column_mut(4) {
            column.set_cell_alignment(comfy_table::CellAlignment::Left);
        }
        say!("{table}");
        for note in &found.notes {
            say!("{note}");
        }
    }
    for warning in &found.warnings {
        tell!("pathtune: warning: {warning}");
    }
    if !write {
        return Ok(());
    }
    if let Some(why) = &found.refusal {
        return Err(Failure::User(format!("{}: nothing was written: {why}", file.display())));
    }
    let mut for_file = found.found.clone();
    for_file.provenance.splice(0..0, provenance(&found.drives)?);
    let kept = write_found(file, &for_file)?;
    if !json {
        say!(
            "{}: {} values written; the file as it was is {}, and `pathtune identify --rollback --vehicle {0}` brings it back",
            file.display(),
            for_file.values.len(),
            kept.display(),
        );
    }
    Ok(())
}

/// When, by which program, and from which recordings.
fn provenance(drives: &[PathBuf]) -> Result<Vec<String>, Failure> {
    let now = jiff::Timestamp::now().strftime("%Y-%m-%d %H:%M:%S UTC");
    let version = env!("CARGO_PKG_VERSION");
    let mut lines = vec![format!("Found by `pathtune identify`, version {version}, {now}, in")];
    for drive in drives {
        let fail = |error| Failure::User(format!("{}: {error}", drive.display()));
        let mut hash = HashedBytes(Sha256::new());
        let mut text = config::open_regular(drive).map_err(fail)?;
        std::io::copy(&mut text, &mut hash).map_err(fail)?;
        let hash: String = hash.0.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
        let name = fs::canonicalize(drive).unwrap_or_else(|_| drive.clone());
        lines.push(format!("  {} (SHA-256 {hash})", name.display()));
    }
    Ok(lines)
}

/// Hashes what is written into it, so that a recording of any length is read in small parts.
struct HashedBytes(Sha256);

impl std::io::Write for HashedBytes {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Puts what was found into a vehicle's file, whose text is kept beside it; returns where.
fn write_found(file: &Path, found: &identified::Found) -> Result<PathBuf, Failure> {
    let fail = |why: String| Failure::User(format!("{}: {why}", file.display()));
    if !file.is_file() {
        return Err(fail(
            "is not a file that could be changed; `pathtune config init DIR` writes presets to start from".to_owned(),
        ));
    }
    let target = VehicleFile::lock(file)?;
    let text = identified::put_found(&target.text, found).map_err(fail)?;
    // Values that the configuration would refuse must never stand in the file, as others may read it at any time.
    Layers::vehicle_of_text(&file.display().to_string(), &text)
        .map_err(|why| fail(format!("nothing was written: {}", Failure::from(why).message())))?;
    let number = last_kept(file).map_or(1, |last| last + 1);
    let kept = kept_as(file, number);
    fs::write(&kept, &target.text)
        .map_err(|error| fail(format!("cannot be kept as {}: {error}", kept.display())))?;
    target.replace(&text).inspect_err(|_| {
        let _ = fs::remove_file(&kept);
    })?;
    Ok(kept)
}

/// Brings back the text that a vehicle's file had before the last `--write`.
///
/// # Errors
/// If there was none, or it cannot be brought back.
pub fn roll_back(file: &Path) -> Result<(), Failure> {
    let fail = |why: String| Failure::User(format!("{}: {why}", file.display()));
    let target = VehicleFile::lock(file)?;
    let number = last_kept(file)
        .ok_or_else(|| fail("no values were written into it by `pathtune identify`".to_owned()))?;
    let kept = kept_as(file, number);
    let text =
        config::read_small(&kept).map_err(|error| fail(format!("{}: {error}", kept.display())))?;
    // What was edited or promoted since the write is not lost, nor what an earlier rollback has kept.
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let mut after = file.with_file_name(format!("{name}.after-{number}"));
    for number in number + 1.. {
        if fs::symlink_metadata(&after).is_err() {
            break;
        }
        after = file.with_file_name(format!("{name}.after-{number}"));
    }
    fs::copy(file, &after)?;
    target.replace(&text)?;
    fs::remove_file(&kept)?;
    say!(
        "{}: is again what it was before the values were written; what it was until now, with all that was edited or promoted \
         since, is {}",
        file.display(),
        after.display()
    );
    Ok(())
}

/// Where the text before the n-th write is kept.
fn kept_as(file: &Path, number: u32) -> PathBuf {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    file.with_file_name(format!("{name}.before-{number}"))
}

/// The number of the newest text that is kept.
fn last_kept(file: &Path) -> Option<u32> {
    let name = format!("{}.before-", file.file_name()?.to_string_lossy());
    let folder = match file.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let numbers = fs::read_dir(folder)
        .ok()?
        .filter_map(|entry| entry.ok()?.file_name().to_str()?.strip_prefix(&name)?.parse().ok());
    numbers.max()
}
