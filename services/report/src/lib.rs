//! A run's folder as one page: tables, the paper's figures, and what they do and do not prove.
//!
//! Reads what a run leaves (`result.json`, `config.toml`, `drives/*.csv`) and writes `report/index.html`, which needs nothing
//! else: pictures and style are part of it, it holds no script, and it asks no other machine for anything. The same pictures
//! lie beside it as SVG files, for papers.

#![warn(missing_docs)]

mod axis;
mod canvas;
mod chart;
mod decimate;
mod drive;
mod drives;
mod error;
mod figures;
mod grid;
mod page;
mod panels;
mod result;
mod train;
mod validate;

use std::fs;
use std::path::{Path, PathBuf};

use config::RunConfig;

pub use error::ReportError;
use page::Page;
use result::RunResult;

/// Writes the report of the run in this folder, over an older one, and returns the path of its page.
///
/// # Errors
/// If the run has not ended, if one of its files is not what a run writes, or if the report cannot be written. The error is
/// one line that names the file and says what to do.
///
/// # Examples
/// ```no_run
/// let page = report::write_report("runs/lane_change-20261122-090504".as_ref())?;
/// println!("{}", page.display());
/// # Ok::<(), report::ReportError>(())
/// ```
pub fn write_report(run: &Path) -> Result<PathBuf, ReportError> {
    let (head, result) = result::read(run)?;
    let text = result::read_required(
        run,
        "config.toml",
        "it is not the folder of a run; name the one that holds the run's result.json",
    )?;
    let config = RunConfig::from_resolved(&text)
        .map_err(|error| ReportError::malformed(&run.join("config.toml"), None, error))?;
    let drives = drives::read(run)?;

    let mut page = Page::new(&head, &result, &config);
    match &result {
        RunResult::Train(train) => train::sections(&mut page, train, &config)?,
        RunResult::Validate(validate) => validate::sections(&mut page, validate, &config),
        RunResult::Grid(grid) => grid::sections(&mut page, grid)?,
        RunResult::Drive(drive) => drive::section(&mut page, drive),
    }
    figures::sections(&mut page, &drives, &config)?;
    let (html, pictures) = page.finish(&text);

    let folder = run.join("report");
    fs::create_dir_all(&folder)
        .map_err(|problem| ReportError::Write { path: folder.clone(), problem })?;
    for picture in &pictures {
        replace(&folder.join(format!("{}.svg", picture.name)), &picture.svg)?;
    }
    remove_others(&folder, |stem| pictures.iter().any(|picture| picture.name == stem))?;
    // The page comes last: whoever sees it sees its pictures too.
    let index = folder.join("index.html");
    replace(&index, &html)?;
    Ok(index)
}

/// Writes a file beside its place, and puts it there whole.
fn replace(path: &Path, text: &str) -> Result<(), ReportError> {
    let part = path.with_extension(format!("part-{}", std::process::id()));
    fs::write(&part, text).and_then(|()| fs::rename(&part, path)).map_err(|problem| {
        let _ = fs::remove_file(&part);
        ReportError::Write { path: path.to_owned(), problem }
    })
}

/// Removes pictures of an older report that this one does not have.
fn remove_others(folder: &Path, keep: impl Fn(&str) -> bool) -> Result<(), ReportError> {
    let failed = |problem| ReportError::Write { path: folder.to_owned(), problem };
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let is_picture = path.extension().is_some_and(|extension| extension == "svg");
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        if is_picture && !keep(&stem) {
            fs::remove_file(&path).map_err(|problem| ReportError::Write { path, problem })?;
        }
    }
    Ok(())
}
