//! Under which name a vehicle's file holds gains: one for each path and law.
//!
//! Gains of a manoeuvre, or of a zone of a path, are under its name; those of a path of the user's own are under the name
//! of the path's file. The first law has the name to itself, every other one has `NAME/LAW`. Which path it was is known by
//! its hash: a file of another name may hold the same path, and one of the same name another path.

use std::collections::BTreeMap;
use std::path::Path;

use crate::presets::OWN_PATH;
use crate::{Piece, RunConfig, TunedGains};

/// The gains of a vehicle, by the names under which its file holds them.
pub type Slots = BTreeMap<String, TunedGains>;

/// The longest name of a path under which gains are held, in characters.
const MAX_NAME: usize = 40;

/// The name of a path's file without its ending, as the name of gains.
pub(crate) fn name_of(file: &Path) -> String {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    stem.chars().filter(|it| !it.is_control() && *it != '/').take(MAX_NAME).collect()
}

/// The gains for a name and a law: those of this law, or else those that are under the name itself, whatever their law.
pub fn held<'a>(gains: &'a Slots, name: &str, law: &str) -> Option<(&'a String, &'a TunedGains)> {
    let of_law = |(_, set): &(&String, &TunedGains)| set.law == law;
    let plain = gains.get_key_value(name);
    plain
        .filter(of_law)
        .or_else(|| gains.get_key_value(&with_law(name, law)).filter(of_law))
        .or(plain)
}

/// Where gains for a name and a law are put: where there are some of them already, or where there are none.
pub fn place(gains: &Slots, name: &str, law: &str) -> String {
    match held(gains, name, law) {
        Some((_, set)) if set.law != law => with_law(name, law),
        Some((key, _)) => key.clone(),
        None => name.to_owned(),
    }
}

fn with_law(name: &str, law: &str) -> String {
    format!("{name}/{law}")
}

/// Gains for the whole of a path, and how sure it is that they are for this path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Held<'a> {
    /// For this path, or for the manoeuvre of that name.
    Own(&'a String, &'a TunedGains),
    /// For another path or manoeuvre of the same name.
    Others(&'a String, &'a TunedGains),
    /// From an earlier version, which did not note the path.
    Unknown(&'a String, &'a TunedGains),
}

/// FNV-1a of numbers: no secret, only an identity.
fn hash(numbers: impl IntoIterator<Item = f64>) -> String {
    let bytes = numbers.into_iter().flat_map(|number| number.to_bits().to_le_bytes());
    let hash = bytes.fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    });
    format!("{hash:016x}")
}

impl RunConfig {
    /// The name under which a vehicle's file holds gains for the path as a whole.
    pub fn gains_name(&self) -> String {
        let is_named = self.is_own_path() && !self.path.name.is_empty();
        match self.maneuvers_due()[..] {
            [one] if !(is_named && one == OWN_PATH) => one.to_owned(),
            // One set for the whole path.
            _ if is_named => self.path.name.clone(),
            _ => self.maneuver.clone(),
        }
    }

    /// What tells a path from others of the same name, as 16 hexadecimal digits: its points, or its pieces and start. Where
    /// a closed path of points is begun does not count, nor do speeds, zones and laps.
    pub fn path_hash(&self) -> String {
        let points = &self.path.points;
        match points.split_last() {
            Some((last, once @ [first, ..])) if last == first => {
                let least = |a: &&[f64; 2], b: &&[f64; 2]| {
                    a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]))
                };
                let begin = once.iter().min_by(least);
                let begin = once.iter().position(|it| Some(it) == begin).unwrap_or_default();
                hash(once[begin..].iter().chain(&once[..begin]).flatten().copied())
            }
            _ => self.hash_from_start(),
        }
    }

    /// Whether a noted hash is that of this path.
    pub fn is_path(&self, noted: &str) -> bool {
        noted == self.path_hash() || noted == self.hash_from_start()
    }

    /// The hash as it was noted by earlier versions, which took a closed path with another start for another path.
    fn hash_from_start(&self) -> String {
        let path = &self.path;
        let mut numbers = vec![path.start.x_m, path.start.y_m, path.start.yaw_rad];
        for piece in &path.pieces {
            numbers.extend(match *piece {
                Piece::Straight { length_m } => [0.0, length_m, 0.0],
                Piece::Diagonal { length_m, offset_m } => [1.0, length_m, offset_m],
                Piece::Cosine { length_m, offset_m } => [2.0, length_m, offset_m],
                Piece::Arc { radius_m, angle_deg } => [3.0, radius_m, angle_deg],
            });
        }
        numbers.extend(path.points.iter().flatten());
        hash(numbers)
    }

    /// The gains that the vehicle's file holds for this path as a whole.
    pub fn gains_of_path(&self) -> Option<Held<'_>> {
        let (gains, law) = (&self.vehicle.gains, &*self.law.name);
        if !self.is_own_path() {
            let (key, set) = held(gains, &self.maneuver, law)?;
            let is_others = set.provenance.as_ref().is_some_and(|it| it.path_hash.is_some());
            return Some(if is_others { Held::Others(key, set) } else { Held::Own(key, set) });
        }
        let is_own = |(_, set): &(&String, &TunedGains)| {
            let noted = set.provenance.as_ref().and_then(|it| it.path_hash.as_deref());
            set.law == law && noted.is_some_and(|noted| self.is_path(noted))
        };
        let of_name = held(gains, &self.gains_name(), law);
        // Those under the path's own name, or else the newest, by whatever name its file had then.
        let promoted_at =
            |(_, set): &(&String, &TunedGains)| Some(set.provenance.as_ref()?.promoted_at.clone());
        let newest = || gains.iter().filter(is_own).max_by_key(promoted_at);
        if let Some((key, set)) = of_name.filter(is_own).or_else(newest) {
            return Some(Held::Own(key, set));
        }
        if let Some((key, set)) = of_name {
            let is_others = match &set.provenance {
                Some(it) => match &it.path_hash {
                    Some(noted) => !self.is_path(noted),
                    // Of a manoeuvre whose name the file happens to have.
                    None => it.maneuver != OWN_PATH,
                },
                // Written by hand under this name.
                None => false,
            };
            return Some(if is_others { Held::Others(key, set) } else { Held::Own(key, set) });
        }
        // Earlier versions had one name for all paths.
        let (key, set) = held(gains, &self.maneuver, law)?;
        Some(Held::Unknown(key, set))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Layers;

    fn on_path(name: &str, points: &str, car: &str) -> RunConfig {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let file = folder.path().join(name);
            std::fs::write(&file, text).unwrap();
            file
        };
        let (path, car) = (write(name, points), write("car.toml", car));
        let mut layers = Layers::own_path();
        layers.set_vehicle("--vehicle", car.to_str().unwrap()).unwrap();
        layers.add_path(&path).unwrap();
        layers.resolve().unwrap()
    }

    const PAPER: &str = "law = 'paper'\nparameters = { kv = 1, kl = 2, ks = 3, ki = 0.5 }\n";
    const OVAL: &str = "x_m,y_m\n0,0\n9,0\n19,0\n";
    const OTHER: &str = "x_m,y_m\n0,0\n9,0\n19.5,0\n";

    #[test]
    fn each_law_has_a_place_of_its_own() {
        let mut gains = Slots::new();
        let of = |law: &str| TunedGains {
            law: law.to_owned(),
            parameters: crate::NamedParameters(Vec::new()),
            provenance: None,
            history: Vec::new(),
        };
        assert_eq!(place(&gains, "oval", "stanley"), "oval");
        gains.insert("oval".to_owned(), of("stanley"));
        assert_eq!(place(&gains, "oval", "stanley"), "oval");
        assert_eq!(place(&gains, "oval", "paper"), "oval/paper");
        // As long as there is none of the law that drives, there is one of another law to tell of.
        assert_eq!(held(&gains, "oval", "paper").unwrap().1.law, "stanley");
        gains.insert("oval/paper".to_owned(), of("paper"));
        assert_eq!(held(&gains, "oval", "paper").unwrap().0, "oval/paper");
        assert_eq!(place(&gains, "oval", "paper"), "oval/paper");
        assert_eq!(held(&gains, "eight", "paper"), None);
    }

    #[test]
    fn a_closed_path_is_the_same_wherever_it_is_begun() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("lap.csv");
        let at = |it: u32| std::f64::consts::TAU * f64::from(it % 100) / 100.0;
        let point = |it| format!("{:.4},{:.4}\n", 20.0 * at(it).sin(), 20.0 * at(it).cos());
        std::fs::write(&file, format!("x_m,y_m\n{}", (0..=100).map(point).collect::<String>()))
            .unwrap();
        let begun_at = |start: Option<&str>| {
            let mut layers = Layers::own_path();
            let start = start.map(|it| it.parse().unwrap());
            layers.add_path_with(&file, start, &crate::PathOptions::default()).unwrap();
            layers.resolve().unwrap()
        };
        let (first, other) = (begun_at(None), begun_at(Some("20,0")));
        assert_ne!(first.path.points, other.path.points);
        assert_eq!(first.path_hash(), other.path_hash());
        assert!(first.is_path(&first.hash_from_start()) && !first.is_path("0"));
    }

    #[test]
    fn a_path_is_known_by_its_hash_and_not_by_its_file_s_name() {
        let plain = on_path("oval.csv", OVAL, "base = 'tesla_model_3'");
        assert_eq!((&*plain.gains_name(), plain.gains_of_path()), ("oval", None));
        let hash = plain.path_hash();
        assert_ne!(hash, on_path("oval.csv", OTHER, "base = 'tesla_model_3'").path_hash());
        let origin = format!(
            "[gains.oval.provenance]\ndigest = 'd'\npromoted_at = 'x'\nrun = 'r'\nmaneuver = 'path'\n\
             vehicle = 'v'\nseed = 1\nnoise = false\ndistance = 0\nmse_m2 = 0\npathtune = '1'\npath_hash = '{hash}'\n"
        );
        let car = format!("base = 'tesla_model_3'\n[gains.oval]\n{PAPER}{origin}");
        let own = |config: &RunConfig| matches!(config.gains_of_path(), Some(Held::Own(..)));
        assert!(own(&on_path("oval.csv", OVAL, &car)));
        assert!(own(&on_path("renamed.csv", OVAL, &car)));
        // Under its own name first, whatever the same path was called before.
        let earlier =
            car.clone() + &car.replace("base = 'tesla_model_3'", "").replace(".oval", ".a");
        let config = on_path("oval.csv", OVAL, &earlier);
        assert!(matches!(config.gains_of_path(), Some(Held::Own(key, _)) if key == "oval"));
        let renamed = earlier.replacen("promoted_at = 'x'", "promoted_at = 'y'", 1);
        let config = on_path("renamed.csv", OVAL, &renamed);
        assert!(matches!(config.gains_of_path(), Some(Held::Own(key, _)) if key == "oval"));
        let other = on_path("oval.csv", OTHER, &car);
        assert!(matches!(other.gains_of_path(), Some(Held::Others(..))));
        assert_eq!(on_path("renamed.csv", OTHER, &car).gains_of_path(), None);
        // A manoeuvre's are none of a path whose file has its name, nor the other way around.
        let of_maneuver = car.replace("gains.oval", "gains.roundabout");
        let on_file = |car: &str| on_path("roundabout.csv", OTHER, car);
        assert!(matches!(on_file(&of_maneuver).gains_of_path(), Some(Held::Others(..))));
        let plain = of_maneuver.replace("maneuver = 'path'", "maneuver = 'roundabout'");
        let plain = plain.replace(&format!("path_hash = '{hash}'\n"), "");
        assert!(matches!(on_file(&plain).gains_of_path(), Some(Held::Others(..))));
        let roundabout = |car: &str| {
            let mut config = Layers::maneuver("roundabout").unwrap().resolve().unwrap();
            config.vehicle.gains = on_file(car).vehicle.gains;
            config
        };
        assert!(own(&roundabout(&plain)));
        assert!(matches!(roundabout(&of_maneuver).gains_of_path(), Some(Held::Others(..))));
        // By hand, and of an earlier version, which had one name for all paths.
        let by_hand = format!("base = 'tesla_model_3'\n[gains.oval]\n{PAPER}");
        assert!(own(&on_path("oval.csv", OVAL, &by_hand)));
        let earlier = on_path("oval.csv", OVAL, &by_hand.replace("oval", "path"));
        assert!(matches!(earlier.gains_of_path(), Some(Held::Unknown(..))));
    }
}
