//! Reads the rows of a table: which columns count, and their numbers.

use super::header::{
    Role, Unit, is_named, is_only_unit, is_speed_in_si, meaning, sounds_like_speed, unit_told,
};
use super::lines::{self, Delimiter, Line};
use super::options::{Columns, Place};
use super::{PathOptions, Raw, headless, mistake, quoted};
use crate::ConfigError;

/// The largest coordinate: any grid of the Earth has smaller ones.
const FARTHEST_M: f64 = 1e9;
/// The highest speed, as that of `reference.speed_mps`.
const FASTEST_MPS: f64 = 50.0;
/// The noise of a speed that is measured where a recorded car stands.
const STANDING_MPS: f64 = 0.05;
/// Lines above the header that are skipped.
const MOST_PREAMBLE: usize = 20;
/// The widest road.
const WIDEST_M: f64 = 1000.0;

/// How a header or a comment says that coordinates are web-Mercator; "Mercator" alone is UTM's, too.
const WEB_MERCATOR: [&str; 6] = [
    "web-mercator",
    "web mercator",
    "pseudo-mercator",
    "pseudo mercator",
    "epsg:3857",
    "epsg:900913",
];

/// One column that is read.
#[derive(Debug, Clone)]
struct Used {
    role: Role,
    unit: Unit,
    index: usize,
    name: String,
}

/// The columns of TUM's tools that lead from a track's reference line to the raceline: by `alpha` along the normal, which points
/// to the right.
#[derive(Debug)]
struct Beside {
    alpha: Used,
    normal: [Used; 2],
}

/// Where the columns are, and how many a row has.
#[derive(Debug)]
struct Plan {
    used: Vec<Used>,
    /// How far the line lies beside the coordinates that are read, if it does.
    beside: Option<Beside>,
    /// The names of all columns; empty without a header.
    names: Vec<String>,
    notes: Vec<String>,
}

/// Reads a table.
pub(super) fn read(origin: &str, text: &str, options: &PathOptions) -> Result<Raw, ConfigError> {
    let (body, comments) = lines::split(text);
    let Some(&first) = body.first() else {
        let named = comments.iter().find(|(_, comment)| names_a_path(comment));
        let (line, problem) = match named {
            Some((line, _)) => (*line, "no points follow; write one per line"),
            None => {
                (1, "holds only comments; write a header x_m,y_m[,v_mps], and one point per line")
            }
        };
        return Err(mistake(origin, line, problem));
    };
    let above = body.iter().take(MOST_PREAMBLE).take_while(|(_, line)| !is_numbers(line)).count();
    // A header without the comment sign takes precedence over one in a comment.
    let mut header: Option<(Line<'_>, usize)> =
        (0..above).find(|index| names_a_path(body[*index].1)).map(|index| (body[index], index + 1));
    if header.is_none() {
        let row = body.get(above).unwrap_or(&first).1;
        let in_comment = header_among(&comments, row);
        header = in_comment.map(|line| (line, above.min(usize::from(options.columns.is_some()))));
    }
    if header.is_none() && options.columns.is_some() && above > 0 {
        // Its columns may still be named.
        header = Some((body[above - 1], above));
    }
    if header.is_none() && above > 0 {
        return Err(mistake(origin, first.0, no_header(first.1)));
    }
    let data = &body[header.map_or(0, |(_, count)| count)..];
    let header = header.map(|(line, _)| line);
    let Some(&(_, sample)) = data.first() else {
        let line = header.map_or(first.0, |(line, _)| line);
        return Err(mistake(origin, line, "no points follow; write one per line"));
    };
    let (of_names, delimiter) = Delimiter::of_table(header.map(|(_, names)| names), sample);
    let table = Table { origin, header, data, of_names, delimiter, comma: false };
    if header.is_some() && delimiter.fields(sample).into_iter().all(is_only_unit) {
        let problem = "holds the units of the names above; write them into those, as x [m] or v_kmh, and leave this line out";
        return Err(mistake(origin, data[0].0, problem));
    }
    let table = Table { comma: table.has_decimal_commas(), ..table };
    let plan = table.plan(options.columns.as_ref())?;
    let mut raw = table.rows(&plan)?;
    let says = |word: &str| {
        let in_comments = comments.iter().any(|(_, comment)| comment.to_lowercase().contains(word));
        in_comments || header.is_some_and(|(_, names)| names.to_lowercase().contains(word))
    };
    raw.is_mercator = WEB_MERCATOR.iter().any(|word| says(word));
    Ok(raw)
}

/// Whether a line's first field, and most of the others, are numbers.
fn is_numbers(line: &str) -> bool {
    let fields = Delimiter::of(line).fields(line);
    let numbers = fields.iter().filter(|field| lines::number(field, true).is_some()).count();
    2 * numbers >= fields.len() && numbers > 0
}

/// Whether a line is a header that names both coordinates.
fn names_a_path(line: &str) -> bool {
    let fields = Delimiter::of(line).fields(line);
    let has =
        |role: Role| fields.iter().any(|name| meaning(name).is_some_and(|(it, _)| it == role));
    (has(Role::X) && has(Role::Y)) || (has(Role::Lat) && has(Role::Lon))
}

/// The comment that is the header of the rows below. Comments may be prose, and of those that name coordinates the last with as
/// many words as the row has fields is it, or else one that can be nothing else, whose names then do not fit the rows.
fn header_among<'a>(comments: &[Line<'a>], row: &str) -> Option<Line<'a>> {
    let names = |comment: &'a str| {
        let (by, of_row) = Delimiter::of_table(Some(comment), row);
        let names = by.fields(comment);
        let fits = of_row.fields_of(row, names.len()).len() == names.len();
        let is_prose = by == Delimiter::Space && names.iter().any(|name| meaning(name).is_none());
        (fits, is_prose)
    };
    let mut named = comments.iter().rev().filter(|(_, comment)| names_a_path(comment));
    let fitting = named.clone().find(|(_, comment)| names(comment).0);
    fitting.or_else(|| named.find(|(_, comment)| !names(comment).1)).copied()
}

/// What is wrong with a first line that is neither a header nor numbers.
fn no_header(first: &str) -> String {
    let fields = Delimiter::of(first).fields(first);
    let has =
        |role: Role| fields.iter().any(|name| meaning(name).is_some_and(|(it, _)| it == role));
    let missing = match (has(Role::X), has(Role::Y)) {
        (true, _) => "no column y_m",
        (_, true) => "no column x_m",
        _ => "no columns x_m and y_m",
    };
    format!(
        "has {missing}; found {}; write a header x_m,y_m[,v_mps], or say which columns they are with --columns x=1,y=2",
        quoted(&fields.join(", "))
    )
}

/// The rows of a file, and how they are written.
#[derive(Debug)]
struct Table<'a> {
    origin: &'a str,
    header: Option<Line<'a>>,
    data: &'a [Line<'a>],
    /// What separates the header's names, and the rows' fields.
    of_names: Delimiter,
    delimiter: Delimiter,
    /// Whether decimals stand after a comma.
    comma: bool,
}

impl Table<'_> {
    /// Whether the numbers have decimal commas: a comma stands in some field that is a number with it, and no point does.
    fn has_decimal_commas(&self) -> bool {
        let is_decimal = |field: &&str| field.contains(',') && lines::number(field, true).is_some();
        let fields = |line: &'_ str| self.delimiter.fields(line).iter().any(is_decimal);
        self.data.iter().any(|(_, line)| fields(line))
            && !self.data.iter().any(|(_, line)| line.contains('.'))
    }

    fn fails(&self, line: usize, problem: impl Into<String>) -> ConfigError {
        mistake(self.origin, line, problem)
    }

    /// Which columns are read.
    fn plan(&self, columns: Option<&Columns>) -> Result<Plan, ConfigError> {
        let mut plan = match (columns, self.header) {
            (Some(columns), header) => self.of_user(columns, header)?,
            (None, Some(header)) => self.of_header(header)?,
            (None, None) => self.of_numbers()?,
        };
        if self.comma {
            plan.notes.push("decimals are taken to stand after a comma".to_owned());
        }
        Ok(plan)
    }

    fn names(&self, (_, header): Line<'_>) -> Vec<String> {
        self.of_names.fields(header).into_iter().map(str::to_owned).collect()
    }

    /// The columns that the user names.
    fn of_user(&self, columns: &Columns, header: Option<Line<'_>>) -> Result<Plan, ConfigError> {
        let names = header.map(|header| self.names(header)).unwrap_or_default();
        let (first, sample) = self.data[0];
        let as_named = self.delimiter.fields_of(sample, names.len()).len() == names.len();
        let count = if as_named { names.len() } else { self.delimiter.fields(sample).len() };
        let line = header.map_or(first, |(line, _)| line);
        let mut used = Vec::new();
        for column in &columns.0 {
            let index = match &column.place {
                Place::Index(index) if *index < count => *index,
                Place::Index(_) => {
                    let problem =
                        format!("--columns names column {}, but the row has {count}", column.place);
                    return Err(self.fails(first, problem));
                }
                Place::Name(name) if header.is_some() && !as_named => {
                    let problem = format!(
                        "has no certain column {name}, which --columns names: the header names {} ({}), the rows have {count}; give \
                         the columns by number",
                        names.len(),
                        quoted(&names.join(", "))
                    );
                    return Err(self.fails(line, problem));
                }
                Place::Name(name) => {
                    names.iter().position(|it| it.eq_ignore_ascii_case(name)).ok_or_else(|| {
                        let found = if names.is_empty() {
                            "there is no header".to_owned()
                        } else {
                            quoted(&names.join(", "))
                        };
                        self.fails(
                            line,
                            format!("has no column {name}, which --columns names; found {found}"),
                        )
                    })?
                }
            };
            let named = names.get(index).filter(|_| as_named);
            let name = named.cloned().unwrap_or_else(|| format!("column {}", index + 1));
            let unit = match (column.unit, named) {
                (Some(unit), _) => unit,
                (None, Some(name)) => unit_told(name, column.role)
                    .map_err(|unit| self.fails(line, unknown_unit(name, &unit)))?
                    .unwrap_or(column.role.unit()),
                (None, None) => column.role.unit(),
            };
            used.push(Used { role: column.role, unit, index, name });
        }
        let notes = vec![format!("read {}", all_told(&used))];
        // A header of another kind than the rows: names that count otherwise are none.
        let names = if as_named { names } else { Vec::new() };
        Ok(Plan { used, beside: None, names, notes })
    }

    /// The columns that the header names.
    fn of_header(&self, header: Line<'_>) -> Result<Plan, ConfigError> {
        let names = self.names(header);
        let (mut used, mut notes): (Vec<Used>, Vec<String>) = (Vec::new(), Vec::new());
        let of_ros = names.iter().any(|name| {
            let name = name.to_lowercase();
            matches!(name.as_str(), "qw" | "q_w" | "quat_w") || name.contains("orientation")
        });
        for role in [Role::X, Role::Y, Role::Lat, Role::Lon, Role::Speed, Role::Left, Role::Right] {
            let of_role: Vec<usize> = (0..names.len())
                .filter(|index| meaning(&names[*index]).is_some_and(|(it, _)| it == role))
                .collect();
            let Some(index) = self.chosen(header.0, &names, role, &of_role)? else { continue };
            let name = names[index].clone();
            let unit = match meaning(&name).map(|(_, unit)| unit) {
                Some(Err(unit)) => {
                    return Err(self.fails(header.0, unknown_unit(&name, &unit)));
                }
                Some(Ok(Some(unit))) => unit,
                _ if role == Role::Speed && !is_speed_in_si(&name) && !of_ros => {
                    let is_flat = used.iter().any(|it| it.role == Role::X);
                    let of_place = match is_flat {
                        true => [("x", Role::X), ("y", Role::Y)],
                        false => [("lat", Role::Lat), ("lon", Role::Lon)],
                    };
                    let places = of_place.map(|(word, of)| self.place(&used, word, of));
                    let problem = format!(
                        "names {name} without a unit (Autoware.AI writes km/h, others m/s); say it, as --columns \
                         {},v_mps={1} or v_kmh={1}, or leave the speed out",
                        places.join(","),
                        index + 1
                    );
                    return Err(self.fails(header.0, problem));
                }
                _ => role.unit(),
            };
            used.push(Used { role, unit, index, name });
        }
        let is_flat =
            used.iter().any(|it| it.role == Role::X) && used.iter().any(|it| it.role == Role::Y);
        used.retain(|it| {
            is_flat != matches!(it.role, Role::Lat | Role::Lon)
                || !matches!(it.role, Role::X | Role::Y | Role::Lat | Role::Lon)
        });
        let as_ever = |it: &Used| matches!(it.name.as_str(), "x_m" | "y_m" | "v_mps" | "vx_mps");
        let told = all_told(used.iter().filter(|it| !as_ever(it)));
        if !told.is_empty() {
            notes.push(format!("read {told}"));
        }
        let unread: Vec<&str> = (0..names.len())
            .filter(|index| used.iter().all(|it| it.index != *index))
            .map(|index| names[index].as_str())
            .filter(|name| sounds_like_speed(name))
            .collect();
        if !unread.is_empty() {
            notes.push(format!("not read: {}", unread.join(", ")));
        }
        let beside = beside(&names)
            .filter(|_| used.iter().any(|it| it.role == Role::X && is_named(&it.name, "x_ref")));
        if let Some(Beside { alpha, normal: [x, y] }) = &beside {
            notes.push(format!(
                "the line lies {} beside that reference line, to the right, along {}, {}, as TUM's tools write it",
                alpha.name, x.name, y.name
            ));
        }
        Ok(Plan { used, beside, names, notes })
    }

    /// Where a coordinate is, as --columns says it.
    fn place(&self, used: &[Used], word: &str, role: Role) -> String {
        match used.iter().find(|it| it.role == role) {
            Some(it) if it.unit == role.unit() => format!("{word}={}", it.index + 1),
            Some(it) => format!("{word}_{}={}", it.unit.name, it.index + 1),
            None => format!("{word}=1"),
        }
    }

    /// The one column among those that may hold this.
    fn chosen(
        &self,
        line: usize,
        names: &[String],
        role: Role,
        of_role: &[usize],
    ) -> Result<Option<usize>, ConfigError> {
        let (&[first, ..], exact) = (of_role, exact_names(role)) else { return Ok(None) };
        // x,y,z,x,y,z,w: position before orientation.
        let is_same = of_role.iter().all(|index| names[*index] == names[first]);
        if is_same && names.iter().any(|name| name.eq_ignore_ascii_case("w")) && role != Role::Speed
        {
            return Ok(Some(first));
        }
        for name in exact {
            let same: Vec<usize> =
                of_role.iter().copied().filter(|index| names[*index] == *name).collect();
            match same[..] {
                [] => {}
                [index] => return Ok(Some(index)),
                _ => {
                    return Err(
                        self.fails(line, format!("names column {name} twice; rename one of them"))
                    );
                }
            }
        }
        if of_role.len() == 1 {
            return Ok(Some(first));
        }
        let found: Vec<&str> = of_role.iter().map(|index| names[*index].as_str()).collect();
        let problem = if is_same {
            format!("names column {} twice; rename one of them", found[0])
        } else {
            format!(
                "has {} columns that may be meant: {}; say which, as --columns x=1,y=2,v=3",
                found.len(),
                found.join(", ")
            )
        };
        Err(self.fails(line, problem))
    }

    /// The columns of a table without a header, found by their numbers.
    fn of_numbers(&self) -> Result<Plan, ConfigError> {
        const ENOUGH: usize = 5000;
        let (line, first) = self.data[0];
        let count = self.delimiter.fields(first).len();
        let mut rows = Vec::new();
        for (line, content) in self.data.iter().take(ENOUGH) {
            let fields = self.delimiter.fields_of(content, count);
            if fields.len() != count {
                let problem = format!(
                    "has {} fields, but line {} has {count}; separate them by {}",
                    fields.len(),
                    self.data[0].0,
                    self.delimiter.name()
                );
                return Err(self.fails(*line, problem));
            }
            // What is no number is found when it is read, if it is.
            rows.push(
                fields
                    .iter()
                    .map(|field| lines::number(field, self.comma).unwrap_or(f64::NAN))
                    .collect(),
            );
        }
        let guess = headless::guess(&rows).map_err(|why| self.fails(line, why))?;
        let used = |role: Role, index: usize| Used {
            role,
            unit: role.unit(),
            index,
            name: format!("column {}", index + 1),
        };
        let mut columns = vec![used(Role::X, guess.x), used(Role::Y, guess.y)];
        columns.extend(guess.v.map(|index| used(Role::Speed, index)));
        Ok(Plan { used: columns, beside: None, names: Vec::new(), notes: vec![guess.words] })
    }

    /// Reads all rows.
    fn rows(&self, plan: &Plan) -> Result<Raw, ConfigError> {
        let find = |role: Role| plan.used.iter().find(|it| it.role == role);
        let is_degrees = find(Role::X).is_none();
        let pair = if is_degrees { (Role::Lat, Role::Lon) } else { (Role::X, Role::Y) };
        let (Some(a), Some(b)) = (find(pair.0), find(pair.1)) else {
            return Err(self.fails(self.data[0].0, "has no columns x_m and y_m"));
        };
        let speed = find(Role::Speed);
        let widths = find(Role::Left).zip(find(Role::Right));
        let mut raw = Raw { is_degrees, notes: plan.notes.clone(), ..Raw::default() };
        let count = if plan.names.is_empty() {
            self.delimiter.fields(self.data[0].1).len()
        } else {
            plan.names.len()
        };
        let header = self.header.map(|(_, header)| header);
        let (mut repeated, mut standing) = (0, 0);
        for (line, content) in self.data {
            if header == Some(*content) {
                repeated += 1;
                continue;
            }
            let fields = self.delimiter.fields_of(content, count);
            if fields.len() != count {
                return Err(self.fails(*line, self.uneven(plan, fields.len(), count)));
            }
            let number = |used: &Used, most: f64| self.number(*line, used, &fields, most);
            let mut point = [number(a, FARTHEST_M)?, number(b, FARTHEST_M)?];
            let mut alpha_m = 0.0;
            if let Some(Beside { alpha, normal: [x, y] }) = &plan.beside {
                alpha_m = number(alpha, WIDEST_M)?;
                point[0] += alpha_m * number(x, 1.01)?;
                point[1] += alpha_m * number(y, 1.01)?;
            }
            raw.points.push(point);
            if let Some(used) = speed {
                let speed_mps = self.speed(*line, used, &fields)?;
                standing += usize::from(speed_mps < 0.0);
                raw.speeds_mps.push(speed_mps.max(0.0));
            }
            if let Some((left, right)) = widths {
                let edges_m = [number(left, WIDEST_M)?.abs(), number(right, WIDEST_M)?.abs()];
                // The nearer the line is to one of them, the farther it is from the other.
                raw.widths_m
                    .push([(edges_m[0] + alpha_m).max(0.0), (edges_m[1] - alpha_m).max(0.0)]);
            }
            raw.lines.push(*line);
        }
        if repeated > 0 {
            raw.notes.push(format!("the header is repeated {repeated} times below; left out"));
        }
        if standing > 0 {
            let speeds = if standing == 1 { "speed" } else { "speeds" };
            let are = if standing == 1 { "is" } else { "are" };
            raw.notes.push(format!(
                "{standing} {speeds} between -{STANDING_MPS} and 0 m/s {are} taken as 0, a car at rest"
            ));
        }
        Ok(raw)
    }

    fn uneven(&self, plan: &Plan, held: usize, count: usize) -> String {
        let named = if plan.names.is_empty() {
            format!("line {} has {count}", self.data[0].0)
        } else {
            format!("the header names {count} ({})", quoted(&plan.names.join(", ")))
        };
        let way_out = if self.delimiter == Delimiter::Sign(',') && held == 2 * count {
            "if the decimals stand after a comma, separate the columns by ';'".to_owned()
        } else {
            format!("separate them by {}", self.delimiter.name())
        };
        format!("has {held} fields, but {named}; {way_out}")
    }

    /// A number of a row, in metres or metres per second.
    fn number(
        &self,
        line: usize,
        used: &Used,
        fields: &[&str],
        most: f64,
    ) -> Result<f64, ConfigError> {
        let (name, field) = (&used.name, fields[used.index]);
        let wrong = |problem: String| Err(self.fails(line, format!("{name} {problem}")));
        if field.is_empty() {
            return wrong("is empty; write a number".to_owned());
        }
        let Some(value) = lines::number(field, self.comma) else {
            let comma = field.replace(',', ".").parse::<f64>().is_ok();
            let hint = if comma { "write the decimals after a point" } else { "write a number" };
            return wrong(format!("is {}, which is not a number; {hint}", quoted(field)));
        };
        let value = value * used.unit.factor;
        if !(-most..=most).contains(&value) {
            return wrong(format!(
                "is {}, but must be a number in [{}, {most}]",
                quoted(field),
                -most
            ));
        }
        Ok(value)
    }

    /// The speed of a row. 0, or just below it, is where the car stands.
    fn speed(&self, line: usize, used: &Used, fields: &[&str]) -> Result<f64, ConfigError> {
        let speed_mps = self.number(line, used, fields, f64::INFINITY)?;
        if speed_mps > -STANDING_MPS && speed_mps <= FASTEST_MPS {
            return Ok(speed_mps);
        }
        let (name, field) = (&used.name, quoted(fields[used.index]));
        let why = if speed_mps < 0.0 {
            "the vehicle drives only forwards".to_owned()
        } else {
            format!(
                "it is taken as {}; if it is in km/h, --columns v_kmh={}",
                used.unit.name,
                used.index + 1
            )
        };
        Err(self.fails(
            line,
            format!("{name} is {field}, but must lie in [0, {FASTEST_MPS}] m/s; {why}"),
        ))
    }
}

/// The columns that lead from a reference line to the line, if there are such.
fn beside(names: &[String]) -> Option<Beside> {
    let used = |wanted: &str| {
        let index = names.iter().position(|name| is_named(name, wanted))?;
        Some(Used { role: Role::X, unit: Role::X.unit(), index, name: names[index].clone() })
    };
    Some(Beside { alpha: used("alpha")?, normal: [used("x_normvec")?, used("y_normvec")?] })
}

/// What the columns are read as.
fn all_told<'a>(used: impl IntoIterator<Item = &'a Used>) -> String {
    let told = used.into_iter().map(|Used { role, unit, name, .. }| match role {
        Role::X => format!("x_m from {name} in {}", unit.name),
        Role::Y => format!("y_m from {name} in {}", unit.name),
        Role::Lat => format!("latitude from {name}"),
        Role::Lon => format!("longitude from {name}"),
        Role::Speed => format!("v_mps from {name} in {}", unit.name),
        Role::Left => format!("the left edge from {name} in {}", unit.name),
        Role::Right => format!("the right edge from {name} in {}", unit.name),
    });
    told.collect::<Vec<_>>().join(", ")
}

/// What is wrong with a name that tells a unit which its column cannot have.
fn unknown_unit(name: &str, unit: &str) -> String {
    format!(
        "names {name}, in {unit}, which is not understood; say what it is in, as --columns x_m=1,y_m=2,v_kmh=3"
    )
}

/// Names that are chosen before all others with the same meaning, in this order.
fn exact_names(role: Role) -> &'static [&'static str] {
    match role {
        Role::X => &["x_m", "x"],
        Role::Y => &["y_m", "y"],
        Role::Speed => &["v_mps", "vx_mps"],
        Role::Lat => &["lat", "latitude"],
        Role::Lon => &["lon", "longitude"],
        _ => &[],
    }
}
