//! Which columns of a table without a header are the coordinates.

/// What a table of numbers without names was taken for.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Guess {
    pub(super) x: usize,
    pub(super) y: usize,
    pub(super) v: Option<usize>,
    /// What is told of it.
    pub(super) words: String,
}

/// What a user can do where nothing decides.
const ASK: &str = "say which columns are x and y, as --columns x=2,y=3 or x=1,y=2";

/// Finds the coordinates among the columns, all rows having the same number of them.
///
/// # Errors
/// With what the table looks like, if nothing decides.
pub(super) fn guess(rows: &[Vec<f64>]) -> Result<Guess, String> {
    let columns = rows[0].len();
    let taken = |x: usize, y: usize, v: Option<usize>, words: String| Ok(Guess { x, y, v, words });
    if columns < 2 {
        return Err("holds one column, but a path needs two, x and y; say how they are separated by a comma".to_owned());
    }
    if columns == 2 {
        return taken(0, 1, None, "no header: columns 1, 2 taken as x_m, y_m".to_owned());
    }
    if columns == 12 && is_rotation(rows) {
        return Err("looks like poses of KITTI, twelve numbers of a matrix a row; say which columns are the ground's, as \
                    --columns x=4,y=12"
            .to_owned());
    }
    // Behind a time, or behind the header of a message, which has two columns of it and names of frames.
    let is_pose = |first: &usize| is_place(rows, first - 1) && is_quaternion(rows, first + 2);
    if let Some(first) = (1..=columns.saturating_sub(6)).find(is_pose) {
        let time = match first {
            1 => "",
            2 | 3 => ", after a time",
            _ => ", after the header of a message",
        };
        let words = format!(
            "no header: a quaternion in columns {}…{}, so columns {first}, {} taken as x_m, y_m{time}",
            first + 3,
            first + 6,
            first + 1
        );
        return taken(first - 1, first, None, words);
    }
    if is_length_along(rows) {
        // The raceline of TUM's tools: s, x, y, psi, kappa, vx, ax.
        let v = (columns == 7).then_some(5);
        if v.is_none() && is_along_an_axis(rows) {
            return Err(format!(
                "has no header, and its first column may be x of a straight, or the length along it through columns 2, 3; {ASK}"
            ));
        }
        let speeds = if v.is_some() {
            ", column 6 as vx_mps"
        } else {
            "; no column read as a speed (--columns v=…)"
        };
        let words = format!(
            "no header: column 1 is the length along columns 2, 3, taken as x_m, y_m{speeds}"
        );
        return taken(1, 2, v, words);
    }
    let first: Vec<f64> = rows.iter().map(|row| row[0]).collect();
    let rises = rows.len() > 2 && first.windows(2).all(|pair| pair[1] > pair[0]);
    if rises && first[0] > 1e8 {
        return taken(
            1,
            2,
            None,
            "no header: column 1 taken as a time, columns 2, 3 as x_m, y_m".to_owned(),
        );
    }
    // A third column of words is no coordinate, and what comes before it is.
    let has_third = rows.iter().any(|row| !row[2].is_nan());
    let second: Vec<f64> = rows.iter().map(|row| row[1]).collect();
    // Of a straight along an axis, one of the coordinates does not vary.
    let may_be_time = || match varies(rows, 2) {
        true => is_even(&first) || (is_roughly_even(&first) && is_way(rows)),
        false => is_even(&first) && is_even(&second),
    };
    if rises && has_third && varies(rows, 1) && may_be_time() {
        let how = if is_even(&first) { "evenly" } else { "almost evenly" };
        return Err(format!(
            "has no header, and its first column rises {how}, as a time or a number of the row does; {ASK}"
        ));
    }
    let others =
        if columns == 3 { "column 3 is".to_owned() } else { format!("columns 3…{columns} are") };
    // Which of several it is, only the user knows.
    let which = if columns == 3 { "v=3" } else { "v=…" };
    let words = format!(
        "no header: columns 1, 2 taken as x_m, y_m; {others} not read (a speed in m/s: --columns x=1,y=2,{which})"
    );
    taken(0, 1, None, words)
}

/// Whether four columns from this one on (counted from 0) are the quaternion of a pose, in every row.
fn is_quaternion(rows: &[Vec<f64>], from: usize) -> bool {
    rows.iter().all(|row| {
        row.get(from..from + 4).is_some_and(|q| {
            let norm: f64 = q.iter().map(|it| it * it).sum();
            (norm - 1.0).abs() < 1e-2
        })
    }) && rows.len() > 1
}

/// Whether the first three columns of a 3 × 4 matrix have unit length.
fn is_rotation(rows: &[Vec<f64>]) -> bool {
    rows.iter().all(|row| {
        (0..3).all(|column| {
            let norm: f64 =
                (0..3).map(|line| row[4 * line + column] * row[4 * line + column]).sum();
            (norm - 1.0).abs() < 1e-2
        })
    })
}

/// Whether the first column is the length along the path through the next two.
fn is_length_along(rows: &[Vec<f64>]) -> bool {
    // A column that is no number is no length: NaN is not less.
    let is_step = |pair: &[Vec<f64>]| {
        let (last, next) = (&pair[0], &pair[1]);
        let chord = libm::hypot(next[1] - last[1], next[2] - last[2]);
        (next[0] - last[0] - chord).abs() / chord.max(1e-3) < 0.1
    };
    rows.len() > 2 && rows.windows(2).all(is_step)
}

/// Whether the path through columns 2 and 3, column 1 being its length, is a straight on which one of them grows as the length
/// does: then column 1 may as well be the x of a path through columns 1 and 2.
fn is_along_an_axis(rows: &[Vec<f64>]) -> bool {
    let (first, last) = (&rows[0], &rows[rows.len() - 1]);
    let [length, a, b] = [0, 1, 2].map(|column| (last[column] - first[column]).abs());
    libm::hypot(a, b) > 0.95 * length && a.min(b) < 0.5 * a.max(b)
}

fn is_even(values: &[f64]) -> bool {
    let step = values[1] - values[0];
    values.windows(2).all(|pair| ((pair[1] - pair[0]) / step - 1.0).abs() < 0.02)
}

/// Whether most steps are about the usual one, as those of a clock are that is late at times.
fn is_roughly_even(values: &[f64]) -> bool {
    let mut steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    let usual = steps[steps.len() / 2];
    let near = steps.iter().filter(|step| (*step / usual - 1.0).abs() < 0.5).count();
    5 * near >= 4 * steps.len()
}

/// Whether columns 2 and 3 come along as a vehicle does, column 1 being the time: at a walking pace at least.
fn is_way(rows: &[Vec<f64>]) -> bool {
    let speed = |pair: &[Vec<f64>]| {
        let (last, next) = (&pair[0], &pair[1]);
        libm::hypot(next[1] - last[1], next[2] - last[2]) / (next[0] - last[0])
    };
    let mut speeds: Vec<f64> = rows.windows(2).map(speed).collect();
    speeds.sort_by(f64::total_cmp);
    speeds[speeds.len() / 2] > 0.3
}

/// Whether two columns from this one on may be coordinates: numbers that change.
fn is_place(rows: &[Vec<f64>], from: usize) -> bool {
    rows.iter().all(|row| row[from].is_finite() && row[from + 1].is_finite())
        && (varies(rows, from) || varies(rows, from + 1))
}

fn varies(rows: &[Vec<f64>], column: usize) -> bool {
    rows.iter().any(|row| row[column] != rows[0][column])
}
