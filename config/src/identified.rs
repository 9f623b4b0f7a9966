//! What was identified, put into a vehicle's file: from text to text, without files.
//!
//! Everything else in the text stays as it is, including comments and order. `[uncertainty]` alone is replaced as a whole:
//! intervals of an earlier drive and those of this one would not belong together.

use toml::Value;
use toml_edit::{DocumentMut, Item, Table};

/// What is put into a vehicle's file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Found {
    /// Keys and values. A key may lie in a table, as in `ros2.odometry_point_m`.
    pub values: Vec<(String, f64)>,
    /// For keys of the vehicle, the 95 % interval.
    pub intervals: Vec<(String, [f64; 2])>,
    /// Where all that comes from, line by line: a comment above `[uncertainty]`.
    pub provenance: Vec<String>,
}

/// Puts what was found into the text of a vehicle's file.
///
/// # Errors
/// If the text is not TOML, a key cannot be put there, or anything else would change.
pub fn put_found(text: &str, found: &Found) -> Result<String, String> {
    let text = put_values(text, &found.values)?;
    if found.intervals.is_empty() {
        return Ok(text);
    }
    let mut document: DocumentMut = text.parse().map_err(|error| format!("{error}"))?;
    let mut stated = Table::new();
    stated.insert("identified", toml_edit::value(true));
    for (key, [low, high]) in &found.intervals {
        let interval: toml_edit::Array = [*low, *high].into_iter().collect();
        stated.insert(key, toml_edit::value(interval));
    }
    // What the user has written above the table stays: at the end of the keys that come before it, where he put it. What was
    // found in an earlier drive does not.
    let of_user = match document.get(UNCERTAINTY).and_then(Item::as_table) {
        Some(old) => {
            let above = old.decor().prefix().and_then(toml_edit::RawString::as_str);
            let above = above.unwrap_or_default();
            above.find(FOUND).map_or(above, |at| &above[..at]).trim_end().to_owned()
        }
        None => {
            let trailing = document.trailing().as_str().unwrap_or_default().trim_end().to_owned();
            document.set_trailing("");
            trailing
        }
    };
    let mut above = if of_user.is_empty() { String::from("\n") } else { format!("{of_user}\n\n") };
    for line in &found.provenance {
        // A line end in the name of a file would leave the comment.
        let line: String = line.chars().map(|it| if it.is_control() { '?' } else { it }).collect();
        above += &format!("# {line}\n");
    }
    stated.decor_mut().set_prefix(above);
    match document.get(UNCERTAINTY) {
        None => {}
        Some(Item::Table(old)) => match old.position() {
            Some(position) => stated.set_position(Some(position)),
            None => return Err(format!("{UNCERTAINTY}: write it as a table, [{UNCERTAINTY}]")),
        },
        Some(_) => {
            return Err(format!(
                "{UNCERTAINTY}: is written within a line; write it as a table, [{UNCERTAINTY}]"
            ));
        }
    }
    document.insert(UNCERTAINTY, Item::Table(stated));
    let mut new = document.to_string();
    if text.contains("\r\n") {
        new = new.replace("\r\n", "\n").replace('\n', "\r\n");
    }
    let without = |text: &str| -> Result<toml::Table, String> {
        let mut table: toml::Table = text.parse().map_err(|error| format!("{error}"))?;
        table.remove(UNCERTAINTY);
        Ok(table)
    };
    if without(&text)? != without(&new)? {
        return Err("cannot be edited without changing its other keys".to_owned());
    }
    Ok(new)
}

/// How the lines begin that say where intervals come from.
const FOUND: &str = "# Found by `pathtune identify`";
/// The table of the intervals.
const UNCERTAINTY: &str = "uncertainty";

/// Puts numbers into the text of a vehicle's file.
fn put_values(text: &str, values: &[(String, f64)]) -> Result<String, String> {
    let mut document: DocumentMut = text.parse().map_err(|error| format!("{error}"))?;
    for (key, value) in values {
        let mut at: &mut Table = document.as_table_mut();
        let (path, name) = match key.rsplit_once('.') {
            Some((path, name)) => (Some(path), name),
            None => (None, key.as_str()),
        };
        if let Some(path) = path {
            let item = at.entry(path).or_insert_with(|| Item::Table(Table::new()));
            at = item.as_table_mut().ok_or_else(|| {
                format!("{path}: is written within a line; write it as a table, [{path}]")
            })?;
        }
        let mut new = toml_edit::Value::from(*value);
        match at.get_mut(name) {
            // In its place: a key that is put in anew loses the comments above it.
            Some(Item::Value(old)) => {
                *new.decor_mut() = old.decor().clone();
                *old = new;
            }
            Some(_) => return Err(format!("{key}: is not a number")),
            None => {
                at.insert(name, Item::Value(new));
            }
        }
    }
    let mut new = document.to_string();
    if text.contains("\r\n") {
        new = new.replace("\r\n", "\n").replace('\n', "\r\n");
    }
    // The file determines how a car drives: check the result before it is used.
    let without = |text: &str| -> Result<(toml::Table, Vec<Option<Value>>), String> {
        let mut table: toml::Table = text.parse().map_err(|error| format!("{error}"))?;
        let taken = values.iter().map(|(key, _)| take(&mut table, key)).collect();
        Ok((table, taken))
    };
    let ((before, _), (after, put)) = (without(text)?, without(&new)?);
    let is_put = |(value, (_, wanted)): (&Option<Value>, &(String, f64))| matches!(value, Some(Value::Float(value)) if value.to_bits() == wanted.to_bits());
    if before != after || !put.iter().zip(values).all(is_put) {
        return Err("cannot be edited without changing its other keys".to_owned());
    }
    Ok(new)
}

/// Removes a key; a table that is empty then, too.
fn take(table: &mut toml::Table, key: &str) -> Option<Value> {
    let Some((path, name)) = key.rsplit_once('.') else { return table.remove(key) };
    let below = table.get_mut(path)?.as_table_mut()?;
    let taken = below.remove(name);
    if below.is_empty() {
        table.remove(path);
    }
    taken
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_put_where_they_belong_and_nothing_else_changes() {
        let text = "# Mine.\nname = \"mine\" # since spring\nwheelbase_m = 2.9 # by tape\n\n[safety]\n# Softly.\njerk_limit_mps3 = 60.0\n";
        let values =
            [("wheelbase_m", 2.875), ("steering_delay_s", 0.1), ("ros2.odometry_point_m", -0.25)];
        let values = values.map(|(key, value)| (key.to_owned(), value));
        let new = put_values(text, &values).unwrap();
        for part in ["# Mine.\n", "# since spring", "wheelbase_m = 2.875 # by tape", "# Softly."] {
            assert!(new.contains(part), "{new}");
        }
        let table: toml::Table = new.parse().unwrap();
        assert_eq!(table["steering_delay_s"].as_float(), Some(0.1));
        assert_eq!(table["ros2"]["odometry_point_m"].as_float(), Some(-0.25));
        // Once more changes nothing, and line ends stay.
        assert_eq!(put_values(&new, &values).unwrap(), new);
        let windows = put_values(&text.replace('\n', "\r\n"), &values).unwrap();
        assert_eq!(windows, new.replace('\n', "\r\n"));
    }

    #[test]
    fn comments_stay_above_their_keys_and_at_the_end_of_their_table() {
        let text = "# Mine.\nname = \"mine\"\n\n# By tape, axle to axle.\nwheelbase_m = 2.9\n# steering_limit_rad = 0.35\n";
        let found = |from: &str| Found {
            values: vec![("wheelbase_m".to_owned(), 2.87)],
            intervals: vec![("wheelbase_m".to_owned(), [2.86, 2.88])],
            provenance: vec![format!("Found by `pathtune identify` in {from}")],
        };
        let first = put_found(text, &found("one")).unwrap();
        let keys = "# Mine.\nname = \"mine\"\n\n# By tape, axle to axle.\nwheelbase_m = 2.87\n# steering_limit_rad = 0.35\n\n";
        let whole = |from: &str| {
            format!(
                "{keys}# Found by `pathtune identify` in {from}\n[uncertainty]\nidentified = true\nwheelbase_m = [2.86, 2.88]\n"
            )
        };
        assert_eq!(first, whole("one"));
        assert_eq!(put_found(&first, &found("two")).unwrap(), whole("two"));
    }

    #[test]
    fn intervals_replace_those_of_an_earlier_drive_and_say_where_they_come_from() {
        let text =
            "# Mine.\nwheelbase_m = 2.9 # by tape\n\n[safety]\n# Softly.\njerk_limit_mps3 = 60.0\n";
        let found = |low: f64, from: &str| Found {
            values: vec![("wheelbase_m".to_owned(), low + 0.01)],
            intervals: vec![("wheelbase_m".to_owned(), [low, low + 0.02])],
            provenance: vec![
                format!("Found by `pathtune identify` in {from}"),
                "a\nb = 3".to_owned(),
            ],
        };
        let first = put_found(text, &found(2.86, "one.mcap")).unwrap();
        for part in [
            "# by tape",
            "# Softly.",
            "\n# Found by `pathtune identify` in one.mcap\n# a?b = 3\n[uncertainty]\n",
        ] {
            assert!(first.contains(part), "{first}");
        }
        let table: toml::Table = first.parse().unwrap();
        assert_eq!(table["uncertainty"]["identified"].as_bool(), Some(true));
        assert_eq!(table["uncertainty"]["wheelbase_m"][1].as_float(), Some(2.88));
        let second = put_found(&first, &found(2.87, "two.mcap")).unwrap();
        assert!(second.contains("two.mcap") && !second.contains("one.mcap"), "{second}");
        assert_eq!(second.matches("[uncertainty]").count(), 1, "{second}");
        let why = put_found("uncertainty = { mass_kg = 3.0 }\n", &found(2.0, "x")).unwrap_err();
        assert!(why.contains("[uncertainty]"), "{why}");
    }

    #[test]
    fn what_is_no_table_or_no_number_is_refused() {
        let put = |text: &str| {
            put_values(text, &[("ros2.odometry_point_m".to_owned(), 1.0)]).unwrap_err()
        };
        assert!(put("ros2 = { domain_id = 3 }").contains("ros2: is written within a line"));
        assert!(put("wheelbase_m = ").contains("TOML parse error"));
        let table = put_values("[wheelbase_m]\n", &[("wheelbase_m".to_owned(), 1.0)]);
        assert!(table.unwrap_err().contains("wheelbase_m: is not a number"));
    }
}
