//! A recorded drive: what the gate passed to the car, and what the car's odometry told.

use crate::levenberg::median;

/// A command that the gate passed.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Command {
    /// When it was given, by the clock of the odometry's arrivals.
    pub time_s: f64,
    /// Steering angle.
    pub steering_rad: f64,
    /// Speed.
    pub speed_mps: f64,
}

/// Odometry.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Odometry {
    /// When it arrived: not its stamp, because what a loop sees late is late.
    pub time_s: f64,
    /// x of the odometry's point, in any frame that stands still.
    pub x_m: f64,
    /// y of that point.
    pub y_m: f64,
    /// Yaw, counter-clockwise; may be wrapped.
    pub yaw_rad: f64,
    /// Forward speed of the rear axle.
    pub speed_mps: f64,
    /// Yaw rate; `NaN` if the odometry has none.
    pub yaw_rate_radps: f64,
}

/// A recorded drive. A command is held until the next one.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Drive {
    /// Commands, in the order of their times.
    pub commands: Vec<Command>,
    /// Odometry, in the order of its arrivals.
    pub odometry: Vec<Odometry>,
    /// By how much each command may have been given before its time, as where it was noted with the next row of a table; 0 if
    /// its time is its own.
    pub late_commands_s: f64,
}

/// A gap of the odometry that is longer cuts a drive.
const GAP_S: f64 = 0.25;
/// What is left of a drive after a cut must be at least this long.
const SHORTEST_S: f64 = 4.0;
/// A car slower than this stands.
pub(crate) const STANDING_MPS: f64 = 0.05;
/// Half the length of the mean that takes the noise out of a measured speed.
const SMOOTHED_S: f64 = 0.07;
/// What rounding may do to a time.
const ROUNDING_S: f64 = 1e-9;

/// A stretch of a drive without gaps, as arrays.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Stretch {
    pub(crate) commands: Vec<Command>,
    pub(crate) time_s: Vec<f64>,
    pub(crate) x_m: Vec<f64>,
    pub(crate) y_m: Vec<f64>,
    /// Not wrapped.
    pub(crate) yaw_rad: Vec<f64>,
    pub(crate) speed_mps: Vec<f64>,
    /// Speed without its noise.
    pub(crate) smooth_mps: Vec<f64>,
    pub(crate) yaw_rate_radps: Vec<f64>,
    /// The mean time between two samples.
    pub(crate) tick_s: f64,
    /// The car stood at the beginning.
    pub(crate) from_rest: bool,
}

impl Stretch {
    pub(crate) fn len(&self) -> usize {
        self.time_s.len()
    }

    /// The command that had been given last at a time; that of a car at rest, if none had.
    pub(crate) fn command_at(&self, time_s: f64) -> Command {
        let next = self.commands.partition_point(|it| it.time_s <= time_s + ROUNDING_S);
        next.checked_sub(1).map_or(Command::default(), |at| self.commands[at])
    }

    /// The command that acts at the beginning, of those that arrive `delay_s` late. If none has arrived yet, the first one is
    /// taken to act where the recording begins within a drive; nothing acts on a car that stands, as its commands begin later.
    pub(crate) fn first_acting(&self, delay_s: f64) -> Command {
        match self.arrived_first(delay_s) {
            0 if self.from_rest => Command::default(),
            0 => self.commands.first().copied().unwrap_or_default(),
            arrived => self.commands[arrived - 1],
        }
    }

    /// How many commands, of those that arrive `delay_s` late, have arrived at the beginning.
    fn arrived_first(&self, delay_s: f64) -> usize {
        self.commands.partition_point(|it| it.time_s + delay_s <= self.time_s[0] + ROUNDING_S)
    }

    /// Seconds in which the car moved.
    pub(crate) fn moving_s(&self) -> f64 {
        let moving = self.smooth_mps.iter().filter(|speed| **speed > STANDING_MPS).count();
        moving as f64 * self.tick_s
    }
}

/// The stretches of a drive. What it drove backwards is a gap: the speed loop that is fitted knows no reverse.
pub(crate) fn stretches(drive: &Drive) -> Vec<Stretch> {
    let odometry = &forwards(&drive.odometry);
    let mut cuts: Vec<usize> = (1..odometry.len())
        .filter(|&at| odometry[at].time_s - odometry[at - 1].time_s > GAP_S)
        .collect();
    cuts.insert(0, 0);
    cuts.push(odometry.len());
    cuts.windows(2)
        .filter(|ends| {
            let (first, last) = (ends[0], ends[1].saturating_sub(1));
            last > first && odometry[last].time_s - odometry[first].time_s >= SHORTEST_S
        })
        .map(|ends| stretch(&odometry[ends[0]..ends[1]], &drive.commands))
        .collect()
}

/// The samples without those of times in which the car drives backwards: long enough to be no noise, and to be a gap.
fn forwards(odometry: &[Odometry]) -> Vec<Odometry> {
    let is_backwards = |it: &Odometry| it.speed_mps < -STANDING_MPS;
    let runs = odometry.chunk_by(|a, b| is_backwards(a) == is_backwards(b));
    let counts = |run: &&[Odometry]| {
        !is_backwards(&run[0]) || run[run.len() - 1].time_s - run[0].time_s <= GAP_S
    };
    runs.filter(counts).flatten().copied().collect()
}

fn stretch(odometry: &[Odometry], commands: &[Command]) -> Stretch {
    let array = |of: fn(&Odometry) -> f64| odometry.iter().map(of).collect::<Vec<f64>>();
    let time_s = array(|it| it.time_s);
    // The mean and not the median: samples may arrive several at a time.
    let tick_s = ((time_s[time_s.len() - 1] - time_s[0]) / (time_s.len() - 1) as f64).max(1e-3);
    let speed_mps = array(|it| it.speed_mps);
    let smooth_mps = smooth(&speed_mps, (SMOOTHED_S / tick_s).round() as usize);
    let mut yaw_rad = array(|it| it.yaw_rad);
    for at in 1..yaw_rad.len() {
        yaw_rad[at] = yaw_rad[at - 1] + tracking::wrap_angle(yaw_rad[at] - yaw_rad[at - 1]);
    }
    // One command before the stretch holds at its beginning; the dead time may reach further back.
    let first_s = time_s[0] - 2.0;
    let begin = commands.partition_point(|it| it.time_s < first_s).saturating_sub(1);
    let end = commands.partition_point(|it| it.time_s <= time_s[time_s.len() - 1]);
    Stretch {
        commands: commands[begin.min(end)..end].to_vec(),
        x_m: array(|it| it.x_m),
        y_m: array(|it| it.y_m),
        yaw_rad,
        yaw_rate_radps: array(|it| it.yaw_rate_radps),
        from_rest: begins_at_rest(&time_s, &smooth_mps),
        time_s,
        speed_mps,
        smooth_mps,
        tick_s,
    }
}

fn begins_at_rest(time_s: &[f64], smooth_mps: &[f64]) -> bool {
    let standing = time_s.partition_point(|time| *time < time_s[0] + 0.5).max(1);
    smooth_mps[..standing].iter().all(|speed| *speed < STANDING_MPS)
}

/// The median of five, and of that the mean over `half` samples on either side: without delay.
fn smooth(values: &[f64], half: usize) -> Vec<f64> {
    let around = |values: &[f64], at: usize, half: usize| {
        let half = half.min(at).min(values.len() - 1 - at);
        values[at - half..=at + half].to_vec()
    };
    let clean: Vec<f64> = (0..values.len()).map(|at| median(&mut around(values, at, 2))).collect();
    let mean = |at| {
        let window = around(&clean, at, half);
        window.iter().sum::<f64>() / window.len() as f64
    };
    (0..values.len()).map(mean).collect()
}

/// What depends on a length of time alone, for lengths that come again and again: a drive with even ticks has few of them.
#[derive(Debug)]
pub(crate) struct ByLength<T> {
    made: [Option<(f64, T)>; 4],
    next: usize,
}

impl<T: Copy> ByLength<T> {
    pub(crate) fn new() -> Self {
        Self { made: [None; 4], next: 0 }
    }

    /// What is made of a length, or was made of the same one before.
    #[inline]
    pub(crate) fn get(&mut self, length_s: f64, make: impl FnOnce() -> T) -> T {
        for (of_s, made) in self.made.iter().flatten() {
            if (of_s - length_s).abs() < ROUNDING_S {
                return *made;
            }
        }
        let made = make();
        self.made[self.next] = Some((length_s, made));
        self.next = (self.next + 1) % self.made.len();
        made
    }
}

/// Walks through the samples of a stretch and the commands that arrive `delay_s` late in between: `part(index, command,
/// length_s)` is called for each part of the time before sample `index` in which one command acts, and is never longer than
/// `longest_s`. Parts also end where commands arrive that are `cut_s` late, if it is given.
pub(crate) fn walk(
    stretch: &Stretch,
    delay_s: f64,
    cut_s: Option<f64>,
    longest_s: f64,
    mut part: impl FnMut(usize, &Command, f64),
) {
    let commands = &stretch.commands;
    let mut now_s = stretch.time_s[0];
    let mut next = stretch.arrived_first(delay_s);
    let mut next_cut = cut_s.map_or(commands.len(), |cut_s| stretch.arrived_first(cut_s));
    let first = stretch.first_acting(delay_s);
    let mut held = &first;
    for index in 1..stretch.len() {
        let end_s = stretch.time_s[index];
        loop {
            let arrival = |next: usize, delay_s: f64| {
                commands.get(next).map_or(f64::INFINITY, |it| it.time_s + delay_s)
            };
            let arrival_s = arrival(next, delay_s);
            let also_s = arrival(next_cut, cut_s.unwrap_or(0.0));
            let until_s = arrival_s.min(also_s).min(end_s);
            let length_s = until_s - now_s;
            if length_s > ROUNDING_S {
                let pieces = match length_s <= longest_s {
                    true => 1.0,
                    false => (length_s / longest_s - 1e-6).ceil().max(1.0),
                };
                for _ in 0..pieces as usize {
                    part(index, held, length_s / pieces);
                }
                now_s = until_s;
            }
            if also_s <= until_s {
                next_cut += 1;
            }
            if arrival_s <= until_s {
                held = &commands[next];
                next += 1;
            }
            if until_s >= end_s - ROUNDING_S {
                break;
            }
        }
        now_s = end_s;
    }
}

/// Of long recordings, the pieces with the most steering and changes of speed: at most `longest_s` in all, in their order.
pub(crate) fn choose(whole: Vec<Stretch>, longest_s: f64) -> Vec<Stretch> {
    const PIECE_S: f64 = 30.0;
    let length_s = |it: &Stretch| it.tick_s * it.len() as f64;
    if whole.iter().map(length_s).sum::<f64>() <= longest_s {
        return whole;
    }
    let mut pieces = Vec::new();
    for stretch in &whole {
        let count = (PIECE_S / stretch.tick_s) as usize;
        let mut first = 0;
        while first + count <= stretch.len() {
            pieces.push(stretch.piece(first..first + count));
            first += count;
        }
        if first == 0 {
            pieces.push(stretch.clone());
        }
    }
    let mut order: Vec<usize> = (0..pieces.len()).collect();
    let liveliness: Vec<f64> = pieces.iter().map(Stretch::liveliness).collect();
    order.sort_by(|a, b| liveliness[*b].total_cmp(&liveliness[*a]).then(a.cmp(b)));
    let mut left_s = longest_s;
    order.retain(|&at| {
        let fits = length_s(&pieces[at]) <= left_s;
        left_s -= if fits { length_s(&pieces[at]) } else { 0.0 };
        fits
    });
    order.sort_unstable();
    order.into_iter().map(|at| pieces[at].clone()).collect()
}

impl Stretch {
    /// A part of it.
    fn piece(&self, range: std::ops::Range<usize>) -> Self {
        let cut = |values: &Vec<f64>| values[range.clone()].to_vec();
        let (first_s, last_s) = (self.time_s[range.start], self.time_s[range.end - 1]);
        let commands = &self.commands;
        let begin = commands.partition_point(|it| it.time_s < first_s - 2.0).saturating_sub(1);
        let end = commands.partition_point(|it| it.time_s <= last_s);
        let (time_s, smooth_mps) = (cut(&self.time_s), cut(&self.smooth_mps));
        // A car that stands after it was told to stop is midway in something; before its first command it is not.
        let is_first = range.start == 0 || commands.first().is_none_or(|it| it.time_s > first_s);
        Self {
            commands: commands[begin.min(end)..end].to_vec(),
            x_m: cut(&self.x_m),
            y_m: cut(&self.y_m),
            yaw_rad: cut(&self.yaw_rad),
            speed_mps: cut(&self.speed_mps),
            yaw_rate_radps: cut(&self.yaw_rate_radps),
            tick_s: self.tick_s,
            from_rest: self.from_rest && is_first && begins_at_rest(&time_s, &smooth_mps),
            time_s,
            smooth_mps,
        }
    }

    /// How much the commands change per second while the car moves.
    fn liveliness(&self) -> f64 {
        let changes = self.commands.windows(2).map(|two| {
            10.0 * (two[1].steering_rad - two[0].steering_rad).abs()
                + (two[1].speed_mps - two[0].speed_mps).abs()
        });
        let moving = self.moving_s() / (self.tick_s * self.len() as f64);
        moving * changes.sum::<f64>() / self.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stretch_begins_anew_behind_what_is_driven_backwards_and_has_the_tick_of_its_batches() {
        let speed_mps = |time_s: f64| if (6.0..7.0).contains(&time_s) { -0.5 } else { 1.0 };
        let mut drive = Drive::default();
        for tick in 0..1200_u32 {
            // Four at a time, and a slip backwards that is too short to be a gap.
            let time_s = 0.04 * f64::from(tick / 4) + 1e-5 * f64::from(tick % 4);
            let speed_mps = if tick == 300 { -0.5 } else { speed_mps(time_s) };
            drive.odometry.push(Odometry { time_s, speed_mps, ..Odometry::default() });
        }
        let all = stretches(&drive);
        let ends: Vec<(f64, f64)> =
            all.iter().map(|it| (it.time_s[0], it.time_s[it.len() - 1])).collect();
        assert_eq!(all.len(), 2, "{ends:?}");
        assert!(ends[0].1 < 6.0 && ends[1].0 > 6.99, "{ends:?}");
        assert!(all.iter().all(|it| (it.tick_s / 0.01 - 1.0).abs() < 0.01));
    }

    #[test]
    fn nothing_acts_on_a_car_at_rest_before_its_first_command() {
        let mut drive = Drive::default();
        for tick in 0..1000_u32 {
            let time_s = 0.01 * f64::from(tick);
            drive.odometry.push(Odometry { time_s, ..Odometry::default() });
        }
        let command = Command { time_s: 3.0, steering_rad: 0.1, speed_mps: 2.0 };
        drive.commands.push(command);
        let first = |drive: &Drive| stretches(drive)[0].first_acting(0.2);
        assert_eq!(first(&drive), Command::default());
        // One that begins within a drive was commanded before.
        drive.odometry.iter_mut().for_each(|it| it.speed_mps = 2.0);
        assert_eq!(first(&drive), command);
    }
}
