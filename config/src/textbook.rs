//! Textbook sets: what a user would type in by hand, for tuned sets to be compared with. And whether a drive is one that
//! the paper made.

use crate::law::{LawConfig, Parameters, Scale};
use crate::{Layers, RunConfig, Vehicle};

/// The laws of the textbook sets beside the configuration's own.
const LAWS: [&str; 3] = ["pure_pursuit", "stanley", "paper"];

/// A textbook set, and the configuration to drive it with.
#[derive(Debug, Clone, PartialEq)]
pub struct TextbookSet {
    /// The configuration with the set's law.
    pub config: RunConfig,
    /// The set.
    pub parameters: Parameters,
    /// Whether the dead time of the steering is compensated; `None` if there is none.
    pub compensated: Option<bool>,
}

impl RunConfig {
    /// The textbook sets: the defaults in the files of this law, pure pursuit, Stanley's and the paper's, with lengths
    /// that fit the car's wheelbase, and with the paper's choice where it has one for this manoeuvre. Each comes with and
    /// without compensation, if the steering has a dead time or a lag.
    pub fn textbook_sets(&self) -> Vec<TextbookSet> {
        let own = LAWS.into_iter().filter(|name| *name != self.law.name);
        let names = std::iter::once(self.law.name.as_str()).chain(own);
        let is_late = self.vehicle.steering_delay_s + self.vehicle.steering_lag_s > 0.0;
        let ways: &[Option<bool>] = if is_late { &[Some(true), Some(false)] } else { &[None] };
        let mut sets = Vec::new();
        for law in names.filter_map(crate::law::preset) {
            for &compensated in ways {
                let mut config = self.clone();
                config.law = fitted(&law, self.vehicle.wheelbase_m);
                config.law_preset.clone_from(&law.name);
                config.grid =
                    config.law.parameters.iter().map(|it| (it.key.clone(), it.grid)).collect();
                if let Some(compensated) = compensated {
                    config.controller.compensate_dead_time = compensated;
                }
                let defaults: Vec<f64> =
                    config.law.parameters.iter().map(|parameter| parameter.default).collect();
                let parameters = config.paper_set().unwrap_or(Parameters::of(&defaults));
                sets.push(TextbookSet { config, parameters, compensated });
            }
        }
        sets
    }

    /// Whether path, car and law are those for which the paper has figures. Its car may be the kinematic model or the
    /// dynamic one.
    pub fn has_figures_of_the_paper(&self) -> bool {
        if self.paper.is_empty() || self.law.name != "paper" || !self.has_the_paper_s_car() {
            return false;
        }
        let preset = Layers::maneuver(&self.maneuver).and_then(Layers::resolve);
        preset.is_ok_and(|preset| {
            preset.path == self.path && preset.reference.speed_mps == self.reference.speed_mps
        })
    }

    fn has_the_paper_s_car(&self) -> bool {
        let preset = self.vehicle_preset.as_str();
        let known = ["tesla_model_3", "tesla_model_3_dynamic", "tesla_model_3_guarded"];
        if !known.contains(&preset) {
            return false;
        }
        let Ok(car) = Layers::vehicle_of_file(preset) else { return false };
        // What differs here is how the car is driven and watched, not what it is.
        let other = Vehicle {
            gear_engaged: car.gear_engaged,
            safety: car.safety,
            ros2: car.ros2.clone(),
            gains: car.gains.clone(),
            ..self.vehicle.clone()
        };
        other == car
    }
}

/// A law with its lengths scaled to a car of this wheelbase.
pub(crate) fn fitted(law: &LawConfig, wheelbase_m: f64) -> LawConfig {
    let mut law = law.clone();
    for parameter in &mut law.parameters {
        let Some(made_for_m) = parameter.for_wheelbase_m else { continue };
        let ratio = wheelbase_m / made_for_m;
        for length_m in [&mut parameter.min, &mut parameter.max, &mut parameter.default] {
            *length_m *= ratio;
        }
        parameter.grid.min *= ratio;
        parameter.grid.max *= ratio;
        if parameter.scale == Scale::Linear {
            parameter.grid.step *= ratio;
        }
        parameter.for_wheelbase_m = Some(wheelbase_m);
    }
    law
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(maneuver: &str, sets: &[&str]) -> RunConfig {
        let mut layers = Layers::maneuver(maneuver).unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        layers.resolve().unwrap()
    }

    #[test]
    fn the_paper_has_figures_for_its_own_path_car_and_law_alone() {
        let has = |sets: &[&str]| config("lane_change", sets).has_figures_of_the_paper();
        assert!(has(&[]));
        assert!(has(&["vehicle.gear_engaged=true", "learning.episodes=2"]));
        for other in [
            "vehicle.wheelbase_m=3.306",
            "vehicle.steering_delay_s=0.1",
            "vehicle_preset=f1tenth",
            "law_preset=stanley",
            "reference.speed_mps=2.0",
        ] {
            assert!(!has(&[other]), "{other}");
        }
        assert!(!config("smooth_lane", &[]).has_figures_of_the_paper());
    }

    #[test]
    fn textbook_sets_are_the_defaults_of_the_laws_fitted_to_the_car() {
        let names = |config: &RunConfig| {
            let sets = config.textbook_sets();
            let name = |it: &TextbookSet| (it.config.law.name.clone(), it.compensated);
            sets.iter().map(name).collect::<Vec<_>>()
        };
        let plain = config("smooth_lane", &["law_preset=stanley"]);
        let wanted = ["stanley", "pure_pursuit", "paper"].map(|name| (name.to_owned(), None));
        assert_eq!(names(&plain), wanted);
        let late = config("smooth_lane", &["vehicle.steering_lag_s=0.1"]);
        let both = [Some(true), Some(false)];
        let wanted = ["paper", "pure_pursuit", "stanley"];
        let wanted = wanted.iter().flat_map(|name| both.map(|it| ((*name).to_owned(), it)));
        assert_eq!(names(&late), wanted.collect::<Vec<_>>());
        let small = config("smooth_lane", &["vehicle_preset=f1tenth"]).textbook_sets();
        let of_law = |name: &str| small.iter().find(|it| it.config.law.name == name).unwrap();
        let pure_pursuit = of_law("pure_pursuit");
        assert_eq!(pure_pursuit.parameters.0[1], 2.0 * 0.3302 / 2.875);
        assert_eq!(pure_pursuit.parameters.0[2], 0.8 * (0.3302 / 2.875));
        let mut fitted = Layers::maneuver("smooth_lane").unwrap();
        fitted.set("vehicle_preset=f1tenth").unwrap();
        fitted.set("law_preset=pure_pursuit").unwrap();
        assert_eq!(pure_pursuit.config.law, fitted.resolve().unwrap().law);
    }
}
