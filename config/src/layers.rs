//! Layers of a configuration in a stack, each value with the place where it was set.

use std::collections::BTreeMap;
use std::path::Path;

use toml::{Table, Value};
use toml_edit::TableLike;

use crate::lengths::fit_lengths;
use crate::presets::{hint, maneuver_names, names_in, nearest, preset};
use crate::{ConfigError, Limit, RunConfig, Vehicle, tuned, validate, vehicles};

/// A stack of layers: the topmost value of each key, with its origin.
#[derive(Debug, Clone)]
pub struct Layers {
    values: Table,
    /// Where a key was last set, by its dotted path; if absent, in the presets.
    origins: BTreeMap<String, String>,
    base: String,
    /// The manoeuvre's own grids, by the name of the law.
    grids: Table,
    /// The values that the vehicle's file has from another car.
    borrowed: Option<vehicles::Borrowed>,
    /// How the path's file was read: what the user may not expect.
    notes: Vec<String>,
}

/// A part of the configuration that a name selects: its values come from a preset with that name, or from a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    Vehicle,
    Law,
    Tuner,
    Objective,
}

impl Part {
    const ALL: [Self; 4] = [Self::Vehicle, Self::Law, Self::Tuner, Self::Objective];

    /// The key whose value is the name.
    fn selected_by(self) -> &'static str {
        match self {
            Self::Vehicle => "vehicle_preset",
            Self::Law => "law_preset",
            Self::Tuner => "learning.tuner",
            Self::Objective => "objective.name",
        }
    }

    /// The folder of its presets, and the key below which their values are.
    fn place(self) -> (&'static str, &'static str) {
        match self {
            Self::Vehicle => ("vehicles", "vehicle"),
            Self::Law => ("laws", "law"),
            Self::Tuner => ("tuners", "tuner"),
            Self::Objective => ("objectives", "objective"),
        }
    }
}

/// A speed that every vehicle can drive.
const SLOW_MPS: f64 = 0.01;

impl Layers {
    /// The embedded layers of a manoeuvre: readings, manoeuvre, vehicle.
    ///
    /// # Errors
    /// If no manoeuvre has that name; the error names the nearest one.
    pub fn maneuver(name: &str) -> Result<Self, ConfigError> {
        if maneuver_names().any(|known| known == name) {
            return Self::embedded(name);
        }
        let known: Vec<_> = maneuver_names().collect();
        let problem = format!("unknown: {name}; {}", hint(name, &known));
        Err(ConfigError::new("maneuver", "", problem))
    }

    /// The embedded layers of a manoeuvre that is known to exist.
    pub(crate) fn embedded(name: &str) -> Result<Self, ConfigError> {
        let maneuver = preset(&format!("maneuvers/{name}.toml")).expect("embedded");
        let readings = preset("readings.toml").expect("embedded");
        let mut values = parse_table(readings.path, readings.text)?;
        merge(&mut values, parse_table(maneuver.path, maneuver.text)?);
        let grids = match values.remove("grids") {
            Some(Value::Table(grids)) => grids,
            _ => Table::new(),
        };
        // Of the vehicle that the manoeuvre names, not of another one that the user takes.
        let of_vehicle = values.remove("vehicle");
        let base = format!("config/{}", maneuver.path);
        let mut layers = Self {
            values,
            origins: BTreeMap::new(),
            base,
            grids,
            borrowed: None,
            notes: Vec::new(),
        };
        for part in Part::ALL {
            let name = layers.text(part.selected_by()).unwrap_or_default();
            layers.load(part, &name, "config")?;
            if let (Part::Vehicle, Some(Value::Table(above)), Some(Value::Table(below))) =
                (part, &of_vehicle, layers.values.get_mut("vehicle"))
            {
                merge(below, above.clone());
            }
        }
        Ok(layers)
    }

    /// Puts a user's document on top. `origin` names it in errors; usually it is its path.
    ///
    /// # Errors
    /// At the first key that no preset has, value of another type, or syntax error; the error has its line.
    pub fn add_document(&mut self, origin: &str, text: &str) -> Result<(), ConfigError> {
        let document = toml_edit::Document::parse(text)
            .map_err(|error| no_toml(origin, text, error.span(), error.message()))?;
        let mut values = parse_table(origin, text)?;
        // The own file of a vehicle or a law has none of these keys, and must not name another file.
        for part in Part::ALL {
            let named = find(&values, part.selected_by());
            // A resolved configuration contains the law itself, whichever file it came from.
            let named = named
                .and(if part == Part::Law { find(&values, "law.name") } else { None })
                .or(named);
            if let Some(Value::String(name)) = named
                && self.text(part.selected_by()).is_some()
            {
                let place = key_place(&document, part.selected_by()).unwrap_or_default();
                self.load(part, &name.clone(), &format!("{origin}:{}", line_of(text, place)))?;
            }
        }
        let mut leaves = Vec::new();
        let place = |span: Option<std::ops::Range<usize>>| {
            format!("{origin}:{}", span.map_or(1, |span| line_of(text, span.start)))
        };
        let mut table = document.as_table().clone();
        // The objective may be given by its name alone, as in objective = "path".
        if let Some(Value::String(name)) = values.get("objective").cloned() {
            let span = key_place(&document, "objective").map(|start| start..start);
            self.select(Part::Objective, &place(span), &name)?;
            table.remove("objective");
        }
        // A manoeuvre's file may hold grids of several laws; the present law's counts.
        if let (Some(Value::Table(grids)), true) =
            (values.get("grids").cloned(), self.values.contains_key("law"))
        {
            merge(&mut self.grids, grids);
            self.load_grid();
            table.remove("grids");
        }
        walk(&table, &self.values, &self.values, "", &mut leaves, &place)?;
        for (key, origin) in leaves {
            let value = take(&mut values, &key).expect("the same document, parsed twice");
            if tuned::is_map(&self.values, &key) {
                let item = key.split('.').try_fold(document.as_item(), |item, name| item.get(name));
                self.origins.insert(key.clone(), origin);
                tuned::note_places(item.expect("walked"), &key, &place, &mut self.origins);
                tuned::lay_on(&mut self.values, &key, value);
                continue;
            }
            self.replace(&key, value, origin)?;
        }
        Ok(())
    }

    /// Sets one key from `KEY=VALUE`, the value in TOML's notation (a bare word is a string).
    ///
    /// # Errors
    /// If there is no `=`, no such key, or the value is of another type.
    pub fn set(&mut self, assignment: &str) -> Result<(), ConfigError> {
        let origin = format!("--set {assignment}");
        let Some((key, text)) = assignment.split_once('=') else {
            return Err(ConfigError::new(origin, "", "has no '='; write --set key=value"));
        };
        let (key, text) = (key.trim(), text.trim());
        let value = match parse_table(&origin, &format!("value = {text}")) {
            Ok(mut table) if table.len() == 1 => table.remove("value").expect("just written"),
            // A bare word or a path needs no quotes; everything else is TOML.
            Err(error) if text.contains(['[', ']', '{', '}', '"', '\'', '=']) => {
                return Err(ConfigError::new(origin, key, error.problem));
            }
            _ => Value::String(text.to_owned()),
        };
        // The objective may be given by its name alone, as in objective=path.
        let key = if key == "objective" && value.is_str() { "objective.name" } else { key };
        if let (Some(part), Value::String(name)) =
            (Part::ALL.into_iter().find(|it| it.selected_by() == key), &value)
        {
            self.load(part, name, &origin)?;
        }
        if let Value::Table(_) = value {
            let table = format!("{key} = {text}");
            return self.add_document(&origin, &table);
        }
        self.replace(key, value, origin)
    }

    /// Sets one key on behalf of a command line option named `origin`.
    ///
    /// # Errors
    /// As [`Layers::set`].
    pub fn put(
        &mut self,
        origin: &str,
        key: &str,
        value: impl Into<Value>,
    ) -> Result<(), ConfigError> {
        self.replace(key, value.into(), origin.to_owned())
    }

    /// Takes the vehicle from a preset or a file, on behalf of a command line option named `origin`.
    ///
    /// # Errors
    /// If it is neither, or the file has a key that a vehicle does not have.
    pub fn set_vehicle(&mut self, origin: &str, name: &str) -> Result<(), ConfigError> {
        self.select(Part::Vehicle, origin, name)
    }

    /// Takes the control law from a preset or a file, on behalf of a command line option named `origin`. The grid is then
    /// that law's.
    ///
    /// # Errors
    /// If it is neither, or the file has a key that a law does not have.
    pub fn set_law(&mut self, origin: &str, name: &str) -> Result<(), ConfigError> {
        self.select(Part::Law, origin, name)
    }

    /// Takes the tuner from a preset, on behalf of a command line option named `origin`.
    ///
    /// # Errors
    /// If there is none with this name.
    pub fn set_tuner(&mut self, origin: &str, name: &str) -> Result<(), ConfigError> {
        self.select(Part::Tuner, origin, name)
    }

    /// Takes the objective from a preset, on behalf of a command line option named `origin`.
    ///
    /// # Errors
    /// If there is none with this name.
    pub fn set_objective(&mut self, origin: &str, name: &str) -> Result<(), ConfigError> {
        self.select(Part::Objective, origin, name)
    }

    fn select(&mut self, part: Part, origin: &str, name: &str) -> Result<(), ConfigError> {
        self.load(part, name, origin)?;
        self.put(origin, part.selected_by(), name)
    }

    /// Parses the stack into a valid configuration.
    ///
    /// # Errors
    /// At the first value that is out of range or does not fit the others.
    pub fn resolve(self) -> Result<RunConfig, ConfigError> {
        let Self { mut values, mut origins, base, borrowed, .. } = self;
        let keys_borrowed = borrowed.as_ref().map(|it| it.keys.clone());
        take_stated_noise(&mut values, &mut origins);
        drop_intervals_of_other_values(&mut values, &origins);
        take_limits_of_vehicle(&mut values);
        take_rate_of_vehicle(&mut values, &origins);
        let origin_of = |key: &str| {
            // The origin of the key itself, or of a part of it, or of a key that contains it.
            if key.starts_with("vehicle.gains") {
                // Files of earlier versions have the parameters without a separate table.
                let flat = key.replace(".parameters.", ".");
                if let Some(origin) = origins.get(key).or_else(|| origins.get(&flat)) {
                    return origin.clone();
                }
            }
            let below = format!("{key}.");
            if let Some((_, origin)) = origins.iter().find(|(set, _)| set.starts_with(&below)) {
                return origin.clone();
            }
            let mut key = key;
            loop {
                if let Some(origin) = origins.get(key) {
                    return origin.clone();
                }
                match key.rfind(['.', '[']) {
                    Some(end) => key = &key[..end],
                    None => return base.clone(),
                }
            }
        };
        crate::car_size::scale_to_the_car(&mut values, &origins);
        let mut config: RunConfig = serde_path_to_error::deserialize(Value::Table(values))
            .map_err(|error| {
                let key = error.path().to_string();
                ConfigError::new(origin_of(&key), key, error.inner().message().to_owned())
            })?;
        validate::validate(&config).map_err(|(key, problem)| {
            let is_set = origins.contains_key(&key);
            // A turn that is too tight is so by the vehicle's limit, whoever set the path.
            const LIMIT: &str = "vehicle.steering_limit_rad";
            let blamed =
                if problem.contains(LIMIT) { Some(LIMIT) } else { (!is_set).then_some(&*key) };
            let whose = borrowed.and_then(|it| it.whose(blamed?));
            ConfigError::new(origin_of(&key), key, problem + &whose.unwrap_or_default())
        })?;
        if let Some(borrowed) = keys_borrowed {
            config.vehicle.borrowed = borrowed;
        }
        Ok(config)
    }

    /// The vehicle that results from a file on top of the default vehicle.
    ///
    /// # Errors
    /// As [`Layers::set_vehicle`] and [`Layers::resolve`].
    pub fn vehicle_of_file(file: &str) -> Result<Vehicle, ConfigError> {
        Ok(Self::of_vehicle(file, file)?.resolve()?.vehicle)
    }

    /// The same of the text that a file is to have.
    ///
    /// # Errors
    /// As [`Layers::vehicle_of_file`].
    pub fn vehicle_of_text(file: &str, text: &str) -> Result<Vehicle, ConfigError> {
        let mut layers = Self::maneuver("lane_change")?;
        layers.put(file, "reference.speed_mps", SLOW_MPS)?;
        layers.stack_vehicle(file, text)?;
        fit_lengths(&mut layers.values);
        layers.put(file, Part::Vehicle.selected_by(), file)?;
        Ok(layers.resolve()?.vehicle)
    }

    /// The layers of a vehicle that is to drive nothing yet: of a manoeuvre so slow that every vehicle can drive it.
    ///
    /// # Errors
    /// As [`Layers::set_vehicle`].
    pub fn of_vehicle(origin: &str, vehicle: &str) -> Result<Self, ConfigError> {
        let mut layers = Self::maneuver("lane_change")?;
        layers.put(origin, "reference.speed_mps", SLOW_MPS)?;
        layers.set_vehicle(origin, vehicle)?;
        Ok(layers)
    }

    /// What the user has to know of values that the vehicle's file does not name and has from another car.
    pub fn borrowed(&self) -> Option<String> {
        self.borrowed.as_ref().map(vehicles::Borrowed::told)
    }

    /// How the path's file was read, a line each: what the user may not expect.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Adds what the user has to know of the path's file.
    pub(crate) fn note(&mut self, notes: impl IntoIterator<Item = String>) {
        self.notes.extend(notes);
    }

    /// Whether the user has set a key, by an option or in a file.
    pub fn is_set(&self, key: &str) -> bool {
        self.origins.contains_key(key)
    }

    /// The vehicle of the layers so far, if its keys are those of one.
    pub(crate) fn vehicle_so_far(&self) -> Option<Vehicle> {
        self.values.get("vehicle")?.clone().try_into().ok()
    }

    /// The value of a key, if it is a number.
    pub(crate) fn number(&self, key: &str) -> Option<f64> {
        let (head, rest) = key.split_once('.')?;
        match self.values.get(head)?.get(rest)? {
            Value::Float(number) => Some(*number),
            Value::Integer(number) => Some(*number as f64),
            _ => None,
        }
    }

    /// Notes where a part of a value, such as `path.points[3]`, was set.
    pub(crate) fn note_origin(&mut self, part: String, origin: String) {
        self.origins.insert(part, origin);
    }

    /// The value of a key, if it is a text.
    pub fn text(&self, key: &str) -> Option<String> {
        find(&self.values, key)?.as_str().map(str::to_owned)
    }

    /// Loads the part with this name: a preset, or for vehicles and laws a file.
    fn load(&mut self, part: Part, name: &str, origin: &str) -> Result<(), ConfigError> {
        match part {
            Part::Vehicle => {
                self.load_vehicle(name, origin)?;
                fit_lengths(&mut self.values);
                Ok(())
            }
            Part::Law => {
                self.load_law(name, origin)?;
                fit_lengths(&mut self.values);
                Ok(())
            }
            Part::Tuner | Part::Objective => {
                let (folder, below) = part.place();
                let Some(preset) = preset(&format!("{folder}/{name}.toml")) else {
                    let known: Vec<&str> = names_in(folder).collect();
                    let problem = format!("is {name:?}, which is unknown; {}", hint(name, &known));
                    return Err(ConfigError::new(origin, part.selected_by(), problem));
                };
                let mut values = parse_table(preset.path, preset.text)?;
                // Settings of another tuner or objective have no meaning for this one.
                values.entry("settings").or_insert_with(|| Value::Table(Table::new()));
                if part == Part::Tuner {
                    values.entry("ranges").or_insert_with(|| Value::Table(Table::new()));
                }
                let table = self.values.entry(below).or_insert_with(|| Value::Table(Table::new()));
                if let Value::Table(table) = table {
                    table.extend(values);
                }
                self.forget_origins(&format!("{below}.settings"));
                Ok(())
            }
        }
    }

    fn load_vehicle(&mut self, name: &str, origin: &str) -> Result<(), ConfigError> {
        self.borrowed = None;
        if names_in("vehicles").any(|known| known == name) {
            let vehicle = vehicles::of_preset(name)?;
            self.values.insert("vehicle".to_owned(), Value::Table(vehicle));
            self.forget_origins("vehicle");
            return Ok(());
        }
        let text = read_part(Part::Vehicle, name, origin)?;
        self.stack_vehicle(name, &text)
    }

    /// Puts the text of a vehicle's file on top of the preset that it names.
    fn stack_vehicle(&mut self, name: &str, text: &str) -> Result<(), ConfigError> {
        self.borrowed = None;
        let file = parse_table(name, text)?;
        let named = vehicles::base_of(name, &file)?;
        let base = named.and_then(|(_, preset)| preset.as_str());
        let mut vehicle =
            vehicles::of_preset(base.unwrap_or(vehicles::DEFAULT)).map_err(|error| {
                let key = named.map_or(vehicles::BASE, |(key, _)| key);
                ConfigError::new(name, key, error.problem)
            })?;
        // Known as keys, but they have done their work.
        for key in [vehicles::BASE, vehicles::EARLIER_BASE] {
            vehicle.insert(key.to_owned(), Value::String(vehicles::DEFAULT.to_owned()));
        }
        self.load_file(Part::Vehicle, vehicle, name, text)?;
        if let Some(Value::Table(vehicle)) = self.values.get_mut("vehicle") {
            vehicle.remove(vehicles::BASE);
            vehicle.remove(vehicles::EARLIER_BASE);
        }
        self.note(vehicles::doubts(name, &file));
        let left_out = vehicles::left_out(&file);
        if base.is_none() && !left_out.is_empty() {
            self.borrowed = Some(vehicles::Borrowed { file: name.to_owned(), keys: left_out });
        }
        Ok(())
    }

    fn load_law(&mut self, name: &str, origin: &str) -> Result<(), ConfigError> {
        let embedded = |name: &str| preset(&format!("laws/{name}.toml"));
        if let Some(preset) = embedded(name) {
            let mut law = parse_table(preset.path, preset.text)?;
            law.entry("settings").or_insert_with(|| Value::Table(Table::new()));
            self.values.insert("law".to_owned(), Value::Table(law));
        } else {
            let text = read_part(Part::Law, name, origin)?;
            let file = parse_table(name, &text)?;
            let Some(code) = file.get("name").and_then(Value::as_str) else {
                let problem = "is missing; name the law whose code it is, as in name = \"stanley\"";
                return Err(ConfigError::new(name, "name", problem));
            };
            let Some(preset) = embedded(code) else {
                let known: Vec<&str> = names_in("laws").collect();
                let problem = format!("is {code:?}, which is unknown; {}", hint(code, &known));
                return Err(ConfigError::new(name, "name", problem));
            };
            let mut law = parse_table(preset.path, preset.text)?;
            law.entry("settings").or_insert_with(|| Value::Table(Table::new()));
            self.load_file(Part::Law, law, name, &text)?;
        }
        self.load_grid();
        Ok(())
    }

    /// Loads the grid of the law: the manoeuvre's axes if it has any for this law, otherwise each parameter's own axis.
    fn load_grid(&mut self) {
        let law = &self.values["law"];
        let parameters = law.get("parameters").and_then(Value::as_array).into_iter().flatten();
        let mut grid = Table::new();
        for parameter in parameters {
            if let (Some(key), Some(axis)) =
                (parameter.get("key").and_then(Value::as_str), parameter.get("grid"))
            {
                grid.insert(key.to_owned(), axis.clone());
            }
        }
        let name = law.get("name").and_then(Value::as_str).unwrap_or_default();
        if let Some(Value::Table(of_maneuver)) = self.grids.get(name) {
            merge(&mut grid, of_maneuver.clone());
        }
        self.values.insert("grid".to_owned(), Value::Table(grid));
        self.forget_origins("grid");
    }

    /// Puts a user's file for a part on top of the preset below it.
    fn load_file(
        &mut self,
        part: Part,
        preset: Table,
        name: &str,
        text: &str,
    ) -> Result<(), ConfigError> {
        let (_, key) = part.place();
        // The file's keys are put below the part's key, so that they are checked like those of any other layer.
        let mut below = Self {
            values: preset,
            origins: BTreeMap::new(),
            base: name.to_owned(),
            grids: Table::new(),
            borrowed: None,
            notes: Vec::new(),
        };
        below.add_document(name, text)?;
        self.values.insert(key.to_owned(), Value::Table(below.values));
        self.forget_origins(key);
        for (below, origin) in below.origins {
            self.origins.insert(format!("{key}.{below}"), origin);
        }
        // Of the keys that the file leaves out, too.
        self.origins.insert(key.to_owned(), name.to_owned());
        Ok(())
    }

    /// Forgets where the values at and below a key were set, because they are gone.
    fn forget_origins(&mut self, key: &str) {
        let below = format!("{key}.");
        self.origins.retain(|set, _| set != key && !set.starts_with(&below));
    }

    fn replace(&mut self, key: &str, value: Value, origin: String) -> Result<(), ConfigError> {
        let slot = find_mut(&mut self.values, key);
        let Some(slot) = slot else {
            return Err(unknown_key(&self.values, key, origin));
        };
        check_kind(slot, &value, key, &origin)?;
        if key == "maneuver" && *slot != value {
            let problem = format!("is {slot}, as named on the command line, and cannot be changed");
            return Err(ConfigError::new(origin, key, problem));
        }
        *slot = value;
        // The parts of the old value are gone, so forget where they were set.
        let part = format!("{key}[");
        self.origins.retain(|set, _| !set.starts_with(&part));
        self.origins.insert(key.to_owned(), origin);
        Ok(())
    }
}

/// The limits of what commands a vehicle: none is above the vehicle's own. A value that is out of its range stays, so that
/// it is refused.
fn take_limits_of_vehicle(values: &mut Table) {
    for (key, of_vehicle) in [
        ("controller.steering_limit_rad", "vehicle.steering_limit_rad"),
        ("supervisor.speed_limit_mps", "vehicle.speed_limit_mps"),
    ] {
        let highest = if key.ends_with("_rad") { 1.5 } else { 100.0 };
        let limit = find(values, of_vehicle).and_then(number);
        let (Some(limit), Some(place)) = (limit, find_mut(values, key)) else { continue };
        let is_beyond = number(place).is_some_and(|own| own > limit && own <= highest);
        if place.as_str() == Some(Limit::AUTO) || is_beyond {
            *place = Value::Float(limit);
        }
    }
}

/// Intervals that the vehicle's file states are around its values. Where another layer has put a value in the place of one,
/// the interval that does not hold it says nothing of it.
fn drop_intervals_of_other_values(values: &mut Table, origins: &BTreeMap<String, String>) {
    let Some(stated) = find(values, "vehicle.uncertainty").and_then(Value::as_table) else {
        return;
    };
    // A line's number stands behind the file's name.
    let layer = |key: &str| origins.get(key).map(|it| it.rsplit_once(':').map_or(&**it, |it| it.0));
    let is_of_another = |(name, spread): &(&String, &Value)| {
        let Some([low, high]) = spread.as_array().map(Vec::as_slice) else { return false };
        let (of_value, of_interval) =
            (format!("vehicle.{name}"), format!("vehicle.uncertainty.{name}"));
        let value = find(values, &of_value).and_then(number);
        let is_within = match (number(low), number(high), value) {
            (Some(low), Some(high), Some(value)) => (low..=high).contains(&value),
            _ => true,
        };
        !is_within && layer(&of_value).is_some() && layer(&of_value) != layer(&of_interval)
    };
    let others: Vec<String> =
        stated.iter().filter(is_of_another).map(|(name, _)| name.clone()).collect();
    if let Some(stated) = find_mut(values, "vehicle.uncertainty").and_then(Value::as_table_mut) {
        others.iter().for_each(|name| drop(stated.remove(name)));
    }
}

/// A steering rate that the user gives his vehicle bounds the gate's, where he sets none there: a command that the wheels
/// cannot follow is none that the gate should let through.
fn take_rate_of_vehicle(values: &mut Table, origins: &BTreeMap<String, String>) {
    const OF_VEHICLE: &str = "vehicle.steering_rate_radps";
    const OF_GATE: &str = "vehicle.safety.steering_rate_limit_radps";
    if !origins.contains_key(OF_VEHICLE) || origins.contains_key(OF_GATE) {
        return;
    }
    // The excitation is to show how fast the wheels turn, whatever the file says.
    if find(values, "law.name").and_then(Value::as_str) == Some("excitation") {
        return;
    }
    let Some(rate) = find(values, OF_VEHICLE).and_then(number) else { return };
    if let Some(place) = find_mut(values, OF_GATE)
        && number(place).is_some_and(|own| own.is_finite() && own > rate)
    {
        *place = Value::Float(rate);
    }
}

/// A number, whether it is written with a decimal point or not.
pub(crate) fn number(value: &Value) -> Option<f64> {
    value.as_float().or(value.as_integer().map(|whole| whole as f64))
}

/// Puts the noise that the vehicle's file states into a drive's, where the user has not set another.
fn take_stated_noise(values: &mut Table, origins: &mut BTreeMap<String, String>) {
    for key in ["position_sd_m", "heading_half_width_rad"] {
        let of_run = format!("noise.{key}");
        let of_vehicle = format!("vehicle.{of_run}");
        let Some(stated) = find(values, &of_vehicle).cloned() else { continue };
        if let Some(place) = find_mut(values, &of_run).filter(|_| !origins.contains_key(&of_run)) {
            *place = stated;
            if let Some(origin) = origins.get(&of_vehicle).cloned() {
                origins.insert(of_run, origin);
            }
        }
    }
}

pub(crate) fn parse_table(origin: &str, text: &str) -> Result<Table, ConfigError> {
    text.parse::<Table>()
        .map_err(|error: toml::de::Error| no_toml(origin, text, error.span(), error.message()))
}

/// What is said of a text that cannot be read as TOML, at the place where that shows.
fn no_toml(
    origin: &str,
    text: &str,
    span: Option<std::ops::Range<usize>>,
    message: &str,
) -> ConfigError {
    let line = span.map_or(1, |span| line_of(text, span.start));
    let value = text.lines().nth(line - 1).and_then(|it| it.split_once('='));
    let value = value.map_or("", |(_, value)| value.trim());
    let hint = match value.chars().next() {
        _ if !text.contains('=') => "; a TOML file is wanted here, of lines key = value",
        Some('.') => "; a number begins with a digit, as in 0.5",
        Some(first) if first.is_ascii_digit() && value.contains(',') => {
            "; a number has a point, as in 0.5"
        }
        Some(first) if first.is_alphabetic() => "; a text stands in quotes, as in \"f1tenth\"",
        _ => "",
    };
    ConfigError::new(format!("{origin}:{line}"), "", format!("{message}{hint}"))
}

fn read_part(part: Part, name: &str, origin: &str) -> Result<String, ConfigError> {
    crate::files::read_small(Path::new(name)).map_err(|error| {
        let (folder, what) = part.place();
        let known: Vec<&str> = names_in(folder).collect();
        let known = known.join(", ");
        let advice = match nearest(name, names_in(folder)) {
            Some(near) => format!("did you mean {near}? Presets are {known}"),
            None => format!("presets are {known}"),
        };
        let problem = format!("{name:?} is neither a {what} preset nor a file: {error}; {advice}");
        ConfigError::new(origin, part.selected_by(), problem)
    })
}

/// The place of a dotted key in a document, in bytes.
fn key_place(document: &toml_edit::Document<impl AsRef<str>>, key: &str) -> Option<usize> {
    let mut table: &dyn TableLike = document.as_table();
    let mut names = key.split('.').peekable();
    while let Some(name) = names.next() {
        if names.peek().is_none() {
            return table.key(name).and_then(toml_edit::Key::span).map(|span| span.start);
        }
        table = table.get(name)?.as_table_like()?;
    }
    None
}

pub(crate) fn line_of(text: &str, offset: usize) -> usize {
    text.as_bytes()[..offset.min(text.len())].iter().filter(|byte| **byte == b'\n').count() + 1
}

pub(crate) fn merge(below: &mut Table, above: Table) {
    for (key, value) in above {
        match (below.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => merge(below, above),
            (_, value) => {
                below.insert(key, value);
            }
        }
    }
}

/// Collects the leaves of a user's table with their origins, and checks that `known` has each of them, too.
fn walk(
    table: &dyn TableLike,
    root: &Table,
    known: &Table,
    above: &str,
    leaves: &mut Vec<(String, String)>,
    origin: &dyn Fn(Option<std::ops::Range<usize>>) -> String,
) -> Result<(), ConfigError> {
    for (name, item) in table.iter() {
        let key = if above.is_empty() { name.to_owned() } else { format!("{above}.{name}") };
        let place = origin(table.key(name).and_then(toml_edit::Key::span).or_else(|| item.span()));
        if tuned::is_map(root, &key) {
            leaves.push((key, place));
            continue;
        }
        match (known.get(name), item.as_table_like()) {
            (Some(Value::Table(below)), Some(table)) => {
                walk(table, root, below, &key, leaves, origin)?
            }
            (Some(_), _) => leaves.push((key, place)),
            (None, _) => return Err(unknown_key(root, &key, place)),
        }
    }
    Ok(())
}

pub(crate) fn find<'a>(table: &'a Table, key: &str) -> Option<&'a Value> {
    match key.split_once('.') {
        None => table.get(key),
        Some((head, rest)) => find(table.get(head)?.as_table()?, rest),
    }
}

pub(crate) fn find_mut<'a>(table: &'a mut Table, key: &str) -> Option<&'a mut Value> {
    match key.split_once('.') {
        None => table.get_mut(key),
        Some((head, rest)) => find_mut(table.get_mut(head)?.as_table_mut()?, rest),
    }
}

fn take(table: &mut Table, key: &str) -> Option<Value> {
    match key.split_once('.') {
        None => table.remove(key),
        Some((head, rest)) => take(table.get_mut(head)?.as_table_mut()?, rest),
    }
}

/// Collects every dotted key of a table that is a leaf.
pub(crate) fn keys(table: &Table, above: &str, all: &mut Vec<String>) {
    for (name, value) in table {
        let key = if above.is_empty() { name.clone() } else { format!("{above}.{name}") };
        match value {
            Value::Table(table) => keys(table, &key, all),
            _ => all.push(key),
        }
    }
}

fn unknown_key(known: &Table, key: &str, origin: String) -> ConfigError {
    let mut all = Vec::new();
    keys(known, "", &mut all);
    let word = key.rsplit('.').next().unwrap_or(key);
    let mut namesakes = all.iter().filter(|known| known.rsplit('.').next() == Some(word));
    let near = namesakes.next().map(String::as_str);
    let near = near.or_else(|| nearest(key, all.iter().map(String::as_str)));
    let hint = match near {
        Some(near) => format!("did you mean {near}?"),
        None if ["vehicle", "law"].contains(&key) => {
            "the keys of such a file stand without a heading".to_owned()
        }
        None => "`pathtune config show` lists them all".to_owned(),
    };
    ConfigError::new(origin, key, format!("unknown key; {hint}"))
}

fn check_kind(old: &Value, new: &Value, key: &str, origin: &str) -> Result<(), ConfigError> {
    let fits = match (old, new) {
        (Value::Float(_), Value::Integer(_)) => true,
        // A limit that is a number, or derived from other keys.
        (Value::String(auto), Value::Float(_) | Value::Integer(_)) => auto == Limit::AUTO,
        (Value::Float(_), Value::String(auto)) => auto == Limit::AUTO,
        _ => old.type_str() == new.type_str(),
    };
    if fits {
        return Ok(());
    }
    let problem = format!("must be {}, but is {}", with_article(old), with_article(new));
    Err(ConfigError::new(origin, key, problem))
}

fn with_article(value: &Value) -> String {
    let kind = value.type_str();
    let article = if kind.starts_with(['a', 'e', 'i', 'o', 'u']) { "an" } else { "a" };
    format!("{article} {kind}")
}

#[cfg(test)]
mod tests;
