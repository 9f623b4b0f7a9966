//! A path of the user's own, as a layer: its file, and the zones' file next to it.

use std::io::Read;
use std::path::Path;

use serde::Deserialize;
use toml::{Spanned, Table, Value};

use crate::made_path::{Below, make};
use crate::path_file::{PathFile, RecordedPath};
use crate::presets::OWN_PATH;
use crate::resample::Resampled;
use crate::slots;
use crate::{ConfigError, Layers, PathOptions, StartAt, ZoneConfig, path_file};

/// The size of the largest file that is read: enough for a million rows of many columns, but a wrong file is not read
/// for minutes.
const MAX_FILE_BYTES: u64 = 64 << 20;
/// The longest drive, as of the key drive.loop_time_s.
const LONGEST_DRIVE_S: f64 = 3600.0;
/// Time that the vehicle has to reach the end after the reference has.
const AFTER_END_S: f64 = 5.0;

/// The zones' file: `slalom.toml` next to `slalom.csv`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ZonesFile {
    zones: Vec<Spanned<ZoneConfig>>,
}

impl Layers {
    /// The embedded layers below a path of the user's own; [`Layers::add_path`] puts the path on top.
    pub fn own_path() -> Self {
        Self::embedded(OWN_PATH).expect("the preset is checked by a test")
    }

    /// The embedded layers below a document that names its manoeuvre, as a resolved configuration does.
    ///
    /// # Errors
    /// If it names none, or one that is unknown.
    pub fn of_document(text: &str) -> Result<Self, ConfigError> {
        let name = text
            .parse::<Table>()
            .ok()
            .and_then(|table| table.get("maneuver").and_then(Value::as_str).map(str::to_owned));
        match name.as_deref() {
            Some("path") => Ok(Self::own_path()),
            Some(name) => Self::maneuver(name),
            None => {
                let problem = "is not named; name a manoeuvre, or a path with --path FILE";
                Err(ConfigError::new("--config", "maneuver", problem))
            }
        }
    }

    /// Puts the path of a file on top: points, speeds, start, zones (and no rows of the paper's tables), and a loop
    /// time that is enough to reach its end at the speeds and for the laps that the layers hold so far.
    ///
    /// The file is a table with the columns `x_m`, `y_m` and optionally `v_mps`, a raceline of TUM's form, or one of many
    /// others; [`Layers::notes`] tells how it was read. The zones are those of the TOML file of the same name next to it, if there is one; otherwise the path is a
    /// single zone named `path`.
    ///
    /// # Errors
    /// At the first mistake in either file, with its line and what to do about it.
    pub fn add_path(&mut self, file: &Path) -> Result<(), ConfigError> {
        self.add_path_with(file, None, &PathOptions::default())
    }

    /// As [`Layers::add_path`], with what the user says of the file, and for a drive that begins at the point of a closed
    /// path which is nearest to a place in the file's coordinates.
    ///
    /// # Errors
    /// As there, and if the path cannot be started at that place.
    pub fn add_path_with(
        &mut self,
        file: &Path,
        start: Option<StartAt>,
        options: &PathOptions,
    ) -> Result<(), ConfigError> {
        let origin = file.display().to_string();
        let bytes = read(file, "name a CSV file with columns x_m,y_m")?;
        let given = path_file::parse(&origin, &bytes, options)?;
        self.add_given_path(file, given, start, options)
    }

    /// As [`Layers::add_path_with`], for a path that something else has read from the file.
    ///
    /// # Errors
    /// As there.
    pub fn add_recorded_path(
        &mut self,
        file: &Path,
        path: RecordedPath,
        start: Option<StartAt>,
        options: &PathOptions,
    ) -> Result<(), ConfigError> {
        let given = path_file::of_recording(&file.display().to_string(), path, options)?;
        self.add_given_path(file, given, start, options)
    }

    fn add_given_path(
        &mut self,
        file: &Path,
        mut given: PathFile,
        start: Option<StartAt>,
        options: &PathOptions,
    ) -> Result<(), ConfigError> {
        let origin = file.display().to_string();
        let vehicle = self.vehicle_so_far();
        let most_mps = ["vehicle.speed_limit_mps", "supervisor.speed_limit_mps"]
            .iter()
            .filter_map(|key| self.number(key))
            .fold(f64::INFINITY, f64::min);
        let reference_mps = self.number("reference.speed_mps");
        let below = Below { vehicle: vehicle.as_ref(), reference_mps, most_mps };
        let mut path = make(&origin, &mut given, below, options)?;
        if let Some(start) = start {
            refuse_zones_with_start(file)?;
            let ([x_m, y_m], words) = given.place([start.x_m, start.y_m]);
            let told = words.map(|words| format!("--start {start} is taken as {words}"));
            path.begin_at(&origin, StartAt { x_m, y_m, ..start }).map_err(|error| {
                // What it names is what was made of the user's numbers.
                let problem = told.iter().fold(error.problem, |it, told| format!("{it}; {told}"));
                ConfigError { problem, ..error }
            })?;
            given.notes.extend(told);
        }
        self.note(given.notes.iter().map(|note| format!("{origin}: {note}")));

        let floats =
            |values: &[f64]| Value::Array(values.iter().map(|v| Value::Float(*v)).collect());
        let points = path.points.iter().map(|point| floats(point)).collect();
        self.put(&origin, "paper", Value::Array(Vec::new()))?;
        self.put(&origin, "path.pieces", Value::Array(Vec::new()))?;
        self.put(&origin, "path.points", Value::Array(points))?;
        self.put(&origin, "path.speeds_mps", floats(&path.speeds_mps))?;
        self.put(
            &origin,
            "path.widths_m",
            path.widths_m.iter().map(|it| floats(it)).collect::<Vec<_>>(),
        )?;
        let first = format!("{origin}:{}", given.lines[path.given[0]]);
        self.put(&first, "path.start.x_m", path.points[0][0])?;
        self.put(&first, "path.start.y_m", path.points[0][1])?;
        self.put(&first, "path.start.yaw_rad", path.yaw_rad)?;
        for (index, row) in path.given.iter().enumerate() {
            let line = format!("{origin}:{}", given.lines[*row]);
            if !path.speeds_mps.is_empty() {
                self.note_origin(format!("path.speeds_mps[{index}]"), line.clone());
            }
            self.note_origin(format!("path.points[{index}]"), line);
        }
        if let Some(loop_time_s) = self.loop_time_s(&path) {
            if loop_time_s > LONGEST_DRIVE_S {
                return Err(self.too_long(&origin, &path, loop_time_s));
            }
            self.put(&origin, "drive.loop_time_s", loop_time_s)?;
        }
        self.put(&origin, "path.name", slots::name_of(file))?;
        self.add_zones(file, path.length_m)
    }

    /// The time in which the reference reaches the end of the path, and some more, in whole seconds; `None`
    /// if the layers hold no speed to compute it from, which is reported when they are resolved.
    fn loop_time_s(&self, path: &Resampled) -> Option<f64> {
        let laps = self.number("path.laps").unwrap_or(1.0).max(1.0);
        let lap_s = if path.speeds_mps.is_empty() {
            path.length_m
                / self.number("reference.speed_mps").filter(|speed_mps| *speed_mps > 0.0)?
        } else {
            path.time_s
        };
        let at_speed_s = laps * lap_s;
        let ramp_s = self.number("reference.ramp_s").filter(|ramp_s| *ramp_s >= 0.0)?;
        // During the ramp the reference is as far as it would be at full speed after t²/(2·ramp); after the ramp, as
        // far as after t − ramp/2.
        let end_s = if at_speed_s < 0.5 * ramp_s {
            (2.0 * ramp_s * at_speed_s).sqrt()
        } else {
            at_speed_s + 0.5 * ramp_s
        };
        Some((end_s + AFTER_END_S).ceil())
    }

    /// What to do about a path that takes longer than a drive may.
    fn too_long(&self, origin: &str, path: &Resampled, loop_time_s: f64) -> ConfigError {
        let laps = self.number("path.laps").unwrap_or(1.0);
        let of_laps =
            if laps > 1.0 { format!("{laps} laps of it take") } else { "takes".to_owned() };
        let (at, way_out) = match self.number("reference.speed_mps") {
            Some(speed_mps) if path.speeds_mps.is_empty() => (
                format!(" at reference.speed_mps = {speed_mps}"),
                "write speeds (v_mps), or raise it with --set reference.speed_mps=…",
            ),
            _ => (" at its speeds".to_owned(), "raise them"),
        };
        let fewer = if laps > 1.0 { ", or drive fewer laps" } else { "" };
        let problem = format!(
            "{of_laps} {loop_time_s} s{at}, but a drive lasts at most {LONGEST_DRIVE_S} s; {way_out}{fewer}"
        );
        ConfigError::new(origin, "", problem)
    }

    /// Sets the zones from the file next to the path's file, or the one zone if there is none.
    fn add_zones(&mut self, path_file: &Path, length_m: f64) -> Result<(), ConfigError> {
        let file = path_file.with_extension("toml");
        if file == path_file || !file.exists() {
            let zone = zone_value("path", 0.0);
            return self.put(&path_file.display().to_string(), "path.zones", vec![zone]);
        }
        let origin = file.display().to_string();
        let bytes = read(&file, "it is next to the path's file; correct or remove it")?;
        let at = |offset: usize| {
            let offset = offset.min(bytes.len());
            let line = bytes[..offset].iter().filter(|byte| **byte == b'\n').count() + 1;
            format!("{origin}:{line}")
        };
        let text = std::str::from_utf8(&bytes).map_err(|error| {
            let problem = "is not UTF-8 text; save the file as UTF-8";
            ConfigError::new(at(error.valid_up_to()), "", problem)
        })?;
        let zones: ZonesFile = toml::from_str(text).map_err(|error| {
            let problem = format!(
                "{}; the file next to a path's file may hold only [[zones]] with name and from_m",
                error.message()
            );
            ConfigError::new(at(error.span().map_or(0, |span| span.start)), "", problem)
        })?;
        for (index, zone) in zones.zones.iter().enumerate() {
            let from_m = zone.get_ref().from_m;
            if from_m >= length_m {
                let key = format!("path.zones[{index}].from_m");
                let problem = format!("is {from_m}, but the path ends at {length_m:.2} m");
                return Err(ConfigError::new(at(zone.span().start), key, problem));
            }
        }
        let values: Vec<_> = zones
            .zones
            .iter()
            .map(|zone| zone_value(&zone.get_ref().name, zone.get_ref().from_m))
            .collect();
        self.put(&origin, "path.zones", values)?;
        for (index, zone) in zones.zones.iter().enumerate() {
            self.note_origin(format!("path.zones[{index}]"), at(zone.span().start));
        }
        Ok(())
    }
}

fn zone_value(name: &str, from_m: f64) -> Value {
    let mut zone = Table::new();
    zone.insert("name".to_owned(), Value::String(name.to_owned()));
    zone.insert("from_m".to_owned(), Value::Float(from_m));
    Value::Table(zone)
}

/// Reads a file, unless it is too large to be a path or its zones.
fn read(file: &Path, hint: &str) -> Result<Vec<u8>, ConfigError> {
    let origin = file.display().to_string();
    let unreadable = |error: std::io::Error| {
        // A folder with a bag in it says itself what to name.
        let hint = match error.kind() {
            std::io::ErrorKind::Other => String::new(),
            _ => format!("; {hint}"),
        };
        let problem = format!("cannot be read: {error}{hint}");
        ConfigError::new(&origin, "", problem)
    };
    let mut bytes = Vec::new();
    let opened = crate::files::open_regular(file).map_err(unreadable)?;
    opened.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        let problem = format!("holds more than {} MiB; thin the points out", MAX_FILE_BYTES >> 20);
        return Err(ConfigError::new(&origin, "", problem));
    }
    Ok(bytes)
}

/// Zones are given from the first point of the file on, and a start elsewhere would move them.
fn refuse_zones_with_start(path_file: &Path) -> Result<(), ConfigError> {
    let zones = path_file.with_extension("toml");
    if zones == path_file || !zones.exists() {
        return Ok(());
    }
    let problem = format!(
        "asks for a start on the way, but {} holds zones, which begin at the path's first point; let the file begin where the \
         vehicle stands, or leave out --start",
        zones.display()
    );
    Err(ConfigError::new("--start", "", problem))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RunConfig;
    use crate::points::MAX_POINTS;
    use crate::resample::resample;
    use proptest::prelude::*;
    use std::fs;
    use std::path::PathBuf;

    fn own_path(file: &Path) -> Result<Layers, ConfigError> {
        let mut layers = Layers::own_path();
        layers.add_path(file)?;
        Ok(layers)
    }

    /// A folder with a path's file, and the zones' file if there is one.
    fn folder(path: &str, zones: Option<&str>) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("slalom.csv");
        fs::write(&file, path).unwrap();
        if let Some(zones) = zones {
            fs::write(folder.path().join("slalom.toml"), zones).unwrap();
        }
        (folder, file)
    }

    fn resolve(path: &str, zones: Option<&str>) -> Result<RunConfig, ConfigError> {
        let (_folder, file) = folder(path, zones);
        own_path(&file)?.resolve()
    }

    /// The file of a curve with this many points, its y and v as functions of x.
    fn curve(count: usize, step_m: f64, y_m: impl Fn(f64) -> f64) -> String {
        let rows = (0..count).map(|index| {
            let x_m = index as f64 * step_m;
            format!("{x_m},{}\n", y_m(x_m))
        });
        std::iter::once("x_m,y_m\n".to_owned()).chain(rows).collect()
    }

    const STRAIGHT: &str = "x_m,y_m\n1,2\n1,5\n1,12\n";

    #[test]
    fn a_path_comes_with_start_zone_and_time() {
        let config = resolve(STRAIGHT, None).unwrap();
        assert_eq!(config.maneuver, "path");
        assert_eq!((config.path.pieces.len(), config.path.points.len()), (0, 41));
        assert_eq!((config.path.points[0], config.path.points[40]), ([1.0, 2.0], [1.0, 12.0]));
        assert_eq!((config.path.start.x_m, config.path.start.y_m), (1.0, 2.0));
        assert_eq!(config.path.start.yaw_rad, std::f64::consts::FRAC_PI_2);
        assert_eq!(config.path.zones, [ZoneConfig { name: "path".to_owned(), from_m: 0.0 }]);
        // 10 m at 1.5 m/s take 6.67 s, the ramp takes 0.5 s more, and there are 5 s after the end.
        assert_eq!(config.drive.loop_time_s, 13.0);
        let faster = resolve("x_m,y_m,v_mps\n0,0,2\n5,0,4\n10,0,4\n", None).unwrap();
        assert_eq!(faster.drive.loop_time_s, 9.0);
        assert_eq!(faster.path.speeds_mps.len(), 41);
        assert_eq!((faster.path.speeds_mps[10], faster.path.speeds_mps[30]), (3.0, 4.0));
    }

    #[test]
    fn a_path_lies_on_any_manoeuvre_and_takes_its_speed() {
        let (_folder, file) = folder(STRAIGHT, None);
        let mut layers = Layers::maneuver("roundabout").unwrap();
        layers.set("reference.speed_mps=0.01").unwrap();
        layers.add_path(&file).unwrap();
        let config = layers.resolve().unwrap();
        assert_eq!((config.maneuver.as_str(), config.drive.loop_time_s), ("roundabout", 1006.0));
        let mut slow = Layers::maneuver("lane_change").unwrap();
        slow.set("reference.speed_mps=0.001").unwrap();
        let long = slow.add_path(&file).unwrap_err().to_string();
        for part in ["10006 s", "reference.speed_mps = 0.001", "v_mps"] {
            assert!(long.contains(part), "{long:?} lacks {part:?}");
        }
        // Longer than any drive may last: an error, not a shortened drive.
        let mut none = Layers::maneuver("lane_change").unwrap();
        none.set("reference.speed_mps=0.0").unwrap();
        none.add_path(&file).unwrap();
        assert!(none.resolve().unwrap_err().to_string().contains("reference.speed_mps"));
    }

    #[test]
    fn a_resolved_path_is_a_layer_that_changes_nothing() {
        let text = curve(80, 0.7, |x_m| 2.0 * libm::sin(0.2 * x_m));
        let (_folder, file) = folder(&text, Some("[[zones]]\nname='a'\nfrom_m=0\n"));
        let config = own_path(&file).unwrap().resolve().unwrap();
        let text = toml::to_string(&config).unwrap();
        let mut again = own_path(&file).unwrap();
        again.add_document("resolved.toml", &text).unwrap();
        assert_eq!(again.resolve().unwrap(), config);
        assert_eq!(RunConfig::from_resolved(&text).unwrap(), config);
    }

    #[test]
    fn later_errors_name_the_file_s_line() {
        let corner = "x_m,y_m\n0,0\n1,0\n2,0\n3,0\n# corner\n3,1\n3,2\n3,3\n";
        let message = resolve(corner, None).unwrap_err().to_string();
        assert!(message.contains("slalom.csv:") && message.contains("path.points["), "{message}");
        let line: usize = message.split("slalom.csv:").nth(1).unwrap()[..1].parse().unwrap();
        assert!((4..=5).contains(&line), "{message}");
        // An error in a layer on top of the path names that layer.
        let (_folder, file) = folder(STRAIGHT, None);
        let mut layers = own_path(&file).unwrap();
        layers.add_document("my.toml", "[path]\npoints = [[1, 2], [1, 2]]").unwrap();
        let message = layers.resolve().unwrap_err().to_string();
        assert!(message.starts_with("my.toml:2: path.points[1]: "), "{message}");
        let mut layers = own_path(&file).unwrap();
        layers.set("path.pieces=[{kind='straight',length_m=1.0}]").unwrap();
        assert!(
            layers.resolve().unwrap_err().to_string().contains("path.points: is set together with")
        );
    }

    #[test]
    fn zones_stand_in_a_file_beside_it() {
        let zones =
            "[[zones]]\nname = \"in\"\nfrom_m = 0\n\n[[zones]]\nname = \"out\"\nfrom_m = 4.5\n";
        let config = resolve(STRAIGHT, Some(zones)).unwrap();
        assert_eq!(config.path.zones[1], ZoneConfig { name: "out".to_owned(), from_m: 4.5 });
        let check = |zones: &str, parts: &[&str]| {
            let message = resolve(STRAIGHT, Some(zones)).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{message:?} lacks {part:?}");
            }
            assert!(!message.contains('\n'), "{message:?}");
        };
        check("[[zones]]\nname = 'a'\n", &["slalom.toml:1", "from_m", "[[zones]]"]);
        check("[[zones]]\nname='a'\nfrom_m=0\nto_m=3\n", &["slalom.toml:4", "to_m"]);
        check("speed = 3\n", &["slalom.toml:1", "speed", "[[zones]]"]);
        check("\n[[zones]\n", &["slalom.toml:2"]);
        check("zones = []\n", &["slalom.toml", "path.zones", "empty"]);
        check("[[zones]]\nname='a'\nfrom_m=1\n", &["slalom.toml:1", "path.zones[0].from_m"]);
        check(
            "[[zones]]\nname='a'\nfrom_m=0\n[[zones]]\nname='b'\nfrom_m=nan\n",
            &["slalom.toml:4", "path.zones[1].from_m", "NaN"],
        );
        check(
            "[[zones]]\nname='a'\nfrom_m=0\n[[zones]]\nname='b'\nfrom_m=11\n",
            &["slalom.toml:4", "path.zones[1].from_m", "ends at 10.00 m"],
        );
    }

    #[test]
    fn a_file_that_cannot_be_read_says_why() {
        let message = own_path(Path::new("/no/such.csv")).unwrap_err().to_string();
        assert!(message.starts_with("/no/such.csv: cannot be read: "), "{message}");
        let folder = tempfile::tempdir().unwrap();
        assert!(own_path(folder.path()).unwrap_err().to_string().contains("cannot be read"));
    }

    #[test]
    fn of_a_folder_with_a_bag_the_bag_is_named() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["metadata.yaml", "run_0.mcap"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let message = own_path(folder.path()).unwrap_err().to_string();
        assert!(message.contains("it is a folder; name the bag in it, "), "{message}");
        assert!(message.ends_with("run_0.mcap"), "{message}");
    }

    #[test]
    fn a_start_is_in_the_coordinates_of_the_file() {
        // A circle 44.6 m wide to the east, at 60° where a unit of web-Mercator is half a metre.
        let circle = |[x, y]: [f64; 2], [dx, dy]: [f64; 2]| -> String {
            let angle = |at: i32| std::f64::consts::TAU * f64::from(at % 24) / 24.0;
            let [east, north] =
                [|it: f64| 0.5 - 0.5 * libm::cos(it), |it: f64| 0.5 * libm::sin(it)];
            let row = |it: f64| format!("{},{}\n", x + dx * east(it), y + dy * north(it));
            (0..=24).map(|at| row(angle(at))).collect()
        };
        let starts = |text: &str, crs: Option<&str>, at: &str, told: &str| {
            let (_folder, file) = folder(text, None);
            let options =
                PathOptions { crs: crs.map(|it| it.parse().unwrap()), ..Default::default() };
            let mut layers = Layers::own_path();
            layers.add_path_with(&file, Some(at.parse().unwrap()), &options).unwrap();
            let notes = layers.notes().join("; ");
            assert!(notes.contains(told), "{notes}");
            let start = layers.resolve().unwrap().path.start;
            let off_m = libm::hypot(start.x_m - 44.6, start.y_m);
            assert!(off_m < 0.5, "{at}: ({}, {})", start.x_m, start.y_m);
        };
        let degrees = format!("lon,lat\n{}", circle([11.0, 60.0], [0.0008, 0.0004]));
        starts(&degrees, None, "60,11.0008", "taken as latitude 60, longitude 11.0008");
        starts(&degrees, None, "11.0008,60", "taken as latitude 60, longitude 11.0008");
        starts(&degrees, None, "44.6,0", "taken as metres east and north");
        let (_folder, file) = folder(&degrees, None);
        let far = Some("60.1,11".parse().unwrap());
        let far = Layers::own_path().add_path_with(&file, far, &PathOptions::default());
        let far = far.unwrap_err().to_string();
        assert!(
            far.contains("; --start (60.1, 11) is taken as latitude 60.1, longitude 11"),
            "{far}"
        );
        let y = 8_399_737.889_818_36;
        let mercator = format!("x,y\n{}", circle([1_289_000.0, y], [89.2, 89.2]));
        let at = format!("1289089.2,{y}");
        starts(&mercator, Some("web-mercator"), &at, "taken as web-Mercator");
        let utm = format!("x,y\n{}", circle([482_301.0, 4_419_876.0], [44.6, 44.6]));
        starts(&utm, None, "482345.6,4419876", "taken as the file's own coordinates");
    }

    #[test]
    fn a_stop_on_the_way_is_not_lost_between_the_line_s_points() {
        // The points of the line lie 0.25 m apart, and on both sides of the stop.
        let rows = (0..60).map(|it| (0.18 * f64::from(it), if it == 30 { 0.0 } else { 2.0 }));
        let rows: String = rows.map(|(x_m, v_mps)| format!("{x_m:.2},0,{v_mps}\n")).collect();
        let config = resolve(&format!("x_m,y_m,v_mps\n{rows}"), None).unwrap();
        let slowest = config.path.speeds_mps.iter().copied().fold(f64::INFINITY, f64::min);
        assert_eq!(slowest, 0.1);
    }

    #[test]
    fn a_car_slower_than_the_usual_speed_is_told_which_speed_it_can_drive() {
        let (_folder, file) = folder(STRAIGHT, None);
        let mut layers = own_path(&file).unwrap();
        layers.set("vehicle.speed_limit_mps=1.2").unwrap();
        let message = layers.resolve().unwrap_err().to_string();
        assert!(message.contains("--set reference.speed_mps=1.2"), "{message}");
    }

    #[test]
    fn a_coarse_circle_stays_a_circle() {
        for count in [6, 9, 20] {
            for closed in [true, false] {
                let turns = if closed { 1.0 } else { 0.7 };
                let points: Vec<_> = (0..=count)
                    .map(|index| {
                        let share = if closed { index % count } else { index } as f64;
                        let angle = std::f64::consts::TAU * turns * share / f64::from(count);
                        [10.0 * libm::cos(angle), 10.0 * libm::sin(angle)]
                    })
                    .collect();
                let path = resample(&points, &[], MAX_POINTS);
                for [x_m, y_m] in &path.points {
                    let off_m = libm::hypot(*x_m, *y_m) - 10.0;
                    assert!(off_m.abs() < 1e-2, "{count} points: {off_m} m");
                }
                assert!(
                    (path.length_m / (std::f64::consts::TAU * 10.0 * turns) - 1.0).abs() < 1e-3
                );
                assert!((path.yaw_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn the_longest_path_is_resampled_more_coarsely() {
        let path = resample(&[[0.0, 0.0], [1e5, 0.0]], &[], MAX_POINTS);
        assert_eq!(path.points.len(), MAX_POINTS);
    }

    proptest! {
        #[test]
        fn points_are_evenly_spaced_with_exact_ends(
            steps in prop::collection::vec((0.3..3.0f64, -0.3..0.3f64, 0.1..50.0f64), 2..40),
        ) {
            let (mut at, mut heading) = ([3.0, -7.0], 1.0);
            let (mut points, mut speeds) = (vec![at], vec![2.0]);
            for (step_m, turn_rad, speed_mps) in steps {
                heading += turn_rad;
                at = [at[0] + step_m * libm::cos(heading), at[1] + step_m * libm::sin(heading)];
                points.push(at);
                speeds.push(speed_mps);
            }
            let path = resample(&points, &speeds, MAX_POINTS);
            prop_assert_eq!(path.points[0], points[0]);
            prop_assert_eq!(path.points.last(), points.last());
            prop_assert_eq!(path.speeds_mps.last(), speeds.last());
            let step_m = path.length_m / (path.points.len() - 1) as f64;
            for pair in path.points.windows(2) {
                let apart_m = libm::hypot(pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]);
                prop_assert!(apart_m < step_m * 1.0001 && apart_m > step_m * 0.95, "{apart_m} {step_m}");
            }
            let (low, high) = (speeds.iter().copied().fold(50.0, f64::min), 50.0);
            prop_assert!(path.speeds_mps.iter().all(|v| (low..=high).contains(v)));
            prop_assert!(path.given.windows(2).all(|pair| pair[0] <= pair[1]));
        }
    }
}
