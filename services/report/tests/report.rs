//! Reports of runs of all three kinds, read again as a reader's browser would.

mod support;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use report::write_report;
use roxmltree::Document;
use tempfile::TempDir;

/// A run of one kind in a folder of its own, and its page.
///
/// With `PATHTUNE_REPORTS=FOLDER` the reports stay there, to be looked at.
fn written(kind: &str, make: fn(&Path) -> Result<()>) -> Result<(TempDir, PathBuf, String)> {
    let folder = tempfile::tempdir()?;
    let run = match std::env::var_os("PATHTUNE_REPORTS") {
        Some(kept) => PathBuf::from(kept).join(kind),
        None => folder.path().to_owned(),
    };
    make(&run)?;
    let page = write_report(&run)?;
    assert_eq!(page, run.join("report/index.html"));
    let html = fs::read_to_string(page)?;
    Ok((folder, run, html))
}

/// Every picture of a report, by its name.
fn pictures(run: &Path) -> Result<Vec<(String, String)>> {
    let mut pictures = Vec::new();
    for entry in fs::read_dir(run.join("report"))? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        assert!(name == "index.html" || name.ends_with(".svg"), "nothing half-made stays: {name}");
        if name.ends_with(".svg") {
            pictures.push((name, fs::read_to_string(path)?));
        }
    }
    pictures.sort();
    Ok(pictures)
}

fn texts(svg: &str) -> Result<Vec<String>> {
    let document = Document::parse(svg)?;
    let texts = document
        .descendants()
        .filter(|node| node.has_tag_name(("http://www.w3.org/2000/svg", "text")));
    Ok(texts.map(|node| node.text().unwrap_or_default().trim().to_owned()).collect())
}

/// What holds of every page: it stands alone, its pictures are well-formed, and its axes have names with units.
fn check_page(run: &Path, html: &str) -> Result<()> {
    let lower = html.to_lowercase();
    for never in ["<script", "url(", "@import", "<img", "<object", "<iframe", "javascript:"] {
        assert!(!lower.contains(never), "{never}");
    }
    let outside = lower.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
    assert!(!outside.contains("http://") && !outside.contains("https://"));
    assert!(lower.starts_with("<!doctype html><html lang=\"en\">"));
    for needed in
        ["<meta charset=\"utf-8\">", "<title>", "<link rel=\"icon\" href=\"data:,\">", "<details>"]
    {
        assert!(html.contains(needed), "{needed}");
    }
    // The page is XML but for its void elements and its document type.
    let body = html.split_once("<body>").context("no body")?.1;
    let body = body.split_once("</body>").context("no end")?.0.replace("<br>", "<br/>");
    Document::parse(&body)?;

    for (name, svg) in pictures(run)? {
        assert!(html.contains(svg.trim_end()), "{name} is on the page");
        let texts = texts(&svg)?;
        let named = texts.iter().filter(|text| text.contains(" [") && text.ends_with(']')).count();
        assert!(named >= 2 || name.starts_with("finalists"), "{name}: {texts:?}");
        check_inside(&name, &svg)?;
        for line in points_of_lines(&svg)? {
            assert!(line.len() <= 1500, "{name}: {} points", line.len());
        }
    }
    Ok(())
}

/// Nothing lies outside of the picture.
fn check_inside(name: &str, svg: &str) -> Result<()> {
    let document = Document::parse(svg)?;
    let view: Vec<f64> = document
        .root_element()
        .attribute("viewBox")
        .context("no viewBox")?
        .split(' ')
        .map(str::parse)
        .collect::<Result<_, _>>()?;
    for text in document.descendants().filter(|node| node.tag_name().name() == "text") {
        let number = |key: &str| text.attribute(key).unwrap_or_default().parse::<f64>();
        let (mut x, mut y) = (number("x")?, number("y")?);
        let label = text.text().unwrap_or_default().trim().to_owned();
        let half = label.chars().count() as f64 * 0.5 * 0.54 * number("font-size")?;
        let mut reach = match text.attribute("text-anchor") {
            Some("start") => (0.0, 2.0 * half),
            Some("end") => (2.0 * half, 0.0),
            _ => (half, half),
        };
        let mut width = view[2];
        if text.attribute("transform").is_some() {
            // It reads upwards: what would be its width is its height.
            (x, y, width, reach) = (y, x, view[3], (half, half));
        }
        assert!(x - reach.0 >= 0.0 && x + reach.1 <= width, "{name}: {label:?} is cut off");
        assert!(y >= 0.0, "{name}: {label:?}");
    }
    for line in points_of_lines(svg)? {
        for (x, y) in line {
            assert!((0.0..=view[2]).contains(&x) && (0.0..=view[3]).contains(&y), "{name}");
        }
    }
    Ok(())
}

fn points_of_lines(svg: &str) -> Result<Vec<Vec<(f64, f64)>>> {
    let document = Document::parse(svg)?;
    let lines = document.descendants().filter_map(|node| node.attribute("points"));
    lines
        .map(|points| {
            points
                .split_whitespace()
                .map(|point| {
                    let (x, y) = point.split_once(',').context("no point")?;
                    Ok((x.parse()?, y.parse()?))
                })
                .collect()
        })
        .collect()
}

#[test]
fn a_training_shows_every_section() -> Result<()> {
    let (_folder, run, html) = written("train", support::train)?;
    check_page(&run, &html)?;
    for section in [
        "<h1>lane change: training</h1>",
        "<h2>Result</h2>",
        "tuned (educated Q)",
        "plain Q beside it",
        "† On a bound of the grid: Ks",
        "<h2>Learning</h2>",
        "a flat curve proves nothing",
        "<h2>Gain usage</h2>",
        "<h2>Finalists under noise</h2>",
        "<b>undecided</b>",
        "<h2>Drives: tuned</h2>",
        "<h2>Drives: paper</h2>",
        "<h2>Configuration</h2>",
        "5045d6f849deb27ef5f9b714c83bf481a02819e5ce79d3a89cc5ef52402cabc8",
    ] {
        assert!(html.contains(section), "{section}");
    }
    let names: Vec<String> = pictures(&run)?.into_iter().map(|picture| picture.0).collect();
    assert_eq!(
        names,
        [
            "finalists.svg",
            "gain-usage.svg",
            "learning-distances.svg",
            "learning-rewards.svg",
            "paper-angular-velocity.svg",
            "paper-heading-error.svg",
            "paper-position-errors.svg",
            "paper-trajectory.svg",
            "paper-velocity.svg",
            "tuned-angular-velocity.svg",
            "tuned-heading-error.svg",
            "tuned-position-errors.svg",
            "tuned-trajectory.svg",
            "tuned-velocity.svg",
        ]
    );
    Ok(())
}

#[test]
fn a_validation_shows_both_tables_and_the_zones() -> Result<()> {
    let (_folder, run, html) = written("validate", support::validate)?;
    check_page(&run, &html)?;
    for section in [
        "<h1>circuit: validation</h1>",
        "<td>3 ★</td>",
        "★ The row that the paper chose.",
        "<h2>Changes of gains on the way</h2>",
        "2 roundabout from 12 m",
        "<h2>Drives: chosen</h2>",
    ] {
        assert!(html.contains(section), "{section}");
    }
    Ok(())
}

#[test]
fn a_grid_shows_ranks_flatness_and_effects() -> Result<()> {
    let (_folder, run, html) = written("grid", support::grid)?;
    check_page(&run, &html)?;
    for section in ["By distance", "By mse", "113 / 750", "18 (2.4 %)", "<h2>Main effects</h2>"] {
        assert!(html.contains(section), "{section}");
    }
    assert!(!html.contains("<h2>Drives"), "no drive was recorded");
    Ok(())
}

/// A lane change is 3.5 m wide: both that and the length are measured in pixels on the picture of a known drive.
#[test]
fn a_metre_on_the_map_is_as_long_in_both_directions() -> Result<()> {
    let (_folder, run, _) = written("train-map", support::train)?;
    let header = "time_s,x_m,y_m,speed_mps,reference_x_m,reference_y_m,along_track_m,cross_track_m,heading_rad,\
                  command_speed_mps,command_yaw_rate_radps,zone\n";
    let square = "0,0,0,0,0,0,0,0,0,0,0,0\n1,20,0,0,0,0,0,0,0,0,0,0\n2,20,7,0,0,0,0,0,0,0,0,0\n";
    fs::write(run.join("drives/tuned_noise_free.csv"), format!("{header}{square}"))?;
    fs::remove_file(run.join("drives/tuned_noisy.csv"))?;
    write_report(&run)?;
    let svg = fs::read_to_string(run.join("report/tuned-trajectory.svg"))?;
    let lines = points_of_lines(&svg)?;
    let drawn = lines
        .iter()
        .find(|line| line.len() == 3 && line[1].0 - line[0].0 > 1000.0)
        .context("no trajectory")?;
    let across = (drawn[1].0 - drawn[0].0) / 20.0;
    let up = (drawn[1].1 - drawn[2].1) / 7.0;
    assert!((across / up - 1.0).abs() < 1e-3, "{across} and {up} pixels a metre");
    Ok(())
}

#[test]
fn a_second_report_replaces_the_first() -> Result<()> {
    let (_folder, run, first) = written("train-twice", support::train)?;
    assert_eq!(fs::read_to_string(write_report(&run)?)?, first, "the same run, the same page");
    fs::remove_dir_all(run.join("drives"))?;
    let second = fs::read_to_string(write_report(&run)?)?;
    assert!(!second.contains("<h2>Drives"));
    assert_eq!(pictures(&run)?.len(), 4, "pictures of drives that are gone went too");
    Ok(())
}

#[test]
fn what_older_runs_lack_is_left_out() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let run = folder.path();
    support::grid(run)?;
    let gains = r#"{"kv": 1, "kl": 1, "ks": 1, "ki": 0.7}"#;
    let result = format!(
        r#"{{"gains": {gains}, "distance": 1, "mse_m2": 2, "paper": null, "learners": []}}"#
    );
    fs::write(run.join("result.json"), result)?;
    let html = fs::read_to_string(write_report(run)?)?;
    check_page(run, &html)?;
    for absent in
        ["<h2>Learning", "<h2>Gain usage", "<h2>Finalists", "the paper’s set</td>", "<svg"]
    {
        assert!(!html.contains(absent), "{absent}");
    }
    Ok(())
}

#[test]
fn texts_of_files_cannot_become_markup() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let run = folder.path();
    support::train(run)?;
    let result = fs::read_to_string(run.join("result.json"))?;
    let result = result
        .replace("\"lane_change\"", "\"<b>&\\\"<script>\"")
        .replace("\"undecided\"", "\"</p><script>\"")
        .replace("5045d6f8", "<script>&");
    fs::write(run.join("result.json"), result)?;
    let drives = run.join("drives");
    fs::rename(drives.join("tuned_noisy.csv"), drives.join("<script>&\"x_noisy.csv"))?;
    let config = fs::read_to_string(run.join("config.toml"))?;
    fs::write(run.join("config.toml"), format!("# </pre><script>\n{config}"))?;
    let html = fs::read_to_string(write_report(run)?)?;
    check_page(run, &html)?;
    assert!(html.contains("Drives: &lt;script&gt;&amp;&quot;x"));
    assert!(run.join("report/script-x-trajectory.svg").exists());
    Ok(())
}

/// Drives that no vehicle drives, but that files can hold.
#[test]
fn pictures_cope_with_any_finite_numbers() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let run = folder.path();
    support::grid(run)?;
    fs::create_dir_all(run.join("drives"))?;
    let header = "time_s,x_m,y_m,speed_mps,reference_x_m,reference_y_m,along_track_m,cross_track_m,heading_rad,\
                  command_speed_mps,command_yaw_rate_radps,zone";
    for rows in [
        vec!["0,0,0,0,0,0,0,0,0,0,0,0"],
        vec!["5,3,4,1,3,4,0,0,0,1,0,7"; 3000],
        vec![
            "0,-1e308,1e308,1e308,1e308,1e308,-1e308,0,1e-308,1,2,0",
            "1e308,1,1,1,1,1,1,1,1,1,1,1",
        ],
        vec![
            "1e15,1e15,1e15,1e15,1,1,1,1,1,1,1,0",
            "1000000000000000.1,1e15,1e15,1e15,1,1,1,1,1,1,1,0",
        ],
        vec!["0,0,0,0,0,0,0,0,0,0,1e9,0", "1,0.001,0,0,0,0,0,0,0,0,1e-9,0"],
    ] {
        fs::write(run.join("drives/odd.csv"), format!("{header}\n{}\n", rows.join("\n")))?;
        let html = fs::read_to_string(write_report(run)?)?;
        check_page(run, &html)?;
    }
    Ok(())
}

/// Breaks one file of a run, and holds the error against what it must say.
fn check_error(file: &str, text: Option<&str>, says: &[&str]) -> Result<()> {
    let folder = tempfile::tempdir()?;
    let run = folder.path();
    support::grid(run)?;
    fs::create_dir_all(run.join("drives"))?;
    match text {
        Some(text) => fs::write(run.join(file), text)?,
        None => fs::remove_file(run.join(file))?,
    }
    let error = write_report(run).err().context("no error")?.to_string();
    assert_eq!(error.lines().count(), 1, "{error}");
    for part in says {
        assert!(error.contains(part), "{error:?} does not say {part:?}");
    }
    assert!(!run.join("report/index.html").exists());
    Ok(())
}

#[test]
fn errors_are_one_line_and_name_the_place() -> Result<()> {
    const HEADER: &str = "time_s,x_m,y_m,speed_mps,reference_x_m,reference_y_m,along_track_m,cross_track_m,heading_rad,\
                          command_speed_mps,command_yaw_rate_radps,zone\n";
    let drive = |rows: &str| format!("{HEADER}{rows}");
    check_error("result.json", None, &["holds no result.json: the run has not ended"])?;
    check_error("config.toml", None, &["holds no config.toml"])?;
    check_error("config.toml", Some("seed = \n"), &["config.toml"])?;
    check_error("result.json", Some("{\n\"kind\": \n"), &["result.json:", "EOF"])?;
    check_error("result.json", Some("{\"kind\": \"dream\"}"), &["\"dream\" is none of"])?;
    check_error("result.json", Some("{\"mse_m2\": 1}"), &["result.json", "missing field `gains`"])?;
    check_error(
        "result.json",
        Some(r#"{"kind": "validate", "rows": [{"gains": [], "noise_free": {"mse_m2": "x"}}]}"#),
        &["rows[0].noise_free.mse_m2: invalid type"],
    )?;
    let file = "drives/a.csv";
    check_error(file, Some(""), &["a.csv", "no tick"])?;
    check_error(file, Some(HEADER), &["a.csv", "no tick"])?;
    check_error(file, Some("tick,time_s\n0,0\n"), &["a.csv:2", "x_m"])?;
    check_error(file, Some(&drive("0,0,0,0,0,0,0,0,0,0,0,0\n0,1\n")), &["a.csv:3", "2 values"])?;
    check_error(file, Some(&drive("0,0,0,x,0,0,0,0,0,0,0,0\n")), &["a.csv:2", "speed_mps"])?;
    check_error(file, Some(&drive("0,0,0,NaN,0,0,0,0,0,0,0,0\n")), &["a.csv:2", "speed_mps: NaN"])?;
    check_error(file, Some(&drive("0,0,inf,0,0,0,0,0,0,0,0,0\n")), &["a.csv:2", "y_m: inf"])?;
    check_error(file, Some(&drive("0,0,0,0,0,0,0,0,0,0,0,-1\n")), &["a.csv:2", "zone"])?;
    Ok(())
}
