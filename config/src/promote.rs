//! Promotion of tuned gains into a vehicle's file, and rollback: from text to text, without files.
//!
//! Everything else in the text stays as it is, including comments and order.

use std::collections::BTreeMap;

use toml_edit::{ArrayOfTables, DocumentMut, InlineTable, Item, Table, Value};

use crate::{NamedParameters, Provenance, Replacement, TunedGains, Vehicle};

/// The largest number of sets in a manoeuvre's history; the oldest are removed.
pub const HISTORY_LIMIT: usize = 20;

/// A parameter may change by this share of its present value; a larger change needs `--force`.
pub const CHANGE_LIMIT: f64 = 0.3;

/// A parameter that would change by more than [`CHANGE_LIMIT`].
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// Its name.
    pub name: String,
    /// Its present value.
    pub old: f64,
    /// Its new value.
    pub new: f64,
}

impl Change {
    /// Change in per cent of the present value; infinite from 0.
    pub fn percent(&self) -> f64 {
        if self.old == self.new { 0.0 } else { 100.0 * (self.new / self.old - 1.0) }
    }
}

/// How each parameter changes, in the order of the new ones; parameters that only one side has are left out.
pub fn changes(old: &NamedParameters, new: &NamedParameters) -> Vec<Change> {
    let change = |(name, new): &(String, f64)| {
        Some(Change { name: name.clone(), old: old.get(name)?, new: *new })
    };
    new.0.iter().filter_map(change).collect()
}

/// The parameters that change by more than [`CHANGE_LIMIT`].
pub fn large_changes(old: &NamedParameters, new: &NamedParameters) -> Vec<Change> {
    // 1.3 / 1 may be some bits above 1.3: a change by exactly the limit must pass.
    let limit = 100.0 * CHANGE_LIMIT + 1e-9;
    changes(old, new).into_iter().filter(|change| change.percent().abs() > limit).collect()
}

/// The first key of the geometry in which two vehicles differ, with both values. Gains that were tuned with another
/// geometry are those of another car.
pub fn geometry_difference(a: &Vehicle, b: &Vehicle) -> Option<(&'static str, String, String)> {
    if a.model != b.model {
        return Some(("model", format!("{:?}", a.model), format!("{:?}", b.model)));
    }
    [
        ("wheelbase_m", a.wheelbase_m, b.wheelbase_m),
        ("tracked_point_m", a.tracked_point_m, b.tracked_point_m),
        ("steering_limit_rad", a.steering_limit_rad, b.steering_limit_rad),
        ("steering_rate_radps", a.steering_rate_radps, b.steering_rate_radps),
    ]
    .into_iter()
    .find(|(_, a, b)| a != b)
    .map(|(key, a, b)| (key, a.to_string(), b.to_string()))
}

/// The place in the history that a rollback restores: the `nth` newest, or without a number the newest that was
/// replaced by a promotion, so that repeated rollbacks go further and further back.
pub fn rollback_place(set: &TunedGains, nth: Option<usize>) -> Option<usize> {
    match nth {
        Some(nth) => set.history.len().checked_sub(nth).filter(|_| nth > 0),
        None => set.history.iter().rposition(|past| past.replaced_by == Replacement::Promotion),
    }
}

/// Writes a law's parameters and their provenance below `gains.MANEUVER`. The gains that were there go onto the
/// history.
///
/// # Errors
/// If the text is not TOML, or what is there are not gains.
pub fn promote(
    text: &str,
    maneuver: &str,
    law: &str,
    parameters: &NamedParameters,
    provenance: &Provenance,
) -> Result<String, String> {
    edit(text, maneuver, |set| {
        if set.contains_key("kv") || set.contains_key("parameters") {
            retire(set, &provenance.promoted_at, Replacement::Promotion)?;
        }
        let values = parameters.0.iter().map(|(name, value)| (name.clone(), (*value).into()));
        put_set(set, law, values);
        let origin = toml::to_string(provenance).map_err(|error| error.to_string())?;
        let origin: DocumentMut = origin.parse().map_err(|error| format!("{error}"))?;
        put_table(set, "provenance", origin.as_table().clone());
        Ok(())
    })
}

/// Restores the gains at `place` of the history, with their provenance. The gains that were there go onto the history.
///
/// # Errors
/// If the text is not TOML, or there is no such place.
pub fn rollback(text: &str, maneuver: &str, place: usize, at: &str) -> Result<String, String> {
    edit(text, maneuver, |set| {
        let history = history_of(set)?;
        if place >= history.len() {
            return Err("there are no such gains".to_owned());
        }
        let mut past = history.get(place).expect("checked").clone();
        history.remove(place);
        retire(set, at, Replacement::Rollback)?;
        let (law, parameters) = set_of(&past).map_err(|why| format!("history: {why}"))?;
        put_set(set, &law, parameters);
        match past.remove("provenance").map(Item::into_table) {
            Some(Ok(origin)) => put_table(set, "provenance", origin),
            _ => drop(set.remove("provenance")),
        }
        Ok(())
    })
}

/// Moves a copy of the present parameters onto the history.
fn retire(set: &mut Table, at: &str, by: Replacement) -> Result<(), String> {
    let (law, parameters) = set_of(set)?;
    let mut past = Table::new();
    put_set(&mut past, &law, parameters);
    past.insert("replaced_at", toml_edit::value(at));
    past.insert("replaced_by", toml_edit::value(by.name()));
    if let Some(origin) = set.get("provenance") {
        let origin = origin.clone().into_table().map_err(|_| "provenance: is not a table")?;
        put_table(&mut past, "provenance", origin);
    }
    let history = history_of(set)?;
    history.push(past);
    while history.len() > HISTORY_LIMIT {
        history.remove(0);
    }
    Ok(())
}

/// The law and the parameters that a table holds, as they are written there. Also reads the form of earlier versions:
/// four gains without a separate table.
fn set_of(set: &Table) -> Result<(String, Vec<(String, Value)>), String> {
    let value = |name: &str, item: Option<&Item>| {
        let value = item.and_then(Item::as_value).ok_or_else(|| format!("has no {name}"))?;
        let mut value = value.clone();
        value.decor_mut().clear();
        Ok((name.to_owned(), value))
    };
    let Some(parameters) = set.get("parameters") else {
        let gains = EARLIER_GAINS.into_iter().map(|name| value(name, set.get(name)));
        return Ok(("paper".to_owned(), gains.collect::<Result<_, String>>()?));
    };
    let law = set.get("law").and_then(Item::as_str).ok_or("has no law")?;
    let parameters = parameters.as_table_like().ok_or("parameters: is not a table")?;
    let named = parameters.iter().map(|(name, item)| value(name, Some(item)));
    Ok((law.to_owned(), named.collect::<Result<_, String>>()?))
}

/// The gains that earlier versions wrote: those of the paper's law.
const EARLIER_GAINS: [&str; 4] = ["kv", "kl", "ks", "ki"];

/// Writes a law and its parameters, in the form of this version. Comments next to the parameters stay.
fn put_set(set: &mut Table, law: &str, parameters: impl IntoIterator<Item = (String, Value)>) {
    let mut earlier = Table::new();
    for name in EARLIER_GAINS {
        if let Some((key, item)) = set.remove_entry(name) {
            earlier.insert_formatted(&key, item);
        }
    }
    put(set, "law", law.into());
    if has_comments(&earlier) && !set.contains_key("parameters") {
        put_table(set, "parameters", earlier);
    }
    match set.get_mut("parameters") {
        // A table of its own has room for comments.
        Some(Item::Table(table)) => {
            let parameters: Vec<(String, Value)> = parameters.into_iter().collect();
            table.retain(|key, _| parameters.iter().any(|(name, _)| name == key));
            for (name, value) in parameters {
                put(table, &name, value);
            }
        }
        _ => put(set, "parameters", InlineTable::from_iter(parameters).into()),
    }
}

fn has_comments(table: &Table) -> bool {
    let has = |text: Option<&toml_edit::RawString>| {
        text.and_then(toml_edit::RawString::as_str).is_some_and(|text| text.contains('#'))
    };
    table.iter().any(|(name, item)| {
        let key = table.key(name).map(|key| key.leaf_decor());
        let value = item.as_value().map(|value| value.decor());
        [key, value].into_iter().flatten().any(|it| has(it.prefix()) || has(it.suffix()))
    })
}

fn history_of(set: &mut Table) -> Result<&mut ArrayOfTables, String> {
    let history = set.entry("history").or_insert_with(|| ArrayOfTables::new().into());
    if !history.is_array_of_tables() {
        let tables = std::mem::take(history).into_array_of_tables();
        *history = tables.map_err(|_| "history: is not a list of tables")?.into();
    }
    Ok(history.as_array_of_tables_mut().expect("just made"))
}

/// Replaces a value, and keeps the comments of the old one.
fn put(set: &mut Table, name: &str, mut value: Value) {
    match set.get_mut(name) {
        // In its place: a key that is put in anew loses the comments above it.
        Some(Item::Value(old)) => {
            *value.decor_mut() = old.decor().clone();
            *old = value;
        }
        _ => {
            set.insert(name, Item::Value(value));
        }
    }
}

/// Replaces a table. A table from elsewhere contains its place in that document, which must not become
/// its place here.
fn put_table(set: &mut Table, name: &str, mut table: Table) {
    let old = set.get(name).and_then(Item::as_table);
    table.set_position(old.and_then(Table::position));
    *table.decor_mut() = old.map(|old| old.decor().clone()).unwrap_or_default();
    table.set_implicit(false);
    table.set_dotted(false);
    set.insert(name, Item::Table(table));
}

/// Changes the table `gains.MANEUVER`, and checks that it holds gains afterwards, and that nothing else has changed.
fn edit(
    text: &str,
    maneuver: &str,
    change: impl FnOnce(&mut Table) -> Result<(), String>,
) -> Result<String, String> {
    let mut document: DocumentMut = text.parse().map_err(|error| format!("{error}"))?;
    let is_new = document.get("gains").and_then(|gains| gains.get(maneuver)).is_none();
    let last_comment = document.trailing().as_str().unwrap_or_default().to_owned();
    let gains = table_below(document.as_table_mut(), "gains", true)?;
    let set = table_below(gains, maneuver, false)?;
    if is_new {
        // Put at the very end: a comment after the last key stays before it.
        set.set_position(Some(isize::MAX));
        set.decor_mut().set_prefix(format!("{last_comment}\n"));
    }
    change(set).map_err(|why| format!("gains.{maneuver}: {why}"))?;
    if set.get("history").and_then(Item::as_array_of_tables).is_some_and(ArrayOfTables::is_empty) {
        set.remove("history");
    }
    if is_new {
        document.set_trailing("");
    }
    let mut new = document.to_string();
    if text.contains("\r\n") {
        new = new.replace("\r\n", "\n").replace('\n', "\r\n");
    }
    // The file determines how a car drives: check the result before it is used.
    let (before, after) = (rest_of(text, maneuver)?, rest_of(&new, maneuver)?);
    if before.0 != after.0 || after.1.is_none() {
        return Err("cannot be edited without changing its other keys; write [gains.…] as tables"
            .to_owned());
    }
    Ok(new)
}

/// Splits a file into everything except the set of a manoeuvre, and that set.
fn rest_of(text: &str, maneuver: &str) -> Result<(toml::Table, Option<TunedGains>), String> {
    let mut rest: toml::Table = text.parse().map_err(|error| format!("{error}"))?;
    let gains = rest.remove("gains").unwrap_or(toml::Table::new().into());
    let mut gains: BTreeMap<String, toml::Value> =
        gains.try_into().map_err(|error| format!("gains: {error}"))?;
    let set = gains.remove(maneuver).map(toml::Value::try_into).transpose();
    let set = set.map_err(|error| format!("gains.{maneuver}: {error}"))?;
    for (name, set) in gains {
        rest.insert(format!("gains.{name}"), set);
    }
    Ok((rest, set))
}

/// The table `name`, turned into one with its own header, in whichever way it is written.
fn table_below<'a>(
    above: &'a mut Table,
    name: &str,
    implicit: bool,
) -> Result<&'a mut Table, String> {
    let item = above.entry(name).or_insert_with(|| {
        let mut table = Table::new();
        table.set_implicit(implicit);
        Item::Table(table)
    });
    let was_table = item.is_table();
    let table = std::mem::take(item).into_table();
    let mut table = table.map_err(|_| format!("{name}: is not a table"))?;
    if !was_table || table.is_dotted() {
        table.set_dotted(false);
        table.set_implicit(implicit);
    }
    if !was_table && let Some(mut key) = above.key_mut(name) {
        // The blanks around a key do not belong in a header.
        key.leaf_decor_mut().clear();
    }
    above.insert(name, Item::Table(table));
    Ok(above.get_mut(name).and_then(Item::as_table_mut).expect("just put there"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn provenance(digest: &str) -> Provenance {
        Provenance {
            digest: digest.to_owned(),
            promoted_at: "2025-01-02T03:04:05Z".to_owned(),
            run: "mine \"quoted\"".to_owned(),
            maneuver: "lane_change".to_owned(),
            path_hash: None,
            vehicle: "tesla_model_3".to_owned(),
            seed: i64::MAX as u64,
            alphas: vec![0.1, 0.5],
            compensate_dead_time: Some(true),
            noise: true,
            drives: Some(10),
            distance: 0.1 + 0.2,
            mse_m2: 0.5,
            tuner: Some("educated-q".to_owned()),
            objective: Some("distance".to_owned()),
            path_mean_m: Some(0.1),
            path_max_m: None,
            grid_size: Some(750),
            rank_value: None,
            rank_distance: Some(8),
            rank_mean: Some(3),
            mean_low: Some(-0.25),
            mean_high: None,
            pathtune: "0.1.0".to_owned(),
        }
    }

    fn set_of(text: &str) -> TunedGains {
        rest_of(text, "lane_change").unwrap().1.unwrap()
    }

    fn gains(kv: f64) -> NamedParameters {
        crate::paper_law().named(&crate::Parameters::of(&[kv, 21.0, 21.0, 0.7]))
    }

    fn kv_of(set: &NamedParameters) -> f64 {
        set.get("kv").unwrap()
    }

    fn promote(
        text: &str,
        maneuver: &str,
        gains: NamedParameters,
        provenance: &Provenance,
    ) -> Result<String, String> {
        super::promote(text, maneuver, "paper", &gains, provenance)
    }

    const FILE: &str = "# My car.\nname = 'mine' # of old\nwheelbase_m   = 3\n\n[safety]\n# Softly.\njerk_limit_mps3 = 9.0\n\n# The end.\n";

    #[test]
    fn the_rest_of_the_file_stays_to_the_letter() {
        let text = promote(FILE, "lane_change", gains(3.0), &provenance("a")).unwrap();
        assert!(text.starts_with(FILE), "{text}");
        let set = set_of(&text);
        assert_eq!((&set.parameters, &set.provenance), (&gains(3.0), &Some(provenance("a"))));
        assert!(set.history.is_empty());
        let other = promote(&text, "round about", gains(2.0), &provenance("b")).unwrap();
        assert!(other.starts_with(&text), "{other}");
        let noted = text.replace("ki = 0.7 }", "ki = 0.7 } # quick");
        let again = promote(&noted, "lane_change", gains(2.5), &provenance("b")).unwrap();
        let line = "parameters = { kv = 2.5, kl = 21.0, ks = 21.0, ki = 0.7 } # quick\n";
        assert!(again.starts_with(FILE) && again.contains(line), "{again}");
        let set = set_of(&again);
        assert_eq!(set.history.len(), 1);
        assert_eq!(set.history[0].parameters, gains(3.0));
        assert_eq!(set.history[0].provenance, Some(provenance("a")));
        let order = ["[gains.lane_change]", ".provenance]", "[[gains.lane_change.history]]"];
        let places = order.map(|part| again.find(part).unwrap());
        assert!(places.is_sorted(), "{again}");
    }

    #[test]
    fn gains_are_brought_back_digit_for_digit() {
        let hand =
            format!("{FILE}\n[gains.lane_change]\nkv = 3.00\nkl = 2_1\nks = 2.1e1\nki = 0.70\n");
        let mut text = hand.clone();
        for (kv, digest) in [(2.5, "a"), (2.0, "b")] {
            text = promote(&text, "lane_change", gains(kv), &provenance(digest)).unwrap();
        }
        let back = |text: &str| {
            let place = rollback_place(&set_of(text), None)?;
            Some(rollback(text, "lane_change", place, "2025-02-02T00:00:00Z").unwrap())
        };
        let once = back(&text).unwrap();
        assert_eq!(set_of(&once).provenance, Some(provenance("a")));
        let twice = back(&once).unwrap();
        let written = "parameters = { kv = 3.00, kl = 2_1, ks = 2.1e1, ki = 0.70 }";
        assert!(twice.starts_with(FILE) && twice.contains(written), "{twice}");
        assert_eq!(set_of(&twice).provenance, None);
        // A set that was rolled back stays in the history, but is not the default of a rollback.
        assert_eq!(back(&twice), None);
        let set = set_of(&twice);
        assert_eq!(set.history.len(), 2);
        let named = rollback_place(&set, Some(2)).unwrap();
        let named = rollback(&twice, "lane_change", named, "2025-02-02T00:00:00Z").unwrap();
        assert_eq!(set_of(&named).provenance, Some(provenance("b")));
        assert_eq!(rollback_place(&set, Some(0)), None);
        assert_eq!(rollback_place(&set, Some(3)), None);
        assert!(rollback(FILE, "lane_change", 0, "x").is_err());
    }

    #[test]
    fn every_way_to_write_a_table_is_taken() {
        let inline = "{ kv = 1.0, kl = 2.0, ks = 3.0, ki = 0.5 }";
        let past =
            "kv = 1.0, kl = 2.0, ks = 3.0, ki = 0.5, replaced_at = 'x', replaced_by = 'rollback'";
        for written in [
            format!("gains = {{ lane_change = {inline}, x = {inline} }}\nname = 'mine'\n"),
            format!("gains.lane_change = {inline}\ngains.x = {inline}\nname = 'mine'\n"),
            "gains.lane_change.kv = 1.0\ngains.lane_change.kl = 2\ngains.lane_change.ks = 3\n\
             gains.lane_change.ki = 0.5\nname = 'mine'\n[safety]\njump_limit_m = 1.0\n"
                .to_owned(),
            format!(
                "[gains]\nlane_change = {inline}\nx = {inline}\n[safety]\njump_limit_m = 1.0\n"
            ),
            format!(
                "[gains.lane_change]\nkv=1.0\nkl=2.0\nks=3.0\nki=0.5\nhistory = [{{ {past} }}]\n[safety]\n"
            ),
            "[gains.lane_change]\r\nkv=1.0\r\nkl=2.0\r\nks=3.0\r\nki=0.5\r\n".to_owned(),
        ] {
            let old = set_of(&written);
            let text = promote(&written, "lane_change", gains(3.0), &provenance("a")).unwrap();
            let set = set_of(&text);
            assert_eq!(set.parameters, gains(3.0));
            assert_eq!(set.history.last().unwrap().parameters, old.parameters);
            let place = rollback_place(&set, None).unwrap();
            let back = set_of(&rollback(&text, "lane_change", place, "x").unwrap());
            assert_eq!((back.parameters, back.provenance), (old.parameters, None));
            let bare = text.replace("\r\n", "");
            assert!(!written.contains('\r') || !bare.contains('\n'), "{text:?}");
        }
        for wrong in ["gains = 3", "gains.lane_change = 3", "[gains.lane_change]\nkv = 1.0", "x = "]
        {
            assert!(
                promote(wrong, "lane_change", gains(3.0), &provenance("a")).is_err(),
                "{wrong}"
            );
        }
    }

    #[test]
    fn the_history_is_bounded() {
        let mut text = FILE.to_owned();
        for count in 0..30 {
            let next = gains(f64::from(count));
            text = promote(&text, "lane_change", next, &provenance("a")).unwrap();
        }
        let set = set_of(&text);
        assert_eq!(set.history.len(), HISTORY_LIMIT);
        let kvs = [&set.history[0].parameters, &set.history[19].parameters, &set.parameters];
        assert_eq!(kvs.map(kv_of), [9.0, 28.0, 29.0]);
    }

    #[test]
    fn a_change_beyond_the_limit_is_named() {
        let large = |old, new| large_changes(&gains(old), &gains(new));
        assert!(large(1.0, 1.3).is_empty() && large(1.0, 0.7).is_empty());
        assert!(large(0.0, 0.0).is_empty());
        assert_eq!(large(1.0, 1.31), [Change { name: "kv".to_owned(), old: 1.0, new: 1.31 }]);
        assert_eq!(large(1.0, 0.69).len(), 1);
        assert_eq!(large(0.0, 0.1)[0].percent(), f64::INFINITY);
    }

    proptest! {
        #[test]
        fn promotions_and_rollbacks_in_any_order_keep_the_rest(
            steps in proptest::collection::vec((0u8..3, 0.0..100.0f64, 1usize..25), 1..40),
        ) {
            let mut text = FILE.to_owned();
            let mut model: Vec<f64> = Vec::new();
            let mut now: Option<f64> = None;
            for (kind, kv, nth) in steps {
                if kind < 2 || now.is_none() {
                    text = promote(&text, "lane_change", gains(kv), &provenance("a")).unwrap();
                    model.extend(now);
                    now = Some(kv);
                } else {
                    let Some(place) = rollback_place(&set_of(&text), Some(nth)) else {
                        prop_assert!(nth > model.len());
                        continue;
                    };
                    text = rollback(&text, "lane_change", place, "x").unwrap();
                    let restored = model.remove(place);
                    model.extend(now);
                    now = Some(restored);
                }
                if model.len() > HISTORY_LIMIT {
                    model.remove(0);
                }
                prop_assert!(text.starts_with(FILE));
                let set = set_of(&text);
                prop_assert_eq!(Some(kv_of(&set.parameters)), now);
                let history: Vec<f64> = set.history.iter().map(|past| kv_of(&past.parameters)).collect();
                prop_assert_eq!(&history, &model);
            }
        }
    }
}
