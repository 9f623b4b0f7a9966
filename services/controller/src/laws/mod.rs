//! Control laws: what turns the sight of one tick into a command.
//!
//! A law is a file of this folder with its row in the table below, and a file of `config/laws` that names its
//! parameters and settings. Everything that a law may look at is in [`Sight`]; what a law does not ask for is not
//! computed.

mod excitation;
mod held_steering;
mod lqr;
mod mpc;
mod paper;
mod pure_pursuit;
mod stanley;

use config::{Parameters, RunConfig};

use crate::Sight;
use crate::compensation::Compensation;
use held_steering::HeldSteering;

/// What a law wants: forward speed, yaw rate, steering angle.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RawCommand {
    /// v, m/s.
    pub speed_mps: f64,
    /// ω_s, rad/s: the wanted yaw rate, before any filter of the law's.
    pub yaw_rate_radps: f64,
    /// φ, rad: the angle of the road wheels, positive to the left, within `controller.steering_limit_rad`.
    pub steering_rad: f64,
}

impl RawCommand {
    /// Steers, and follows the reference's speed, faster by `kv` (1/s) for each metre that the car is late:
    /// v = v_ref + Kv·e_s. The yaw rate is that of a car with these wheels: the command reports it, but the wheels decide.
    fn following(sight: &Sight, kv: f64, steering_rad: f64) -> Self {
        Self {
            speed_mps: sight.reference_speed_mps() + kv * sight.lateness_m(),
            yaw_rate_radps: sight.speed_mps * libm::tan(steering_rad) / sight.wheelbase_m(),
            steering_rad,
        }
    }
}

/// The numbers that a law needs to go on after its process was restarted during a drive in real time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LawState {
    numbers: [f64; LawState::MOST],
    count: usize,
}

impl LawState {
    /// How many numbers a state can hold.
    pub const MOST: usize = 64;

    /// A state of these numbers.
    ///
    /// # Panics
    /// If there are more than [`LawState::MOST`].
    pub fn of(numbers: &[f64]) -> Self {
        let mut all = [0.0; Self::MOST];
        all[..numbers.len()].copy_from_slice(numbers);
        Self { numbers: all, count: numbers.len() }
    }

    /// The numbers.
    pub fn numbers(&self) -> &[f64] {
        &self.numbers[..self.count]
    }
}

/// A control law with its state.
///
/// Cloned for every vehicle of a fleet and read in every tick: large parts belong in a box, so that they do not enlarge
/// the slots of the other laws.
trait Law: Clone {
    /// The law of a configuration, at the start of a drive.
    fn new(config: &RunConfig) -> Self;

    /// Forgets everything except the steering angle that was commanded last: 0 at the start of a drive, another value
    /// when a stopped vehicle drives on.
    fn restart(&mut self, steering_rad: f64);

    /// What a successor needs to go on.
    fn state(&self) -> LawState;

    /// Goes on from another process's [`Law::state`]. The numbers come from outside: they are finite, and nothing else
    /// is known about them.
    fn resume(&mut self, state: &LawState);

    /// One tick: the command, with the parameters in the order of the law's file in `config/laws`.
    fn command(&mut self, parameters: &Parameters, sight: &Sight) -> RawCommand;
}

/// The table of laws: the name of the file in `config/laws`, and the type that commands.
macro_rules! laws {
    ($($name:literal => $kind:ident($law:ty)),+ $(,)?) => {
        /// The law of a configuration: one row of the table, chosen once. A tick costs one branch that always goes the
        /// same way.
        #[derive(Debug, Clone)]
        enum Kind {
            $($kind($law)),+
        }

        impl Kind {
            fn new(config: &RunConfig) -> Self {
                match config.law.name.as_str() {
                    $($name => Self::$kind(Law::new(config)),)+
                    other => panic!("the law {other} has a file in config/laws but no row here"),
                }
            }

            fn restart(&mut self, steering_rad: f64) {
                match self { $(Self::$kind(law) => law.restart(steering_rad)),+ }
            }

            fn state(&self) -> LawState {
                match self { $(Self::$kind(law) => law.state()),+ }
            }

            fn resume(&mut self, state: &LawState) {
                match self { $(Self::$kind(law) => law.resume(state)),+ }
            }

            #[inline]
            fn command(&mut self, parameters: &Parameters, sight: &Sight) -> RawCommand {
                match self { $(Self::$kind(law) => law.command(parameters, sight)),+ }
            }
        }

        #[cfg(test)]
        const NAMES: &[&str] = &[$($name),+];
    };
}

laws! {
    "excitation" => Excitation(excitation::Excitation),
    "lqr" => Lqr(lqr::Lqr),
    "mpc" => Mpc(mpc::Mpc),
    "paper" => Paper(paper::Paper),
    "pure_pursuit" => PurePursuit(pure_pursuit::PurePursuit),
    "stanley" => Stanley(stanley::Stanley),
}

/// The control law of a configuration, with its state.
#[derive(Debug, Clone)]
pub struct ControlLaw {
    law: Kind,
    /// For a car whose steering is late or not aligned.
    compensation: Option<Box<Compensation>>,
}

impl ControlLaw {
    /// The law of a configuration, at the start of a drive.
    ///
    /// # Panics
    /// If no law has that name; a resolved configuration names one.
    pub fn new(config: &RunConfig) -> Self {
        Self { law: Kind::new(config), compensation: Compensation::new(config).map(Box::new) }
    }

    /// Returns to the start of a drive.
    pub fn reset(&mut self) {
        self.restart(0.0);
    }

    /// Forgets everything except the steering angle that was commanded last.
    pub fn restart(&mut self, steering_rad: f64) {
        let Some(compensation) = &mut self.compensation else {
            return self.law.restart(steering_rad);
        };
        compensation.restart(steering_rad);
        self.law.restart(compensation.wanted_rad(steering_rad));
    }

    /// What a successor needs to go on.
    pub fn state(&self) -> LawState {
        let law = self.law.state();
        self.compensation.as_ref().map_or(law, |it| it.add_to(&law))
    }

    /// Goes on from another process's [`ControlLaw::state`].
    pub fn resume(&mut self, state: &LawState) {
        let count = self.law.state().numbers().len();
        if let Some(compensation) = &mut self.compensation {
            compensation.resume(state, count);
        }
        self.law.resume(state);
    }

    /// One tick of the law.
    #[inline]
    pub fn command(&mut self, parameters: &Parameters, sight: &Sight) -> RawCommand {
        let Some(compensation) = &mut self.compensation else {
            return self.law.command(parameters, sight);
        };
        let mut reference = sight.reference().clone();
        let ahead = compensation.look_ahead(sight, &mut reference);
        compensation.give(self.law.command(parameters, &ahead))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;
    use tracking::{Pose, Reference};

    /// With a car whose steering is late, and a law that knows it, or without.
    fn config(law: &str, late: bool) -> RunConfig {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set_law("test", law).unwrap();
        layers.set(&format!("controller.compensate_dead_time={late}")).unwrap();
        layers.set("vehicle.steering_delay_s=0.2").unwrap();
        layers.resolve().unwrap()
    }

    /// Every law, with and without compensation.
    fn all() -> impl Iterator<Item = (&'static str, RunConfig)> {
        NAMES.iter().flat_map(|name| [true, false].map(|late| (*name, config(name, late))))
    }

    #[test]
    fn table_and_files_name_the_same_laws() {
        let mut known: Vec<&str> = config::names_in("laws").collect();
        let mut rows = NAMES.to_vec();
        known.sort_unstable();
        rows.sort_unstable();
        assert_eq!(known, rows);
    }

    /// The commands of ten ticks, with the car next to the path.
    fn drive(law: &mut ControlLaw, config: &RunConfig, from_tick: u64) -> Vec<RawCommand> {
        let mut reference = Reference::new(config);
        let parameters = config.law.defaults();
        (from_tick..from_tick + 10)
            .map(|tick| {
                let pose = Pose { x_m: 0.01 * tick as f64, y_m: 0.1, yaw_rad: 0.02 };
                let reference_pose = reference.advance(tick as f64, pose);
                law.command(
                    &parameters,
                    &Sight::new(config, &reference, tick as f64, reference_pose, pose, 1.0, 0.1),
                )
            })
            .collect()
    }

    #[test]
    fn every_law_goes_on_where_its_predecessor_was() {
        for (name, config) in all() {
            let mut law = ControlLaw::new(&config);
            drive(&mut law, &config, 100);
            let mut successor = ControlLaw::new(&config);
            successor.resume(&law.state());
            assert_eq!(
                drive(&mut successor, &config, 110),
                drive(&mut law, &config, 110),
                "{name}"
            );
            // At the start of a drive nothing is left of the last one.
            law.reset();
            let mut fresh = ControlLaw::new(&config);
            assert_eq!(drive(&mut law, &config, 0), drive(&mut fresh, &config, 0), "{name}");
        }
    }

    #[test]
    fn no_law_steers_beyond_the_limit_or_fails_on_a_strange_state() {
        for (name, config) in all() {
            let limit_rad = config.controller.steering_limit_rad;
            let mut law = ControlLaw::new(&config);
            for state in [LawState::of(&[]), LawState::of(&[1e300; 64]), LawState::of(&[-1e300; 3])]
            {
                law.resume(&state);
                for command in drive(&mut law, &config, 0) {
                    assert!(command.steering_rad.abs() <= limit_rad, "{name}: {command:?}");
                    assert!(command.speed_mps.is_finite(), "{name}: {command:?}");
                }
            }
        }
    }
}
