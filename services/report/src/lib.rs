//! Shows a run's folder as one page: tables, the paper's figures, and what they do and do not prove.
//!
//! Reads the files that a run leaves (`result.json`, `config.toml`, `episodes.csv`, `grid.csv`, `drives/*.csv`) and
//! writes `report/index.html`, which needs nothing else: pictures and style are part of it, it contains no script, and
//! it requests nothing from other machines. The same pictures are in the same folder as SVG files, for papers.

#![warn(missing_docs)]

mod axis;
mod baselines;
mod canvas;
mod certified;
mod chart;
mod compared;
mod decimate;
mod drive;
mod drives;
mod episodes;
mod error;
mod figures;
mod files;
mod grid;
mod identified;
mod laps;
mod page;
mod panels;
mod plants;
mod standings;
mod study;
mod switches;
mod train;
mod validate;
mod verdict;

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use config::RunConfig;
use outcome::{Compared, Outcome, RunResult, StudyComparison};

use canvas::Picture;
pub use certified::{CertifiedGains, MarginCurve, RegionPicture};
pub use error::ReportError;
pub use identified::IdentifiedCar;
use page::Page;

/// Writes the report of the run in this folder, replacing an older one, and returns the path of its page.
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
    // The result is read first: if the run is of an earlier version, its error says so; the configuration would only be
    // refused.
    let result = files::read_result(run)?;
    let text = files::read_required(
        run,
        "config.toml",
        "it is not the folder of a run; name the folder that holds the run's result.json",
    )?;
    let config = RunConfig::from_resolved(&text)
        .map_err(|error| ReportError::malformed(&run.join("config.toml"), None, error))?;
    let (html, pictures) = page_of(run, &result, &config, &text)?;

    write_pages(&run.join("report"), &html, &pictures)
}

/// Writes the page of an identified car and its pictures into this folder, and returns the path of the page.
///
/// # Errors
/// If they cannot be written.
pub fn write_identified(folder: &Path, car: IdentifiedCar<'_>) -> Result<PathBuf, ReportError> {
    let (html, pictures) = identified::page_of(car)?;
    write_pages(folder, &html, &pictures)
}

/// Writes the page of certified gains and its pictures into this folder, and returns the path of the page.
///
/// # Errors
/// If they cannot be written.
pub fn write_certified(folder: &Path, gains: &CertifiedGains) -> Result<PathBuf, ReportError> {
    let (html, pictures) = certified::page_of(gains)?;
    write_pages(folder, &html, &pictures)
}

/// Makes the folder of a page, before what takes long to compute.
///
/// # Errors
/// If it is not a folder, or cannot be made.
pub fn make_folder(folder: &Path) -> Result<(), ReportError> {
    let failed = |problem| ReportError::Write { path: folder.to_owned(), problem };
    if fs::symlink_metadata(folder).is_ok_and(|meta| !meta.is_dir()) {
        // Pictures would be written, and others removed, wherever a link points to.
        return Err(failed(io::Error::other("is not a folder; name another one")));
    }
    fs::create_dir_all(folder).map_err(failed)
}

/// Writes a page and its pictures into a folder, and removes pictures that it does not have.
fn write_pages(folder: &Path, html: &str, pictures: &[Picture]) -> Result<PathBuf, ReportError> {
    make_folder(folder)?;
    for picture in pictures {
        replace(&folder.join(format!("{}.svg", picture.name)), &picture.svg)?;
    }
    remove_others(folder, |stem| pictures.iter().any(|picture| picture.name == stem))?;
    // The page is written last, so that its pictures exist when the page does.
    let index = folder.join("index.html");
    replace(&index, html)?;
    Ok(index)
}

/// Writes the page of a comparison of tuners, with each of some laws, and its pictures into this folder, and returns the
/// path of the page.
///
/// # Errors
/// If they cannot be written.
pub fn write_compared(folder: &Path, laws: &[Compared]) -> Result<PathBuf, ReportError> {
    let (html, pictures) = compared::page_of(laws)?;
    write_pages(folder, &html, &pictures)
}

/// Writes the page of a study beside its table, which `pathtune sweep collect` has written, with the comparisons of its
/// tuners, and returns the page's path.
///
/// # Errors
/// If the table is not what a collection writes, or the page cannot be written.
pub fn write_study(table: &Path, compared: &[StudyComparison]) -> Result<PathBuf, ReportError> {
    let (html, _) = study::page_of(table, compared)?;
    let page = table.with_extension("html");
    replace(&page, &html)?;
    Ok(page)
}

/// The page of a run, and its pictures. `text` is the configuration from the run's folder.
fn page_of(
    run: &Path,
    result: &RunResult,
    config: &RunConfig,
    text: &str,
) -> Result<(String, Vec<Picture>), ReportError> {
    let drives = drives::read(run)?;
    let mut page = Page::new(result, config);
    match &result.decided.outcome {
        Outcome::Train(train) => {
            let episodes = episodes::read(run, train.learners.len())?;
            let folder = called(run);
            train::sections(&mut page, train, result, episodes.as_deref(), config, &folder)?;
        }
        Outcome::Validate(validate) => validate::sections(&mut page, validate, config),
        Outcome::Grid(grid) => {
            let sets = grid::read_sets(run, grid.size)?;
            grid::sections(&mut page, grid, sets, config)?;
        }
        Outcome::Drive(drive) => drive::sections(&mut page, drive, config)?,
    }
    laps::section(&mut page, result.decided.outcome.laps());
    figures::sections(&mut page, &drives, config)?;
    Ok(page.finish(text))
}

/// What commands may call the folder of a run: by its name, below `runs` if it lies in such a folder.
fn called(run: &Path) -> String {
    let name = |path: &Path| path.file_name().map(|it| it.to_string_lossy().into_owned());
    let run = fs::canonicalize(run).unwrap_or_else(|_| run.to_owned());
    let own = name(&run).unwrap_or_else(|| "RUN".to_owned());
    match run.parent().and_then(name) {
        Some(parent) if parent == "runs" => format!("runs/{own}"),
        _ => own,
    }
}

/// Writes a file under another name, and then renames it, so that nobody reads half of it.
fn replace(path: &Path, text: &str) -> Result<(), ReportError> {
    // Always the same name, so that what a killed predecessor left is removed by the next one.
    let part = path.with_extension("part");
    let write = || {
        match fs::remove_file(&part) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        // Made anew, so that no link is followed.
        fs::File::create_new(&part)?.write_all(text.as_bytes())?;
        fs::rename(&part, path)
    };
    write().map_err(|problem| {
        let _ = fs::remove_file(&part);
        ReportError::Write { path: path.to_owned(), problem }
    })
}

/// Removes pictures of an older report that this report does not have, and what killed reports left.
fn remove_others(folder: &Path, keep: impl Fn(&str) -> bool) -> Result<(), ReportError> {
    let failed = |problem| ReportError::Write { path: folder.to_owned(), problem };
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let extension = path.extension().unwrap_or_default().to_string_lossy();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        if extension.starts_with("part") || extension == "svg" && !keep(&stem) {
            fs::remove_file(&path).map_err(|problem| ReportError::Write { path, problem })?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use config::{Axis, Layers, ParameterConfig, Scale};
    use serde_json::{Value, json};

    use super::*;

    /// A valid configuration has one of the embedded laws, but the page could show any law.
    #[test]
    fn the_page_shows_the_names_of_any_law() {
        let names = ["preview_m", "delay_s", "weight", "gain", "offset", "blend"];
        let symbols = ["L", "T", "w", "k", "δ₀", "β"];
        let units = ["m", "s", "", "1/m", "rad", ""];
        let mut config = Layers::maneuver("lane_change").unwrap().resolve().unwrap();
        config.law.name = "preview".to_owned();
        config.law.summary = "looks ahead".to_owned();
        let parameters = names.iter().zip(symbols).zip(units);
        config.law.parameters = parameters
            .map(|((key, symbol), unit)| ParameterConfig {
                key: (*key).to_owned(),
                symbol: symbol.to_owned(),
                unit: unit.to_owned(),
                min: 1e-6,
                max: 100.0,
                scale: Scale::Log,
                default: 1.0,
                grid: Axis { min: 0.1, max: 10.0, step: 10.0 },
                for_wheelbase_m: None,
            })
            .collect();
        let set = |factor: f64| -> Value {
            names
                .iter()
                .enumerate()
                .map(|(place, name)| (*name, factor * (place + 1) as f64))
                .collect()
        };

        let folder = tempfile::tempdir().unwrap();
        let run = folder.path();
        let mut result: Value =
            serde_json::from_str(include_str!("../tests/fixtures/train.json")).unwrap();
        result["law"] = json!("preview");
        result["objective"] = json!("path");
        config.objective.name = "path".to_owned();
        result["gains"] = set(0.00125);
        result["on_bound"] = json!(["offset"]);
        result["paper"] = Value::Null;
        for beside in ["plain_q", "random_walk"] {
            result[beside]["gains"] = set(0.5);
        }
        for comparison in ["against_recommended", "against_paper"] {
            result["noise"][comparison]["gains"] = set(0.5);
        }
        for finalist in result["noise"]["finalists"].as_array_mut().unwrap() {
            finalist["gains"] = set(0.25);
        }
        for learner in result["learners"].as_array_mut().unwrap() {
            // As with a tuner that does not learn by temporal differences.
            learner["alpha"] = Value::Null;
            learner["gains"] = set(2.0);
            learner["locked"] = json!({ "blend": 0.5 });
            learner["usage"] =
                names.iter().map(|name| (*name, json!([{ "value": 0.1, "count": 3 }]))).collect();
        }
        fs::write(run.join("result.json"), result.to_string()).unwrap();
        let keys = names.join(",");
        let episodes = format!(
            "learner,episode,steps,return,last_value,terminated,{keys}\n\
             1,0,3,0.1,0.4,true,1,2,3,4,5,6\n0,0,2,0.2,0.3,false,,,,,,\n1,1,2,0.2,0.3,false,,,,,,\n"
        );
        fs::write(run.join("episodes.csv"), episodes).unwrap();

        let result = files::read_result(run).unwrap();
        let (html, pictures) = page_of(run, &result, &config, "").unwrap();
        for part in [
            "<th class=\"number\">L [m]</th><th class=\"number\">T [s]</th><th class=\"number\">w</th>\
             <th class=\"number\">k [1/m]</th><th class=\"number\">δ₀ [rad]</th><th class=\"number\">β</th>",
            "<td class=\"number\">0.00125</td><td class=\"number\">0.0025</td>",
            "† On a bound of the grid: δ₀;",
            "<td>β 0.5</td>",
            "preview (looks ahead)",
            "learner 1",
            "path [m]",
            "L 0.5, T 1, w 1.5, k 2, δ₀ 2.5, β 3",
            "the paper’s distance",
        ] {
            assert!(html.contains(part), "{part}");
        }
        for never in ["Kv [", "Kl [", "α = ", "telescopes"] {
            assert!(!html.contains(never), "{never}");
        }
        let usage = pictures.iter().find(|picture| picture.name == "parameter-usage").unwrap();
        for title in ["L [m]", "T [s]", "w [no unit]", "k [1/m]", "δ₀ [rad]", "β [no unit]"] {
            assert!(usage.svg.contains(title), "{title}");
        }
        if let Some(kept) = std::env::var_os("PATHTUNE_REPORTS") {
            fs::write(PathBuf::from(kept).join("any_law.html"), html).unwrap();
        }
    }
}
