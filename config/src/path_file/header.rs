//! What the names of columns mean, in the words of the tools that write paths.

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    X,
    Y,
    Speed,
    Lat,
    Lon,
    /// From the line to the road's edge on its left.
    Left,
    /// To the one on its right.
    Right,
}

impl Role {
    /// The unit that its numbers are taken to have if nothing says another.
    pub(super) fn unit(self) -> Unit {
        match self {
            Self::Speed => Unit::new("m/s", 1.0),
            Self::Lat | Self::Lon => Unit::new("degrees", 1.0),
            _ => Unit::new("m", 1.0),
        }
    }

    /// The unit of this name, if it is one that its numbers may have.
    fn unit_of(self, name: &str) -> Option<Unit> {
        let table: &[(&[&str], Unit)] = match self {
            Self::Speed => &SPEEDS,
            Self::Lat | Self::Lon => &ANGLES,
            _ => &LENGTHS,
        };
        table.iter().find(|(names, _)| names.contains(&name)).map(|(_, unit)| *unit)
    }
}

/// A unit, and what its numbers are multiplied by to become metres or metres per second; degrees stay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Unit {
    pub(super) name: &'static str,
    pub(super) factor: f64,
}

impl Unit {
    const fn new(name: &'static str, factor: f64) -> Self {
        Self { name, factor }
    }
}

/// The units that are understood, in words.
pub(super) const UNITS: &str = "units are x_m, x_cm, x_mm, x_km, x_ft, v_mps, v_kmh, v_mph";

const LENGTHS: [(&[&str], Unit); 5] = [
    (&["m", "meter", "meters", "metre", "metres"], Unit::new("m", 1.0)),
    (&["cm"], Unit::new("cm", 0.01)),
    (&["mm"], Unit::new("mm", 0.001)),
    (&["km"], Unit::new("km", 1000.0)),
    (&["ft", "foot", "feet"], Unit::new("ft", 0.3048)),
];
const SPEEDS: [(&[&str], Unit); 3] = [
    (
        &["mps", "m/s", "ms", "m/sec", "meter/sec", "metersps", "ms-1", "ms^-1"],
        Unit::new("m/s", 1.0),
    ),
    (&["kmh", "km/h", "kph", "kmph"], Unit::new("km/h", 1.0 / 3.6)),
    (&["mph"], Unit::new("mph", 0.44704)),
];
const ANGLES: [(&[&str], Unit); 1] =
    [(&["deg", "degree", "degrees", "°"], Unit::new("degrees", 1.0))];
/// Units that a coordinate or a speed may have elsewhere: better refused than taken for something else.
const OTHERS: [&str; 8] = ["in", "inch", "px", "pixel", "rad", "yd", "kn", "knots"];

/// Words that may stand beside x, y and a speed without changing what they are.
const BESIDE: [&str; 35] = [
    "pos",
    "position",
    "pose",
    "point",
    "coord",
    "coordinate",
    "coordinates",
    "field",
    "utm",
    "map",
    "ref",
    "reference",
    "local",
    "global",
    "world",
    "translation",
    "center",
    "centre",
    "path",
    "wp",
    "waypoint",
    "waypoints",
    "target",
    "desired",
    "longitudinal",
    "linear",
    "twist",
    "trajectory",
    "opt",
    "raceline",
    "racetraj",
    "header",
    "msg",
    "transform",
    "car",
];

/// What a column of this name holds, with its unit if the name tells one, or the unit that is not understood.
/// `None` for a column that is no part of a path, such as a time, a yaw or a curvature.
pub(super) fn meaning(name: &str) -> Option<(Role, Result<Option<Unit>, String>)> {
    let name = name.trim().to_lowercase();
    let (words, unit_word) = words_and_unit(&name);
    let role = role(&words)?;
    let unit = match unit_word {
        None => Ok(None),
        Some(word) => role.unit_of(&word).map(Some).ok_or(word),
    };
    Some((role, unit))
}

/// The unit that a column of this name tells for what the user says that it holds; that of another kind of quantity, or one that
/// is not understood, is an error.
pub(super) fn unit_told(name: &str, role: Role) -> Result<Option<Unit>, String> {
    let name = name.trim().to_lowercase();
    match words_and_unit(&name).1 {
        Some(word) if is_unit(&word) => role.unit_of(&word).map(Some).ok_or(word),
        _ => Ok(None),
    }
}

/// The words of a name in small letters, and its unit, if it tells one.
fn words_and_unit(name: &str) -> (Vec<&str>, Option<String>) {
    let (base, told) = match name.find(['[', '(']) {
        Some(at) => {
            let told = name[at + 1..].trim_end_matches([']', ')']).trim().replace(' ', "");
            (name[..at].trim(), Some(told))
        }
        None => (name, None),
    };
    let mut words: Vec<&str> = base
        .split(|c: char| !c.is_alphanumeric() && c != '°')
        .filter(|word| !word.is_empty())
        .collect();
    let mut unit_word = told;
    if unit_word.is_none() {
        // x_m, v_km_h, v_m_s: the last word, or the last two.
        if let [_, .., a, b] = words[..]
            && let Some(joined) = [("m", "s"), ("km", "h")].iter().find(|it| **it == (a, b))
        {
            unit_word = Some(format!("{}/{}", joined.0, joined.1));
            words.truncate(words.len() - 2);
        } else if let [_, .., last] = words[..]
            && is_unit(last)
        {
            unit_word = Some(last.to_owned());
            words.pop();
        }
    }
    (words, unit_word)
}

fn is_unit(word: &str) -> bool {
    let of = |table: &[(&[&str], Unit)]| table.iter().any(|(names, _)| names.contains(&word));
    of(&LENGTHS) || of(&SPEEDS) || of(&ANGLES) || OTHERS.contains(&word)
}

fn role(words: &[&str]) -> Option<Role> {
    // field.latitude, gps_lat: what stands beside it names the message or the receiver.
    let is_beside = |word: &&str| {
        BESIDE.contains(word) || matches!(*word, "gps" | "gnss" | "fix" | "navsatfix")
    };
    let mut of_place = words.iter().copied().filter(|word| !is_beside(word));
    match (of_place.next(), of_place.next()) {
        (Some("lat" | "latitude"), None) => return Some(Role::Lat),
        (Some("lon" | "lng" | "long" | "longitude"), None) => return Some(Role::Lon),
        _ => {}
    }
    let joined = words.join("_");
    match joined.as_str() {
        "easting" | "east" | "utm_easting" | "utm_east" => return Some(Role::X),
        "northing" | "north" | "utm_northing" | "utm_north" => return Some(Role::Y),
        "left" | "w_left" | "w_tr_left" | "width_left" | "left_width" | "left_bound" => {
            return Some(Role::Left);
        }
        "right" | "w_right" | "w_tr_right" | "width_right" | "right_width" | "right_bound" => {
            return Some(Role::Right);
        }
        _ => {}
    }
    let mut role = None;
    for word in words {
        let one = match *word {
            "x" | "px" | "posx" | "tx" => Some(Role::X),
            "y" | "py" | "posy" | "ty" => Some(Role::Y),
            "v" | "vx" | "speed" | "velocity" | "vel" | "vref" => Some(Role::Speed),
            word if BESIDE.contains(&word) => None,
            // An index, as in poses[0].x, says nothing; anything else says that it is another quantity.
            word if word.parse::<u32>().is_ok() => None,
            _ => return None,
        };
        role = match (role, one) {
            // velocity_x, and twist.linear.x below, is the speed forward.
            (Some(Role::Speed), Some(Role::X)) | (Some(Role::X), Some(Role::Speed)) => {
                Some(Role::Speed)
            }
            (Some(_), Some(_)) => return None,
            (before, one) => before.or(one),
        };
    }
    let is_twist = words.contains(&"linear") || words.contains(&"twist");
    match role {
        Some(Role::X) if is_twist => Some(Role::Speed),
        Some(Role::Y) if is_twist => None,
        role => role,
    }
}

/// Whether a field is nothing but a unit, as below the names of some tools.
pub(super) fn is_only_unit(field: &str) -> bool {
    is_unit(field.trim_matches(['[', ']', '(', ')']).trim().to_lowercase().as_str())
}

/// Whether a name says that its column is a speed of some kind, as that of a limit, and not one across the line.
pub(super) fn sounds_like_speed(name: &str) -> bool {
    let name = name.trim().to_lowercase();
    let (words, _) = words_and_unit(&name);
    let is_across = words.iter().any(|word| matches!(*word, "y" | "z" | "angular" | "lateral"));
    let is_speed = |word: &&str| {
        matches!(*word, "v" | "vx" | "vref" | "vmax" | "vmin" | "vlim")
            || ["vel", "speed"].iter().any(|of| word.starts_with(of))
    };
    words.iter().any(is_speed) && !is_across
}

/// Whether a column is the one of this name, with or without metres in it.
pub(super) fn is_named(name: &str, wanted: &str) -> bool {
    let name = name.trim().to_lowercase();
    name.strip_suffix("_m").unwrap_or(&name) == wanted
}

/// Whether a speed of this name is in metres per second by custom, where the name tells no unit.
pub(super) fn is_speed_in_si(name: &str) -> bool {
    let name = name.trim().to_lowercase();
    matches!(name.as_str(), "v" | "vx" | "v_ref" | "vref" | "v_x") || name.contains("linear")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_many_tools_are_understood() {
        let unit = |name: &str| match meaning(name) {
            Some((role, Ok(unit))) => Some((role, unit.map(|unit| unit.name))),
            Some((_, Err(_))) => panic!("{name}"),
            None => None,
        };
        for (name, role, told) in [
            ("x_m", Role::X, Some("m")),
            ("X", Role::X, None),
            ("x [m]", Role::X, Some("m")),
            ("x(cm)", Role::X, Some("cm")),
            ("y_mm", Role::Y, Some("mm")),
            ("pos_x", Role::X, None),
            (".pose.position.y", Role::Y, None),
            ("field.pose.pose.position.x", Role::X, None),
            ("utm_easting", Role::X, None),
            ("Latitude", Role::Lat, None),
            ("lng", Role::Lon, None),
            ("field.latitude", Role::Lat, None),
            ("gps_lat", Role::Lat, None),
            ("GPS Longitude", Role::Lon, None),
            ("lat_deg", Role::Lat, Some("degrees")),
            ("v", Role::Speed, None),
            ("vx_mps", Role::Speed, Some("m/s")),
            ("speed [km/h]", Role::Speed, Some("km/h")),
            ("speed_kmh", Role::Speed, Some("km/h")),
            ("v_m_s", Role::Speed, Some("m/s")),
            ("velocity", Role::Speed, None),
            ("longitudinal_velocity_mps", Role::Speed, Some("m/s")),
            ("twist.linear.x", Role::Speed, None),
            ("w_tr_right_m", Role::Right, Some("m")),
            ("width_left", Role::Left, None),
        ] {
            assert_eq!(unit(name), Some((role, told)), "{name}");
        }
        for name in [
            "s_m",
            "psi_rad",
            "kappa_radpm",
            "ax_mps2",
            "yaw",
            "z",
            "qx",
            "orientation.x",
            "pose.orientation.x",
            "time",
            "twist.angular.x",
            "twist.linear.y",
            "change_flag",
            "",
            "acceleration_x",
            "x_variance",
        ] {
            assert_eq!(unit(name), None, "{name}");
        }
        assert_eq!(meaning("x_yd").unwrap().1, Err("yd".to_owned()));
        assert_eq!(meaning("speed [knots]").unwrap().1, Err("knots".to_owned()));
    }
}
