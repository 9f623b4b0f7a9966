//! What of a drive is looked at: thirteen channels, made from blocks of ten ticks.
//!
//! - *quality*: q = 1/(1 + √(Ē_y² + 10 Ē_θ²)), with the mean absolute lateral and heading errors over 1 s.
//! - *lateral error*: the mean of e_y over 3 s.
//! - *along, lateral, yaw*, over 1, 3 and 10 s: how far the measured pose came beyond dead reckoning, in the frame of the
//!   window's start. Dead reckoning goes by the reported speed and the *commanded* steering angle, through the chain of
//!   the vehicle's file and the kinematic single track: a vehicle that does not steer as it is told shows.
//! - *noise*: the mean square of the second differences of position, and of heading, from tick to tick over 1 s. A
//!   vehicle's own motion has none to speak of.
//!
//! Poses are means over a block, so that the noise of a single one counts little.

use std::sync::Arc;

use config::{ENVELOPE_CHANNELS, RunConfig};
use tracking::{Path, Pose, SteeringChain, Turning, wrap_angle};

use crate::Movement;

/// Ticks of a block.
const BLOCK: u64 = 10;
/// The windows of the residuals, in blocks.
const WINDOWS: [usize; 3] = [10, 30, 100];
/// The entries that are kept: the longest window, and where it starts.
const KEPT: usize = 101;
/// Odometry that is missing for longer starts the windows afresh: dead reckoning goes by one speed for as long.
const LONGEST_GAP: u64 = 20;
/// The weight of the squared heading error in the quality, that of the paper's state distance.
const HEADING_WEIGHT: f64 = 10.0;

/// What the channels show at the end of a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// Blocks since take-off; `None` where that is not known, after a stop.
    pub age: Option<usize>,
    /// The channels, in the order of [`config::Envelope::CHANNELS`]; NaN before a window is full.
    pub values: [f64; ENVELOPE_CHANNELS],
}

/// The evidence of one vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    kind: Arc<Kind>,
    steering: SteeringChain,
    turning: Turning,
    steering_rad: f64,
    tick: Option<u64>,
    rolls: bool,
    age: Option<usize>,
    block: Block,
    /// Dead reckoning at the start of the block: the rear axle, and the cosine and sine of its yaw.
    from: Pose,
    from_turn: (f64, f64),
    /// The last two measured poses, the newest first; yaw is unwrapped.
    last: [Pose; 2],
    lasts: usize,
    /// A ring of the last blocks.
    entries: Vec<Entry>,
    count: usize,
}

#[derive(Debug, PartialEq)]
struct Kind {
    path: Path,
    tick_s: f64,
    tracked_point_m: f64,
    rear_slip_s2pm: f64,
    rolls_mps: f64,
}

/// Sums over the block that is under way.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Block {
    count: u32,
    ticks: u64,
    /// Of x, y, yaw as measured.
    measured: [f64; 3],
    /// Of the tracked point by dead reckoning, in the frame of the block's start.
    reckoned: [f64; 3],
    /// The rear axle by dead reckoning now, in the same frame.
    now: [f64; 3],
    along_m: f64,
    alongs: u32,
    /// Squares of second differences: of positions and of yaw.
    jumps: [f64; 2],
    jump_count: u32,
}

/// The means of a block.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Entry {
    measured: Place,
    reckoned: Place,
    cross_m: f64,
    heading_rad: f64,
    jumps: [f64; 2],
}

/// A mean pose, with the cosine and sine of its yaw.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Place {
    x_m: f64,
    y_m: f64,
    yaw_rad: f64,
    cos: f64,
    sin: f64,
}

impl Place {
    fn new([x_m, y_m, yaw_rad]: [f64; 3]) -> Self {
        Self { x_m, y_m, yaw_rad, cos: libm::cos(yaw_rad), sin: libm::sin(yaw_rad) }
    }

    /// Another place in the frame of this one.
    fn sees(&self, other: &Self) -> [f64; 3] {
        let (x_m, y_m) = (other.x_m - self.x_m, other.y_m - self.y_m);
        [
            self.cos * x_m + self.sin * y_m,
            self.cos * y_m - self.sin * x_m,
            other.yaw_rad - self.yaw_rad,
        ]
    }
}

impl Evidence {
    /// Before a vehicle at rest at the start of a configuration's path.
    pub fn new(config: &RunConfig) -> Self {
        let vehicle = &config.vehicle;
        Self {
            kind: Arc::new(Kind {
                path: Path::new(&config.path),
                tick_s: config.drive.tick_s,
                tracked_point_m: vehicle.tracked_point_m,
                rear_slip_s2pm: vehicle.rear_slip_s2pm,
                rolls_mps: vehicle.safety.standstill_mps,
            }),
            steering: SteeringChain::new(vehicle, config.drive.tick_s),
            turning: Turning::new(vehicle),
            steering_rad: 0.0,
            tick: None,
            rolls: false,
            age: Some(0),
            block: Block::default(),
            from: Pose::default(),
            from_turn: (1.0, 0.0),
            last: [Pose::default(); 2],
            lasts: 0,
            entries: Vec::new(),
            count: 0,
        }
    }

    /// Nothing is known of how the vehicle came here: the windows start afresh, and how long it has been under way is no
    /// longer known.
    pub fn lose(&mut self) {
        if self.tick.is_some() || self.age.is_some() {
            self.restart();
            (self.tick, self.age) = (None, None);
        }
    }

    fn restart(&mut self) {
        (self.block, self.lasts, self.count) = (Block::default(), 0, 0);
        // A vehicle that was lost may have turned its wheels meanwhile.
        for _ in 0..100 {
            self.steering.step(self.steering_rad);
        }
    }

    /// Takes odometry that is believed. `obeys`: the vehicle follows commands; one that stops on its own steers straight.
    #[inline]
    pub fn see(&mut self, tick: u64, movement: Movement, obeys: bool) {
        let Movement { pose, speed_mps, .. } = movement;
        let steering_rad = if obeys { self.steering_rad } else { 0.0 };
        let ticks = self.tick.map_or(0, |last| tick.saturating_sub(last));
        self.tick = Some(tick);
        if ticks > LONGEST_GAP {
            self.restart();
            if self.rolls {
                self.age = self.age.map(|age| age + (ticks / BLOCK) as usize);
            }
        }
        if !self.rolls {
            for _ in 0..ticks.min(LONGEST_GAP) {
                self.steering.step(steering_rad);
            }
            self.rolls = speed_mps >= self.kind.rolls_mps;
            if !self.rolls {
                return;
            }
        } else if ticks <= LONGEST_GAP {
            self.reckon(ticks, speed_mps, steering_rad);
        }
        self.measure(pose, ticks);
    }

    /// Dead reckoning over some ticks, as the kinematic single track moves.
    #[inline]
    fn reckon(&mut self, ticks: u64, speed_mps: f64, steering_rad: f64) {
        let [mut x_m, mut y_m, mut yaw_rad] = self.block.now;
        for _ in 0..ticks {
            let wheels_rad = self.steering.step(steering_rad);
            let moved_m = speed_mps * self.kind.tick_s;
            let turned_rad = self.turning.turn(wheels_rad, speed_mps, self.kind.tick_s);
            // Within a block the yaw is a small angle: these are its cosine and sine to 1e-5.
            let middle_rad = yaw_rad + turned_rad / 2.0;
            let square = middle_rad * middle_rad;
            x_m += moved_m * (1.0 - square / 2.0);
            y_m += moved_m * middle_rad * (1.0 - square / 6.0);
            // Outwards, as much as the rear tyres slip.
            y_m -= self.kind.rear_slip_s2pm * speed_mps * speed_mps * turned_rad;
            yaw_rad += turned_rad;
        }
        self.block.now = [x_m, y_m, yaw_rad];
    }

    #[inline]
    fn measure(&mut self, pose: Pose, ticks: u64) {
        let [newest, before] = self.last;
        let yaw_rad = if self.lasts == 0 {
            pose.yaw_rad
        } else {
            newest.yaw_rad + wrap_angle(pose.yaw_rad - newest.yaw_rad)
        };
        let pose = Pose { yaw_rad, ..pose };
        if ticks != 1 {
            self.lasts = 0;
        }
        let block = &mut self.block;
        if self.lasts == 2 {
            let second = |now: f64, newest: f64, before: f64| now - 2.0 * newest + before;
            let x_m = second(pose.x_m, newest.x_m, before.x_m);
            let y_m = second(pose.y_m, newest.y_m, before.y_m);
            let turn_rad = second(pose.yaw_rad, newest.yaw_rad, before.yaw_rad);
            block.jumps[0] += x_m * x_m + y_m * y_m;
            block.jumps[1] += turn_rad * turn_rad;
            block.jump_count += 1;
        }
        self.last = [pose, newest];
        self.lasts = (self.lasts + 1).min(2);
        block.count += 1;
        block.ticks += ticks.max(1);
        block.measured[0] += pose.x_m;
        block.measured[1] += pose.y_m;
        block.measured[2] += pose.yaw_rad;
        let ahead_m = self.kind.tracked_point_m;
        let [x_m, y_m, yaw_rad] = block.now;
        let square = yaw_rad * yaw_rad;
        block.reckoned[0] += x_m + ahead_m * (1.0 - square / 2.0);
        block.reckoned[1] += y_m + ahead_m * yaw_rad * (1.0 - square / 6.0);
        block.reckoned[2] += yaw_rad;
    }

    /// Where the reference is, along the path.
    #[inline]
    pub fn follow(&mut self, along_m: f64) {
        self.block.along_m += along_m;
        self.block.alongs += 1;
    }

    /// The steering angle that is commanded from here on. At the end of a block, returns what the channels show.
    #[inline]
    pub fn tell(&mut self, steering_rad: f64) -> Option<Look> {
        self.steering_rad = steering_rad;
        if self.block.ticks < BLOCK {
            if self.block.count == 0 {
                // The reference of ticks before take-off is none of the block's.
                (self.block.along_m, self.block.alongs) = (0.0, 0);
            }
            return None;
        }
        Some(self.close())
    }

    fn close(&mut self) -> Look {
        let block = std::mem::take(&mut self.block);
        let of = f64::from(block.count);
        let measured = Place::new(block.measured.map(|sum| sum / of));
        let [x_m, y_m, yaw_rad] = block.reckoned.map(|sum| sum / of);
        let reckoned = self.place([x_m, y_m, yaw_rad]);
        let [x_m, y_m, yaw_rad] = self.place(block.now);
        self.from = Pose { x_m, y_m, yaw_rad };
        self.from_turn = (libm::cos(yaw_rad), libm::sin(yaw_rad));

        let (mut cross_m, mut heading_rad) = (f64::NAN, f64::NAN);
        if block.alongs > 0 {
            let wanted = self.kind.path.at(block.along_m / f64::from(block.alongs));
            let (x_m, y_m) = (wanted.x_m - measured.x_m, wanted.y_m - measured.y_m);
            cross_m = measured.cos * y_m - measured.sin * x_m;
            heading_rad = wrap_angle(wanted.yaw_rad - measured.yaw_rad);
        }
        let jumps = match block.jump_count {
            0 => [f64::NAN; 2],
            count => block.jumps.map(|sum| sum / f64::from(count)),
        };
        let reckoned = Place::new(reckoned);
        let entry = Entry { measured, reckoned, cross_m, heading_rad, jumps };
        if self.entries.len() < KEPT {
            self.entries.resize(KEPT, Entry::default());
        }
        self.entries[self.count % KEPT] = entry;
        self.count += 1;
        let age = self.age;
        self.age = age.map(|age| age + 1);
        Look { age, values: self.values() }
    }

    /// From the frame of the block's start.
    fn place(&self, [x_m, y_m, yaw_rad]: [f64; 3]) -> [f64; 3] {
        let (cos, sin) = self.from_turn;
        let Pose { x_m: from_x_m, y_m: from_y_m, yaw_rad: from_rad } = self.from;
        [from_x_m + cos * x_m - sin * y_m, from_y_m + sin * x_m + cos * y_m, from_rad + yaw_rad]
    }

    /// The block that was closed `ago` blocks ago.
    fn entry(&self, ago: usize) -> &Entry {
        &self.entries[(self.count - 1 - ago) % KEPT]
    }

    /// The mean of something over the last blocks; NaN if there are not as many.
    fn mean(&self, blocks: usize, of: impl Fn(&Entry) -> f64) -> f64 {
        if self.count < blocks {
            return f64::NAN;
        }
        (0..blocks).map(|ago| of(self.entry(ago))).sum::<f64>() / blocks as f64
    }

    fn values(&self) -> [f64; ENVELOPE_CHANNELS] {
        let mut values = [f64::NAN; ENVELOPE_CHANNELS];
        let cross_m = self.mean(10, |it| it.cross_m.abs());
        let heading_rad = self.mean(10, |it| it.heading_rad.abs());
        let distance = (cross_m * cross_m + HEADING_WEIGHT * heading_rad * heading_rad).sqrt();
        values[0] = 1.0 / (1.0 + distance);
        values[1] = self.mean(30, |it| it.cross_m);
        for (place, window) in WINDOWS.into_iter().enumerate() {
            if self.count > window {
                let (from, to) = (self.entry(window), self.entry(0));
                let came = from.measured.sees(&to.measured);
                let reckoned = from.reckoned.sees(&to.reckoned);
                for axis in 0..3 {
                    values[2 + 3 * axis + place] = came[axis] - reckoned[axis];
                }
            }
        }
        values[11] = self.mean(10, |it| it.jumps[0]);
        values[12] = self.mean(10, |it| it.jumps[1]);
        values
    }
}
