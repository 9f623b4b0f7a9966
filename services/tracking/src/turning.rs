//! How a car turns for the angle of its wheels, and how fast tyres slip before they turn it.

use config::Vehicle;

/// The yaw rate of a car whose tyres slip a little, as a kinematic single track with two corrections:
///
/// ρ = v·tan(δ)/(L + K·v²),  T·ṙ = ρ − r  with  T = k·v
///
/// Speed v, angle δ of the road wheels, wheelbase L, yaw rate r. K is the gradient of understeer, the slip of the front axle
/// less that of the rear one for each m/s² of lateral acceleration (Milliken and Milliken, Race Car Vehicle Dynamics, 1995,
/// ch. 5). The lag is that of the single track with linear tyres of one slip angle k for each m/s² at both axles and the
/// inertia of two masses above them (J = m·a·b), in which the equation of r stands by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turning {
    wheelbase_m: f64,
    understeer_s2pm: f64,
    lag_s2pm: f64,
    yaw_rate_radps: f64,
    /// The yaw rate that the wheels asked for last.
    asked_radps: f64,
}

/// What does not change from step to step at one speed.
#[derive(Debug, Clone, Copy)]
pub struct TurningStep {
    held_s: f64,
    lag_s: f64,
    /// The share that dies away in the step of what the yaw rate is off.
    gone: f64,
}

impl Turning {
    /// Of a vehicle at rest.
    pub fn new(vehicle: &Vehicle) -> Self {
        Self::with(vehicle.wheelbase_m, vehicle.understeer_s2pm, vehicle.yaw_lag_s2pm)
    }

    /// Of a car with a wheelbase L, a gradient of understeer K and a lag k for each m/s, at rest.
    pub fn with(wheelbase_m: f64, understeer_s2pm: f64, lag_s2pm: f64) -> Self {
        Self { wheelbase_m, understeer_s2pm, lag_s2pm, yaw_rate_radps: 0.0, asked_radps: 0.0 }
    }

    /// The wheelbase of a car without tyres that slip that drives the same circles at this speed: L + K·v².
    #[inline]
    pub fn wheelbase_m(&self, speed_mps: f64) -> f64 {
        self.wheelbase_m + self.understeer_s2pm * speed_mps * speed_mps
    }

    /// The yaw rate that it comes to while its wheels stay so: ρ.
    #[inline]
    pub fn asked_radps(&self, steering_rad: f64, speed_mps: f64) -> f64 {
        self.asked_by(libm::tan(steering_rad), speed_mps)
    }

    /// The lag of its yaw rate at this speed: T.
    #[inline]
    pub fn late_s(&self, speed_mps: f64) -> f64 {
        self.lag_s2pm * speed_mps.max(0.0)
    }

    /// Makes it turn as it does now, and its wheels ask for what they do.
    pub fn set(&mut self, yaw_rate_radps: f64, asked_radps: f64) {
        (self.yaw_rate_radps, self.asked_radps) = (yaw_rate_radps, asked_radps);
    }

    /// The yaw rate.
    pub fn yaw_rate_radps(&self) -> f64 {
        self.yaw_rate_radps
    }

    /// Drives for `held_s`, until the wheels are at an angle; returns by how much the car turns.
    #[inline]
    pub fn turn(&mut self, steering_rad: f64, speed_mps: f64, held_s: f64) -> f64 {
        self.turn_to(self.asked_radps(steering_rad, speed_mps), speed_mps, held_s)
    }

    /// The same where the wheels turn evenly from one angle to another, without lag, too.
    #[inline]
    pub fn turn_evenly(&mut self, wheels_rad: [f64; 2], speed_mps: f64, held_s: f64) -> f64 {
        let asked_radps = self.asked_by(self.tangent(wheels_rad), speed_mps);
        self.turn_to(asked_radps, speed_mps, held_s)
    }

    /// The tangent of the angle that counts while the wheels turn evenly from one angle to another: without lag that in
    /// the middle, for what they ask for is then theirs from the start; with lag the last one, for its way there is known.
    #[inline]
    pub fn tangent(&self, [from_rad, to_rad]: [f64; 2]) -> f64 {
        libm::tan(if self.lag_s2pm > 0.0 { to_rad } else { 0.5 * (from_rad + to_rad) })
    }

    /// The yaw rate that wheels ask for whose angle has this tangent.
    #[inline]
    pub fn asked_by(&self, tangent: f64, speed_mps: f64) -> f64 {
        speed_mps * tangent / self.wheelbase_m(speed_mps)
    }

    /// The same where the yaw rate is known that the wheels ask for in the end. What they ask for changes evenly, and the
    /// solution is exact for that; without lag, they are there from the start.
    #[inline]
    pub fn turn_to(&mut self, asked_radps: f64, speed_mps: f64, held_s: f64) -> f64 {
        self.turn_over(asked_radps, &self.step(speed_mps, held_s))
    }

    /// A step of this length at a speed, for [`Turning::turn_over`].
    #[inline]
    pub fn step(&self, speed_mps: f64, held_s: f64) -> TurningStep {
        let lag_s = self.late_s(speed_mps);
        let gone = if lag_s == 0.0 { 1.0 } else { -libm::expm1(-held_s / lag_s) };
        TurningStep { held_s, lag_s, gone }
    }

    /// As [`Turning::turn_to`], in one of many steps of the same length at the same speed.
    #[inline]
    pub fn turn_over(&mut self, asked_radps: f64, step: &TurningStep) -> f64 {
        let TurningStep { held_s, lag_s, gone } = *step;
        if lag_s == 0.0 {
            (self.yaw_rate_radps, self.asked_radps) = (asked_radps, asked_radps);
            return asked_radps * held_s;
        }
        let before_radps = std::mem::replace(&mut self.asked_radps, asked_radps);
        // Behind a ramp for long, the yaw rate is this far behind it; what is off that dies away.
        let behind_radps = (asked_radps - before_radps) / held_s * lag_s;
        let off_radps = self.yaw_rate_radps - before_radps + behind_radps;
        self.yaw_rate_radps = asked_radps - behind_radps + off_radps * (1.0 - gone);
        (0.5 * (before_radps + asked_radps) - behind_radps) * held_s + off_radps * lag_s * gone
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turning(sets: &[&str]) -> Turning {
        let mut layers = config::Layers::maneuver("lane_change").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        Turning::new(&layers.resolve().unwrap().vehicle)
    }

    #[test]
    fn a_turn_is_exact_however_long_it_is() {
        let drive = |steps: u32| {
            let mut it = turning(&["vehicle.yaw_lag_s2pm=0.005"]);
            it.set(0.2, 0.1);
            let held_s = 0.09 / f64::from(steps);
            let asked = |step: u32| 0.1 - 0.5 * f64::from(step) / f64::from(steps);
            let turned: f64 = (1..=steps).map(|step| it.turn_to(asked(step), 6.0, held_s)).sum();
            [it.yaw_rate_radps(), turned]
        };
        let (one, many) = (drive(1), drive(1000));
        assert!((one[0] - many[0]).abs() < 1e-12 && (one[1] - many[1]).abs() < 1e-12);
        // The equation itself, by small steps of Euler's.
        let (mut rate, mut turned) = (0.2, 0.0);
        for step in 0..90_000 {
            turned += rate * 1e-6;
            rate += (0.1 - 0.5 * f64::from(step) / 9e4 - rate) / 0.03 * 1e-6;
        }
        assert!((one[0] - rate).abs() < 1e-4 && (one[1] - turned).abs() < 1e-5, "{one:?}");
    }

    #[test]
    fn a_car_without_lag_or_that_hardly_moves_turns_as_its_wheels_ask() {
        let lag = "vehicle.yaw_lag_s2pm=0.005";
        for (sets, speed_mps, turns) in
            [(&[][..], 6.0, 0.003), (&[lag][..], 0.0, 0.003), (&[lag][..], 1e-9, 0.002)]
        {
            let mut it = turning(sets);
            it.set(0.1, 0.1);
            let turned = it.turn_to(0.3, speed_mps, 0.01);
            assert!((turned - turns).abs() < 1e-9 && (it.yaw_rate_radps() - 0.3).abs() < 1e-8);
        }
    }

    #[test]
    fn a_car_that_understeers_drives_wider_circles_the_faster_it_is() {
        let (neutral, under) = (turning(&[]), turning(&["vehicle.understeer_s2pm=0.002"]));
        assert_eq!(neutral.asked_radps(0.1, 6.0), 6.0 * libm::tan(0.1) / 2.875);
        assert_eq!(under.wheelbase_m(0.0), 2.875);
        assert!((under.wheelbase_m(6.0) - 2.947).abs() < 1e-12);
        assert!((under.asked_radps(0.1, 6.0) * 2.947 - 6.0 * libm::tan(0.1)).abs() < 1e-12);
    }
}
