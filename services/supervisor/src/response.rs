//! Whether the vehicle does what it is told: it steers as its steering angle says and the right way round, drives no
//! faster than it is told to, and drives at all. And whether its measured pose goes along with it: a localisation that
//! hangs repeats the last pose, while the vehicle drives on.
//!
//! Commands go through a model of the vehicle before they are compared with its odometry: the steering angle through the
//! [`SteeringChain`] of the vehicle's file, the speed through how slowly a car may follow. What the odometry shows of the
//! steering is the single track's angle, tan δ = ω·L/v. Differences count by how long they last, in rad·s and in metres,
//! so that noise, a lag that no file states and wheels that slip for a moment do not count for much.

use config::{FULL_SIZE_WHEELBASE_M, RunConfig};
use ipc_types::Safety;
use tracking::{Pose, SteeringChain};

use crate::Movement;
use crate::mean::Means;
use crate::unseen::Unseen;

/// Slower than this many wheelbases in a second, or this many m/s, the yaw rate says little about the steering.
const CRAWLS_WHEELBASES_PER_S: f64 = 0.2;
const CRAWLS_MPS: f64 = 0.3;
/// Means are smoothed with this time constant, so that steering that goes to and fro faster than an unknown lag allows
/// does not count.
const SMOOTHED_OVER_S: f64 = 0.2;
/// Angles below this do not tell which way round the vehicle steers.
const CLEAR_RAD: f64 = 0.02;
/// How much the steering may differ from what it should be: by this share, and by this angle.
const STEERING_SHARE: f64 = 0.4;
const STEERING_RAD: f64 = 0.05;
/// How much steering the wrong way round, and how much beyond that difference, is too much, for a car of this wheelbase. A
/// smaller one leaves its path sooner, and less is too much, by the root of how much smaller it is.
const REVERSED_RAD_S: f64 = 0.015;
const ASTRAY_RAD_S: f64 = 0.05;
/// So much steering to the other side than it was told is too much, on means that are not smoothed: wheels on their way over
/// count as well, before they have come as far as they were told. It does not scale with the car: what it must allow for is
/// a lag that no file states.
const CONTRARY_RAD_S: f64 = 0.02;
/// And so much is where no lag accounts for it: it has turned by this angle farther to that side than it was told to turn at
/// any time of the last 0.8 s, and steering that follows late lies between what it was told.
const UNEXPLAINED_RAD_S: f64 = 0.006;
const BEYOND_RAD: f64 = 0.03;
const LATE_MEANS: usize = 8;
/// What it shows when it is told to go straight on is a mean with this time constant: one that steers the wrong way round
/// slowly from there would take its own steering for straight.
const STRAIGHT_OVER_S: f64 = 1.0;
/// Of a vehicle that is being stopped because it does not drive as it should, a fifth of that is enough, and the wheels need
/// not have come as far as they were told: that something is wrong is known by then, and the question is only whether
/// steering helps.
const SUSPECTED_RAD_S: f64 = REVERSED_RAD_S / 5.0;
/// How much faster than told the vehicle may be: by this share, and by this speed.
const SPEED_SHARE: f64 = 0.25;
const SPEED_MPS: f64 = 0.3;
/// How far beyond that is too far, in wheelbases.
const RUN_WHEELBASES: f64 = 0.2;
/// A vehicle slows down at least at this share of the stop's deceleration.
const SLOWING_SHARE: f64 = 0.5;
/// For how long a vehicle that is told to drive at this speed or faster may stand, once its gear is engaged.
const STANDS_S: f64 = 2.0;
const DRIVES_MPS: f64 = 0.2;
/// How much of the way that its speed accounts for the measured pose has to come, and how far it may fall behind that: by so
/// many wheelbases, and by what is driven in this time, as a localisation may be slow.
const COMES_SHARE: f64 = 0.7;
const BEHIND_WHEELBASES: f64 = 0.5;
const BEHIND_S: f64 = 0.2;
/// For how long ticks may be missing before the model of the vehicle starts afresh.
const LONGEST_GAP_S: f64 = 1.0;

/// The response of one vehicle to its commands.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    steering: SteeringChain,
    /// The command that the vehicle has, and the tick of the last odometry.
    speed_mps: f64,
    steering_rad: f64,
    tick: Option<u64>,
    /// `None` for a vehicle that tells the truth: a simulated one may follow its commands exactly.
    unseen: Option<Unseen>,
    /// Of speed, yaw rate, the model's angle and the commanded speed.
    means: Means<4>,
    ticks: u64,
    /// The highest speed that commands account for by now.
    ceiling_mps: f64,
    /// The integral part of the vehicle's speed controller, as its file has it.
    integral: f64,
    /// Tangents of the steering angle, smoothed: the model's, and what the odometry shows.
    told: f64,
    shown: f64,
    /// What it showed when it was last told to go straight on; `None` before the vehicle rolls.
    straight: Option<f64>,
    reversed_rad_s: f64,
    /// How much it has been turned to the side that it was not told to turn to.
    contrary_rad_s: f64,
    /// The same, as far as no lag accounts for it, and tangents of the angles that it was told lately.
    unexplained_rad_s: f64,
    told_lately: [f64; LATE_MEANS],
    astray_rad_s: f64,
    run_m: f64,
    stands_s: f64,
    /// The measured pose at the end of the last mean, and how far it has fallen behind.
    pose: Option<Pose>,
    behind_m: f64,
    faults: u32,

    speed_kp: f64,
    speed_ki: f64,
    integral_bounds: (f64, f64),
    tick_s: f64,
    longest_gap: u64,
    wheelbase_m: f64,
    reversed_limit_rad_s: f64,
    suspected_limit_rad_s: f64,
    astray_limit_rad_s: f64,
    crawls_mps: f64,
    slowing_mps2: f64,
    standstill_mps: f64,
    may_stand_s: f64,
}

impl Response {
    /// Before a vehicle at rest; `None` if its response is not watched.
    pub fn new(config: &RunConfig) -> Option<Self> {
        let vehicle = &config.vehicle;
        // A command to brake, as noise makes one, may have put it in reverse.
        let gear_s = match vehicle.gear_engaged {
            true => 0.0,
            false => vehicle.gear_drive_s.max(vehicle.gear_reverse_s) + vehicle.gear_poll_s,
        };
        let size = (vehicle.wheelbase_m / FULL_SIZE_WHEELBASE_M).min(1.0).sqrt();
        config.watches_response().then(|| Self {
            steering: SteeringChain::new(vehicle, config.drive.tick_s),
            speed_mps: 0.0,
            steering_rad: 0.0,
            tick: None,
            unseen: Some(Unseen::new(config)),
            means: Means::new(config),
            ticks: 0,
            ceiling_mps: 0.0,
            integral: 0.0,
            told: 0.0,
            shown: 0.0,
            straight: None,
            reversed_rad_s: 0.0,
            contrary_rad_s: 0.0,
            unexplained_rad_s: 0.0,
            told_lately: [0.0; LATE_MEANS],
            astray_rad_s: 0.0,
            run_m: 0.0,
            stands_s: 0.0,
            pose: None,
            behind_m: 0.0,
            faults: 0,
            speed_kp: vehicle.speed_kp,
            speed_ki: vehicle.speed_ki,
            integral_bounds: (vehicle.speed_integral_min, vehicle.speed_integral_max),
            tick_s: config.drive.tick_s,
            longest_gap: libm::round(LONGEST_GAP_S / config.drive.tick_s) as u64,
            wheelbase_m: vehicle.wheelbase_m,
            reversed_limit_rad_s: REVERSED_RAD_S * size,
            suspected_limit_rad_s: SUSPECTED_RAD_S * size,
            astray_limit_rad_s: ASTRAY_RAD_S * size,
            crawls_mps: CRAWLS_MPS.max(CRAWLS_WHEELBASES_PER_S * vehicle.wheelbase_m),
            slowing_mps2: SLOWING_SHARE * vehicle.safety.stop_deceleration_mps2,
            standstill_mps: vehicle.safety.standstill_mps,
            may_stand_s: STANDS_S + gear_s,
        })
    }

    /// Goes on with a vehicle of which only this is known.
    pub fn resume(&mut self, speed_mps: f64, steering_rad: f64) {
        (self.speed_mps, self.steering_rad) = (speed_mps, steering_rad);
        (self.ceiling_mps, self.integral) = (speed_mps.max(0.0), self.integral_bounds.1);
        self.settle();
        self.forgive();
        self.tick = None;
    }

    /// The vehicle tells the truth beside what it measures.
    pub fn tells_truth(&mut self) {
        self.unseen = None;
    }

    /// Forgets what spoke against the vehicle.
    pub fn forgive(&mut self) {
        self.means.restart();
        (self.straight, self.ticks) = (None, 0);
        (self.reversed_rad_s, self.contrary_rad_s, self.astray_rad_s) = (0.0, 0.0, 0.0);
        self.unexplained_rad_s = 0.0;
        (self.run_m, self.stands_s) = (0.0, 0.0);
        (self.pose, self.behind_m) = (None, 0.0);
        self.faults = 0;
    }

    /// The command with which the vehicle goes on from here.
    #[inline]
    pub fn tell(&mut self, speed_mps: f64, steering_rad: f64) {
        (self.speed_mps, self.steering_rad) = (speed_mps, steering_rad);
    }

    /// Takes odometry that is believed. `obeys`: the vehicle follows commands; one that stops on its own steers straight.
    #[inline]
    pub fn see(&mut self, tick: u64, movement: Movement, obeys: bool) {
        let ticks = self.tick.map_or(0, |last| tick.saturating_sub(last));
        self.tick = Some(tick);
        let steering_rad = if obeys { self.steering_rad } else { 0.0 };
        if ticks > self.longest_gap {
            self.settle();
            self.means.restart();
            (self.pose, self.ticks) = (None, 0);
        } else {
            for _ in 0..ticks {
                self.steering.step(steering_rad);
            }
            self.ticks += ticks;
        }
        let Movement { pose, speed_mps, yaw_rate_radps } = movement;
        if let Some(unseen) = &mut self.unseen
            && speed_mps > self.crawls_mps
        {
            unseen.see(steering_rad, speed_mps, yaw_rate_radps);
        }
        let told_mps = if obeys { self.speed_mps } else { 0.0 };
        self.raise_ceiling(speed_mps, told_mps, self.tick_s * ticks as f64);
        let numbers = [speed_mps, yaw_rate_radps, self.steering.angle_rad(), told_mps];
        if let Some(means) = self.means.add(numbers) {
            self.judge(means, pose, obeys);
        }
    }

    /// A vehicle slows down after its command, but not while a speed controller that has wound up pushes on.
    #[inline]
    fn raise_ceiling(&mut self, speed_mps: f64, told_mps: f64, lasted_s: f64) {
        let slowed_mps = self.ceiling_mps - self.slowing_mps2 * lasted_s;
        // A negative speed only brakes.
        self.ceiling_mps = slowed_mps.max(told_mps).max(0.0);
        let (error_mps, (least, most)) = (told_mps - speed_mps, self.integral_bounds);
        self.integral = (self.integral + self.speed_ki * error_mps * lasted_s).max(least).min(most);
        if self.speed_kp * error_mps + self.integral > 0.0 {
            self.ceiling_mps = self.ceiling_mps.max(speed_mps);
        }
    }

    /// The model's wheels as they come to stand under the present command.
    fn settle(&mut self) {
        for _ in 0..self.longest_gap {
            self.steering.step(self.steering_rad);
        }
    }

    fn judge(
        &mut self,
        [speed_mps, yaw_rate_radps, angle_rad, told_mps]: [f64; 4],
        pose: Pose,
        obeys: bool,
    ) {
        let lasted_s = std::mem::take(&mut self.ticks) as f64 * self.tick_s;
        self.judge_pose(pose, speed_mps.max(0.0), lasted_s);
        if speed_mps < self.crawls_mps {
            self.straight = None;
        } else {
            let shown = yaw_rate_radps * self.wheelbase_m / speed_mps;
            // Just above that, a jolt as it starts looks like a large angle, and says more with each m/s.
            let weight = ((speed_mps - self.crawls_mps) / self.crawls_mps).min(1.0);
            self.judge_steering(libm::tan(angle_rad), shown, lasted_s, weight);
        }
        let most_mps = (1.0 + SPEED_SHARE) * self.ceiling_mps + SPEED_MPS;
        self.run_m = (self.run_m + (speed_mps - most_mps) * lasted_s).max(0.0);
        // One that stops on its own does not hear its commands, or not in time.
        let told_mps = if obeys { told_mps } else { self.speed_mps };
        let is_told_in_vain = told_mps >= DRIVES_MPS && speed_mps.abs() < self.standstill_mps;
        self.stands_s = if is_told_in_vain { self.stands_s + lasted_s } else { 0.0 };

        let flag = |on: bool, bit: u32| if on { bit } else { 0 };
        self.faults = flag(
            self.reversed_rad_s > self.reversed_limit_rad_s
                || self.contrary_rad_s > CONTRARY_RAD_S
                || self.unexplained_rad_s > UNEXPLAINED_RAD_S,
            Safety::STEERING_REVERSED,
        ) | flag(
            self.astray_rad_s > self.astray_limit_rad_s,
            Safety::STEERING_IGNORED,
        ) | flag(
            self.run_m > RUN_WHEELBASES * self.wheelbase_m,
            Safety::SPEED_IGNORED,
        ) | flag(
            self.behind_m > BEHIND_WHEELBASES * self.wheelbase_m + BEHIND_S * speed_mps.max(0.0),
            Safety::POSE_STANDS,
        ) | flag(self.stands_s > self.may_stand_s, Safety::STANDS)
            | flag(self.unseen.as_ref().is_some_and(Unseen::is_computed), Safety::STEERING_UNSEEN);
    }

    /// Whether the measured pose comes forward as the speed says.
    fn judge_pose(&mut self, pose: Pose, speed_mps: f64, lasted_s: f64) {
        let Some(last) = self.pose.replace(pose) else { return };
        let (sin, cos) = (libm::sin(pose.yaw_rad), libm::cos(pose.yaw_rad));
        let mut came_m = (pose.x_m - last.x_m) * cos + (pose.y_m - last.y_m) * sin;
        if speed_mps < self.standstill_mps {
            // Noise, a car that is pulled back, or a localisation that settles: it does not fall behind where it does not drive.
            came_m = came_m.max(0.0);
        }
        self.behind_m = (self.behind_m + COMES_SHARE * speed_mps * lasted_s - came_m).max(0.0);
    }

    fn judge_steering(&mut self, told: f64, shown: f64, lasted_s: f64, weight: f64) {
        let share = match self.straight {
            Some(_) => lasted_s / (SMOOTHED_OVER_S + lasted_s),
            None => 1.0,
        };
        self.judge_side(told, shown - self.straight.unwrap_or(0.0), lasted_s, weight);
        self.told += share * (told - self.told);
        self.shown += share * (shown - self.shown);
        let (told, shown, size) = (self.told, self.shown, self.told.abs());
        let straight = match self.straight {
            Some(straight) if size > CLEAR_RAD => straight,
            Some(was) => {
                let share = lasted_s / (STRAIGHT_OVER_S + lasted_s);
                *self.straight.insert(was + share * (shown - was))
            }
            None => *self.straight.insert(if size > CLEAR_RAD { 0.0 } else { shown }),
        };
        // Turned as far as it should be, but to the other side, within the tolerance.
        let turned = shown - straight;
        let is_reversed = size > CLEAR_RAD && (told + turned).abs() < STEERING_SHARE * size;
        let sign = if is_reversed { 1.0 } else { -1.0 };
        self.reversed_rad_s = (self.reversed_rad_s + sign * size * lasted_s).max(0.0);
        let beyond = (shown - told).abs() - STEERING_SHARE * size - STEERING_RAD;
        let most = 2.0 * self.astray_limit_rad_s;
        let counts = if beyond > 0.0 { weight } else { 1.0 };
        self.astray_rad_s = (self.astray_rad_s + counts * beyond * lasted_s).clamp(0.0, most);
    }

    /// Whether it is turned to the side that it was told to turn to, now: nothing is smoothed, as time is short.
    fn judge_side(&mut self, told: f64, turned: f64, lasted_s: f64, weight: f64) {
        let clear = told.abs().min(turned.abs()) > CLEAR_RAD;
        let by = match told * turned < 0.0 {
            true if clear => told.abs().min(turned.abs()),
            true => 0.0,
            false => -told.abs(),
        };
        self.contrary_rad_s = (self.contrary_rad_s + by * lasted_s).max(0.0);
        self.told_lately.rotate_right(1);
        self.told_lately[0] = told;
        // Numbers of the side to which it is told to turn are positive from here on.
        let side = 1.0f64.copysign(told);
        let least = self.told_lately.iter().fold(0.0f64, |least, it| least.min(side * it));
        let beyond = least - side * turned;
        let by = match beyond > BEYOND_RAD && told.abs() > CLEAR_RAD {
            true => weight * beyond.min(told.abs()),
            false if side * turned < 0.0 => 0.0,
            false => -told.abs(),
        };
        self.unexplained_rad_s = (self.unexplained_rad_s + by * lasted_s).max(0.0);
    }

    /// Bits of [`Safety::reasons`]: what the vehicle does not do as it is told.
    pub fn faults(&self) -> u32 {
        self.faults
    }

    /// The same of a vehicle that is being stopped and goes on steering: [`Safety::STEERING_REVERSED`] if its steering seems
    /// to make things worse.
    pub fn suspicions(&self) -> u32 {
        let is_reversed = self.contrary_rad_s > self.suspected_limit_rad_s;
        if is_reversed { Safety::STEERING_REVERSED } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    /// What speaks against a car of 2.58 m that is let go at 3 m/s², told to go straight on, and turns like this, in
    /// rad/s after so many seconds.
    fn faults_of(yaw_rate_radps: impl Fn(f64) -> f64) -> u32 {
        let mut layers = Layers::maneuver("smooth_lane").unwrap();
        layers.set_vehicle("test", "ackermann").unwrap();
        let mut response = Response::new(&layers.resolve().unwrap()).unwrap();
        let mut faults = 0;
        for tick in 0..300_u64 {
            let time_s = 0.01 * tick as f64;
            response.tell(3.0, 0.0);
            let (speed_mps, yaw_rate_radps) = ((3.0 * time_s).min(2.0), yaw_rate_radps(time_s));
            response.see(tick, Movement { pose: Pose::default(), speed_mps, yaw_rate_radps }, true);
            faults |= response.faults() & (Safety::STEERING_IGNORED | Safety::STEERING_REVERSED);
        }
        faults
    }

    #[test]
    fn a_jolt_at_the_start_is_no_fault_and_a_turn_that_lasts_is_one() {
        // As CommonRoad's multi-body car has it when it is let go.
        let jolt = |time_s: f64| if time_s < 0.25 { 0.07 * (time_s / 0.2).min(1.0) } else { 0.0 };
        assert_eq!(faults_of(jolt), 0);
        assert_eq!(faults_of(|_| 0.0), 0);
        assert_eq!(faults_of(|_| 0.03), 0, "within the tolerance");
        assert_eq!(faults_of(|_| 0.12), Safety::STEERING_IGNORED);
    }
}
