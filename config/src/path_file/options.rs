//! What a user says of a path's file beside its name.

use std::fmt;
use std::str::FromStr;

use super::header::{Role, UNITS, Unit, meaning};

/// How the file of a path is read, and what is made of it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PathOptions {
    /// Which columns hold what; found by the header, or by the numbers, if not given.
    pub columns: Option<Columns>,
    /// What the coordinates are; found by their names and sizes, if not given.
    pub crs: Option<Crs>,
    /// How far the smoothed line may lie from the points, in metres; if not given, points are smoothed only where their
    /// noise is all that keeps the car from driving them.
    pub smooth_m: Option<f64>,
    /// Whether speeds that the car cannot drive are lowered to those that it can.
    pub speed_profile: bool,
}

/// What a pair of coordinates is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Crs {
    /// Metres of any flat frame: of a map, of UTM, of a national grid.
    Metres,
    /// Web-Mercator (EPSG:3857), whose unit is a metre at the equator alone.
    WebMercator,
    /// Latitude and longitude in degrees (WGS 84).
    Wgs84,
}

impl FromStr for Crs {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.to_ascii_lowercase().as_str() {
            "metres" | "meters" | "utm" | "local" => Ok(Self::Metres),
            "web-mercator" | "epsg:3857" => Ok(Self::WebMercator),
            "wgs84" | "wgs-84" | "epsg:4326" => Ok(Self::Wgs84),
            _ => Err("give metres, web-mercator or wgs84".to_owned()),
        }
    }
}

/// Which columns of a file hold what, as in `x=1,y=2,v=5`, `x_cm=2,y_cm=3` or `lat=latitude,lon=longitude`.
#[derive(Debug, Clone, PartialEq)]
pub struct Columns(pub(super) Vec<Column>);

/// One of them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Column {
    pub(super) role: Role,
    /// As the header tells it, or else the usual one, if the user does not say it.
    pub(super) unit: Option<Unit>,
    pub(super) place: Place,
}

/// Where a column is.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Place {
    /// Counted from 0.
    Index(usize),
    /// By its name in the header.
    Name(String),
}

impl FromStr for Columns {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut columns: Vec<Column> = Vec::new();
        for part in text.split(',').map(str::trim).filter(|part| !part.is_empty()) {
            let (what, place) = part.split_once('=').ok_or_else(|| {
                format!(
                    "{part:?} is no assignment; write x=1,y=2,v=5, with the columns counted from 1"
                )
            })?;
            let (role, unit) = match meaning(what.trim()) {
                Some((role, Ok(unit))) => (role, unit),
                Some((_, Err(unit))) => {
                    return Err(format!("{what} has the unit {unit}, which is not known; {UNITS}"));
                }
                None => {
                    return Err(format!(
                        "{what} is none of x, y, v, lat, lon, left, right; {UNITS}"
                    ));
                }
            };
            let place = match place.trim().parse::<usize>() {
                Ok(0) => return Err("columns are counted from 1".to_owned()),
                Ok(number) => Place::Index(number - 1),
                Err(_) => Place::Name(place.trim().to_owned()),
            };
            if columns.iter().any(|column| column.role == role) {
                return Err(format!("{what} is given twice"));
            }
            columns.push(Column { role, unit, place });
        }
        let has = |role: Role| columns.iter().any(|column| column.role == role);
        let is_whole = (has(Role::X) && has(Role::Y)) || (has(Role::Lat) && has(Role::Lon));
        if !is_whole {
            return Err("must name both coordinates, as x=1,y=2 or lat=1,lon=2".to_owned());
        }
        Ok(Self(columns))
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Index(index) => write!(f, "{}", index + 1),
            Self::Name(name) => f.write_str(name),
        }
    }
}
