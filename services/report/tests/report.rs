//! Reports of runs of all three kinds, read again as a reader's browser would.

mod support;

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use report::write_report;
use roxmltree::Document;
use serde_json::{Value, json};
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
    check_tables(&Document::parse(&body)?)?;

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

/// Every row of a table has as many columns as the others.
fn check_tables(page: &Document) -> Result<()> {
    for table in page.descendants().filter(|node| node.has_tag_name("table")) {
        let mut widths = Vec::new();
        for row in table.descendants().filter(|node| node.has_tag_name("tr")) {
            let mut width = 0;
            for cell in row.children().filter(|node| node.is_element()) {
                width += cell.attribute("colspan").unwrap_or("1").parse::<usize>()?;
            }
            widths.push(width);
        }
        let text: String = table.descendants().filter_map(|node| node.text()).collect();
        assert!(widths.iter().all(|width| *width == widths[0]), "{widths:?}: {text}");
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
        "tuned (educated-q)",
        "the paper’s set",
        "found by plain Q",
        "found by a random walk",
        "distance from the path [m]",
        "<td class=\"number\">0.080</td><td class=\"number\">0.191</td><td class=\"number\">0.247</td>",
        "98 / 750",
        "† On a bound of the grid: Ks",
        "Kl [rad/(m·s)]",
        "paper (the paper",
        "<h2>Learning</h2>",
        "a flat curve proves nothing",
        "<td>Ks 21</td>",
        "<h2>Parameter usage</h2>",
        "<h2>Finalists",
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
            "learning-rewards.svg",
            "learning-values.svg",
            "paper-angular-velocity.svg",
            "paper-heading-error.svg",
            "paper-position-errors.svg",
            "paper-trajectory.svg",
            "paper-velocity.svg",
            "parameter-usage.svg",
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
        "distance from the path [m]",
        "<h2>Changes of parameters during the drive</h2>",
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
    for section in [
        "By distance, the objective",
        "By mse",
        "By mean distance from the path",
        "113 / 750",
        "18 (2.4 %)",
        "<h2>Main effects</h2>",
    ] {
        assert!(html.contains(section), "{section}");
    }
    let names: Vec<String> = pictures(&run)?.into_iter().map(|picture| picture.0).collect();
    assert_eq!(
        names,
        [
            "effects-mse.svg",
            "effects-path.svg",
            "effects-value.svg",
            "sorted-path.svg",
            "sorted-values.svg",
        ]
    );
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

/// Writes a run's result again, with something changed.
fn change_result(run: &Path, change: impl FnOnce(&mut Value)) -> Result<()> {
    let path = run.join("result.json");
    let mut result: Value = serde_json::from_str(&fs::read_to_string(&path)?)?;
    change(&mut result);
    fs::write(path, serde_json::to_string(&result)?)?;
    Ok(())
}

#[test]
fn what_a_run_lacks_is_left_out() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let run = folder.path();
    support::train(run)?;
    fs::remove_dir_all(run.join("drives"))?;
    fs::remove_file(run.join("episodes.csv"))?;
    change_result(run, |result| {
        for key in ["grid", "paper", "plain_q", "random_walk", "noise"] {
            result[key] = Value::Null;
        }
        result["learners"] = json!([]);
    })?;
    let html = fs::read_to_string(write_report(run)?)?;
    check_page(run, &html)?;
    for absent in [
        "<h2>Learning",
        "<h2>Parameter usage",
        "<h2>Finalists",
        "the paper’s set</td>",
        "plain Q",
        "random walk",
        ">rank<",
        "<svg",
    ] {
        assert!(!html.contains(absent), "{absent}");
    }
    for present in [
        "holds no <code>episodes.csv</code>",
        "takes more ticks than ranking.max_ticks (20\u{202f}000\u{202f}000) and was not driven",
    ] {
        assert!(html.contains(present), "{present}");
    }
    Ok(())
}

#[test]
fn a_grid_without_its_sets_says_so() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let run = folder.path();
    support::grid(run)?;
    fs::remove_file(run.join("grid.csv"))?;
    let html = fs::read_to_string(write_report(run)?)?;
    check_page(run, &html)?;
    assert!(html.contains("holds no <code>grid.csv</code>"));
    assert!(!run.join("report/sorted-values.svg").exists());
    Ok(())
}

/// One line of the picture has 100,000 episodes before it is made shorter.
#[test]
fn very_many_episodes_are_drawn_with_few_points() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let run = folder.path();
    support::train(run)?;
    fs::remove_dir_all(run.join("drives"))?;
    let mut text = String::from("learner,episode,steps,return,last_value,terminated,kv,kl,ks,ki\n");
    for episode in 0..100_000 {
        writeln!(text, "{},{},1,0.25,{},false,,,,", episode % 5, episode / 5, episode % 97)?;
    }
    fs::write(run.join("episodes.csv"), text)?;
    let html = fs::read_to_string(write_report(run)?)?;
    check_page(run, &html)?;
    let texts = texts(&fs::read_to_string(run.join("report/learning-values.svg"))?)?;
    assert!(texts.contains(&"20000".to_owned()), "{texts:?}");
    Ok(())
}

#[test]
fn a_single_drive_shows_its_measures() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let run = folder.path();
    support::train(run)?;
    change_result(run, |result| {
        result["kind"] = json!("drive");
        result["gains"] = json!([{ "kv": 3.0, "kl": 21.0, "ks": 21.0, "ki": 0.7 }]);
        result["reason"] = json!("goal");
        result["arrived"] = json!(true);
        result["true_poses"] = json!(true);
        result["joined"] = json!(false);
        result["switches"] = json!([]);
        for (key, value) in [
            ("driven_s", 4.5),
            ("progress", 0.98),
            ("along_m2", 1.4),
            ("cross_m2", 0.06),
            ("mean_abs_cross_track_m", 0.31),
            ("max_cross_track_m", 1.23),
            ("steering_travel_radps", 0.2),
            ("lateral_acceleration_max_mps2", 1.9),
        ] {
            result[key] = json!(value);
        }
    })?;
    let html = fs::read_to_string(write_report(run)?)?;
    check_page(run, &html)?;
    for part in ["<h1>lane change: drive</h1>", "cross-track error [m]", "1.230", "ended by: goal"]
    {
        assert!(html.contains(part), "{part}");
    }
    assert!(!html.contains("off the path"));
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
        .replace("\"educated-q\"", "\"</p><script>\"")
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
    check_error("result.json", Some("{\"mse_m2\": 1}"), &["result.json", "schema: is missing"])?;
    check_error(
        "result.json",
        Some("{\"schema\": 3}"),
        &["result.json", "this version of pathtune reads 2"],
    )?;
    let grid = include_str!("fixtures/grid.json");
    let dream = grid.replace("\"kind\": \"grid\"", "\"kind\": \"dream\\ning\"");
    check_error("result.json", Some(&dream), &["result.json", "dream"])?;
    let nameless = grid.replace("\"size\"", "\"sise\"");
    check_error("result.json", Some(&nameless), &["result.json", "missing field `size`"])?;
    let wordy = grid.replace("\"rank_mse\": 597", "\"rank_mse\": \"x\"");
    check_error("result.json", Some(&wordy), &["result.json", "invalid type: string \"x\""])?;
    let set = "1,1,1,1,0.8,0.8,1.4,0.1,0.2,0.3,false\n";
    let sets = |rows: &str| {
        format!(
            "kv,kl,ks,ki,value,distance,mse_m2,path_mean_m,path_p95_m,path_max_m,arrived\n{rows}"
        )
    };
    check_error("grid.csv", Some(""), &["grid.csv", "holds 0 sets", "750"])?;
    check_error("grid.csv", Some(&sets(set)), &["grid.csv", "holds 1 sets"])?;
    check_error("grid.csv", Some(&sets(&format!("{set}1,2\n"))), &["grid.csv:3", "2 values"])?;
    check_error(
        "grid.csv",
        Some(&sets(&set.replace("0.8,0.8", "x,0.8"))),
        &["grid.csv:2", "value"],
    )?;
    check_error("grid.csv", Some("kv\n1\n"), &["grid.csv:2", "missing field `value`"])?;
    let file = "drives/a.csv";
    check_error(file, Some(""), &["a.csv", "no tick"])?;
    check_error(file, Some(HEADER), &["a.csv", "no tick"])?;
    check_error(file, Some("tick,time_s\n0,0\n"), &["a.csv:2", "x_m"])?;
    check_error(file, Some(&drive("0,0,0,0,0,0,0,0,0,0,0,0\n0,1\n")), &["a.csv:3", "2 values"])?;
    check_error(file, Some(&drive("0,0,0,x,0,0,0,0,0,0,0,0\n")), &["a.csv:2", "speed_mps"])?;
    check_error(
        file,
        Some(&drive("0,0,0,0,0,0,NaN,0,0,0,0,0\n")),
        &["a.csv:2", "along_track_m: NaN"],
    )?;
    check_error(
        file,
        Some(&drive("0,0,0,0,inf,0,0,0,0,0,0,0\n")),
        &["a.csv:2", "reference_x_m: inf"],
    )?;
    check_error(file, Some(&drive("0,0,0,0,0,0,0,0,0,0,0,-1\n")), &["a.csv:2", "zone"])?;
    Ok(())
}

#[test]
fn errors_of_episodes_name_the_line() -> Result<()> {
    let header = "learner,episode,steps,return,last_value,terminated,kv,kl,ks,ki\n";
    let good = "0,0,1,0.1,0.8,true,3,21,21,0.7\n";
    for (row, says) in [
        ("0,1,1,x,0.8,false,,,,", "return"),
        ("0,1,1,NaN,0.8,false,,,,", "return: NaN"),
        ("0,1,1,0.1,inf,false,,,,", "last_value: inf"),
        ("5,0,1,0.1,0.8,false,,,,", "learner: is 5"),
        ("-1,0,1,0.1,0.8,false,,,,", "learner"),
        ("0,1,1", "3 values"),
    ] {
        let folder = tempfile::tempdir()?;
        let run = folder.path();
        support::train(run)?;
        fs::write(run.join("episodes.csv"), format!("{header}{good}{row}\n"))?;
        let error = write_report(run).err().context("no error")?.to_string();
        assert_eq!(error.lines().count(), 1, "{error}");
        assert!(error.contains("episodes.csv:3: ") && error.contains(says), "{error}");
    }
    Ok(())
}

#[test]
fn a_run_of_an_earlier_version_is_refused_in_one_line() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let run = folder.path();
    fs::write(run.join("result.json"), "{\"schema\": 1, \"kind\": \"train\", \"distance\": 0.8}")?;
    fs::write(run.join("config.toml"), "maneuver = \"lane_change\"\n")?;
    let error = write_report(run).err().context("no error")?.to_string();
    let path = run.join("result.json");
    assert_eq!(
        error,
        format!(
            "{}: made by an earlier version of pathtune; read it with that version, or run again",
            path.display()
        )
    );
    Ok(())
}
