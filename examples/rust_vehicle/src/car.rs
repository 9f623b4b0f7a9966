//! The plant: a kinematic car. Put your own simulator, or the interface of your car, in its place.

use config::Vehicle;
use ipc_types::{Odometry, WirePose};
use tracking::SteeringChain;

/// How fast the car gains speed, and how fast it brakes.
const ACCELERATION_MPS2: f64 = 2.0;
const BRAKING_MPS2: f64 = 4.0;

/// One car; its pose is that of the rear axle.
#[derive(Debug, Clone)]
pub struct Car {
    kind: Vehicle,
    tick_s: f64,
    x_m: f64,
    y_m: f64,
    yaw_rad: f64,
    speed_mps: f64,
    yaw_rate_radps: f64,
    /// From the command to the road wheels: dead time, lag and whatever else the vehicle's file says.
    steering: SteeringChain,
}

impl Car {
    /// A car whose tracked point stands at `start`, at rest.
    pub fn new(kind: &Vehicle, tick_s: f64, start: WirePose) -> Self {
        let back_m = kind.tracked_point_m;
        Self {
            kind: kind.clone(),
            tick_s,
            x_m: start.x_m - back_m * start.yaw_rad.cos(),
            y_m: start.y_m - back_m * start.yaw_rad.sin(),
            yaw_rad: start.yaw_rad,
            speed_mps: 0.0,
            yaw_rate_radps: 0.0,
            steering: SteeringChain::new(kind, tick_s),
        }
    }

    /// Drives one tick with a command; a negative speed only brakes.
    pub fn step(&mut self, speed_mps: f64, steering_rad: f64) {
        let wanted_mps = speed_mps.clamp(0.0, self.kind.speed_limit_mps);
        let (up_mps, down_mps) = (ACCELERATION_MPS2 * self.tick_s, BRAKING_MPS2 * self.tick_s);
        let change_mps = (wanted_mps - self.speed_mps).clamp(-down_mps, up_mps);
        self.roll(self.speed_mps + change_mps, steering_rad);
    }

    /// One tick of the car's own stop: wheels straight, speed down.
    pub fn stop(&mut self) {
        let down_mps = self.kind.safety.stop_deceleration_mps2 * self.tick_s;
        self.roll((self.speed_mps - down_mps).max(0.0), 0.0);
    }

    fn roll(&mut self, speed_mps: f64, steering_rad: f64) {
        let angle_rad = self.steering.step(steering_rad);
        self.speed_mps = speed_mps;
        self.yaw_rate_radps = speed_mps * angle_rad.tan() / self.kind.wheelbase_m;
        let turned_rad = self.yaw_rate_radps * self.tick_s;
        let middle_rad = self.yaw_rad + turned_rad / 2.0;
        self.x_m += speed_mps * self.tick_s * middle_rad.cos();
        self.y_m += speed_mps * self.tick_s * middle_rad.sin();
        self.yaw_rad += turned_rad;
    }

    /// What the car's sensors tell; `status` holds bits beside [`Odometry::HAS_TRUTH`].
    pub fn observe(&self, status: u32) -> Odometry {
        let ahead_m = self.kind.tracked_point_m;
        let pose = WirePose {
            x_m: self.x_m + ahead_m * self.yaw_rad.cos(),
            y_m: self.y_m + ahead_m * self.yaw_rad.sin(),
            yaw_rad: self.yaw_rad,
        };
        Odometry {
            measured: pose,
            truth: pose,
            speed_mps: self.speed_mps,
            yaw_rate_radps: self.yaw_rate_radps,
            steering_rad: self.steering.angle_rad(),
            status: Odometry::HAS_TRUTH | status,
            reserved: 0,
        }
    }
}
