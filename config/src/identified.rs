//! Values that were identified, put into a vehicle's file: from text to text, without files.
//!
//! Everything else in the text stays as it is, including comments and order.

use toml::Value;
use toml_edit::{DocumentMut, Item, Table};

/// Puts numbers into the text of a vehicle's file. A key may lie in a table, as in `ros2.odometry_point_m`.
///
/// # Errors
/// If the text is not TOML, a key cannot be put there, or anything else would change.
pub fn put_values(text: &str, values: &[(String, f64)]) -> Result<String, String> {
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
        match at.get(name) {
            Some(Item::Value(old)) => *new.decor_mut() = old.decor().clone(),
            Some(_) => return Err(format!("{key}: is not a number")),
            None => {}
        }
        at.insert(name, Item::Value(new));
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
