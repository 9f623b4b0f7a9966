//! The commands to the car, and how it comes to a stop when no commands come.

use config::Vehicle;
use ipc_types::Command;

/// A command to the car.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Setpoint {
    /// Forward speed; never negative.
    pub speed_mps: f64,
    /// Angle of the road wheels, positive to the left.
    pub steering_rad: f64,
    /// Limit of the acceleration; 0 for none.
    pub acceleration_mps2: f64,
}

/// Makes setpoints for one car.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setpoints {
    speed_limit_mps: f64,
    steering_limit_rad: f64,
    /// 0 if the commands do not name it.
    acceleration_mps2: f64,
    stop_deceleration_mps2: f64,
    names_acceleration: bool,
}

impl Setpoints {
    /// The setpoints for this car.
    pub fn new(vehicle: &Vehicle) -> Self {
        let names_acceleration = vehicle.ros2.drive_acceleration;
        let limit_mps2 = vehicle.safety.acceleration_limit_mps2;
        let is_named = names_acceleration && limit_mps2.is_finite();
        Self {
            speed_limit_mps: vehicle.speed_limit_mps,
            steering_limit_rad: vehicle.steering_limit_rad,
            acceleration_mps2: if is_named { limit_mps2 } else { 0.0 },
            stop_deceleration_mps2: vehicle.safety.stop_deceleration_mps2,
            names_acceleration,
        }
    }

    /// What a command asks for; `None` if it is not finite.
    pub fn of(&self, command: &Command) -> Option<Setpoint> {
        let Command { speed_mps, steering_rad, .. } = *command;
        if !(speed_mps.is_finite() && steering_rad.is_finite()) {
            return None;
        }
        Some(Setpoint {
            // A negative speed only brakes; sent to a car, it would mean the reverse gear.
            speed_mps: speed_mps.clamp(0.0, self.speed_limit_mps),
            steering_rad: steering_rad.clamp(-self.steering_limit_rad, self.steering_limit_rad),
            acceleration_mps2: self.acceleration_mps2,
        })
    }

    /// The car's own stop, `since_s` after it was commanded this speed: wheels straight, slower.
    pub fn stop(&self, speed_mps: f64, since_s: f64) -> Setpoint {
        let slower_mps = speed_mps - self.stop_deceleration_mps2 * since_s.max(0.0);
        let acceleration_mps2 =
            if self.names_acceleration { self.stop_deceleration_mps2 } else { 0.0 };
        Setpoint { speed_mps: slower_mps.max(0.0), steering_rad: 0.0, acceleration_mps2 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vehicle() -> Vehicle {
        let mut layers = config::Layers::maneuver("lane_change").unwrap();
        layers.set_vehicle("--vehicle", "ackermann").unwrap();
        layers.resolve().unwrap().vehicle
    }

    proptest! {
        #[test]
        fn no_command_leaves_the_car_s_limits(speed in any::<f64>(), angle in any::<f64>()) {
            let vehicle = vehicle();
            let command = Command { speed_mps: speed, steering_rad: angle, ..Command::default() };
            match Setpoints::new(&vehicle).of(&command) {
                None => prop_assert!(!(speed.is_finite() && angle.is_finite())),
                Some(setpoint) => {
                    prop_assert!((0.0..=vehicle.speed_limit_mps).contains(&setpoint.speed_mps));
                    prop_assert!(setpoint.steering_rad.abs() <= vehicle.steering_limit_rad);
                }
            }
        }

        #[test]
        fn a_stop_falls_straight_to_rest(speed in 0.0..20.0f64, ticks in 1..2000u32) {
            let setpoints = Setpoints::new(&vehicle());
            let mut now = speed;
            for _ in 0..ticks {
                let next = setpoints.stop(now, 0.01);
                prop_assert_eq!(next.steering_rad, 0.0);
                prop_assert!(next.speed_mps >= 0.0 && next.speed_mps <= now);
                prop_assert!(now - next.speed_mps <= setpoints.stop_deceleration_mps2 * 0.01 + 1e-12);
                now = next.speed_mps;
            }
            let expected = (speed - setpoints.stop_deceleration_mps2 * 0.01 * f64::from(ticks)).max(0.0);
            prop_assert!((now - expected).abs() < 1e-9);
        }
    }

    #[test]
    fn the_acceleration_is_named_where_it_is_wanted_and_bounded() {
        let mut vehicle = vehicle();
        let command = Command { speed_mps: 1.0, ..Command::default() };
        let named = |vehicle: &Vehicle| {
            let setpoints = Setpoints::new(vehicle);
            (
                setpoints.of(&command).unwrap().acceleration_mps2,
                setpoints.stop(1.0, 0.0).acceleration_mps2,
            )
        };
        assert_eq!(named(&vehicle), (0.0, 0.0));
        vehicle.ros2.drive_acceleration = true;
        let safety = vehicle.safety;
        assert_eq!(
            named(&vehicle),
            (safety.acceleration_limit_mps2, safety.stop_deceleration_mps2)
        );
        vehicle.safety.acceleration_limit_mps2 = f64::INFINITY;
        assert_eq!(named(&vehicle), (0.0, safety.stop_deceleration_mps2));
    }
}
