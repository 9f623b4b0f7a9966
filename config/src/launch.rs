//! The launch file: which processes make up a pipeline. One `[[process]]` each.
//!
//! The list of our own services is not known here: it is in one table next to the doorway,
//! `orchestrator/services.rs`.

use serde::{Deserialize, Serialize};

use crate::ConfigError;
use crate::presets::preset;

macro_rules! roles {
    ($($(#[$doc:meta])* $role:ident $name:literal $optional:literal,)+) => {
        /// The part that a process plays.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        pub enum Role { $($(#[$doc])* #[serde(rename = $name)] $role,)+ }

        impl Role {
            /// Every role.
            pub const ALL: &'static [Role] = &[$(Role::$role),+];

            /// The role's name in launch files.
            pub fn name(self) -> &'static str {
                match self { $(Role::$role => $name,)+ }
            }

            /// Whether a pipeline can do without it.
            pub fn is_optional(self) -> bool {
                match self { $(Role::$role => $optional,)+ }
            }
        }
    };
}

// Each with its name in launch files, and whether a pipeline can do without it.
roles! {
    /// Publishes odometry, obeys commands, paces the loop.
    Vehicle "vehicle" false,
    /// Passes raw commands on as commands, within limits.
    Supervisor "supervisor" false,
    /// Turns odometry into raw commands.
    Controller "controller" false,
    /// Proposes parameters, learns from reports.
    Trainer "trainer" false,
    /// Records all messages.
    Recorder "recorder" true,
}

impl Role {
    /// The role with this name.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|role| role.name() == name)
    }
}

/// One process of the pipeline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProcessEntry {
    /// The part it plays.
    pub role: Role,
    /// A program of the user's in that role; if absent, our own service.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command: Option<String>,
    /// Our own service in that role, if it is not the usual one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub service: Option<String>,
    /// Whether the same request always gives the same drive.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deterministic: Option<bool>,
    /// Restarts that it is allowed in ten seconds, if that differs from the other processes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub restart_budget: Option<u32>,
    /// Size at which the recorder continues in another file; only for our recorder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub split_bytes: Option<u64>,
}

impl ProcessEntry {
    /// Whether the same request gives the same drive: for our services it does, for a user's program only if its entry
    /// says so.
    pub fn is_deterministic(&self) -> bool {
        self.deterministic.unwrap_or(self.command.is_none())
    }

    /// Whether it is the service of ours that fills this role unless another is named; for a vehicle, our simulator.
    pub fn is_usual(&self) -> bool {
        let usual = match self.role {
            Role::Vehicle => "simulator",
            role => role.name(),
        };
        self.command.is_none() && self.service.as_deref().is_none_or(|name| name == usual)
    }
}

/// A launch file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Launch {
    /// The processes, in the order in which they start.
    pub process: Vec<ProcessEntry>,
}

impl Launch {
    /// The embedded launch file of a training.
    pub fn train() -> Self {
        let preset = preset("launch/train.toml").expect("embedded");
        Self::parse(preset.path, preset.text).expect("the preset is checked by a test")
    }

    /// Parses a launch file; `origin` names it in errors.
    ///
    /// # Errors
    /// At a syntax error or an unknown key, with its line; if a role is missing or filled twice.
    pub fn parse(origin: &str, text: &str) -> Result<Self, ConfigError> {
        let launch: Self = toml::from_str(text).map_err(|error| {
            let offset = error.span().map_or(0, |span| span.start).min(text.len());
            let line = text.as_bytes()[..offset].iter().filter(|byte| **byte == b'\n').count() + 1;
            ConfigError::new(format!("{origin}:{line}"), "", error.message().to_owned())
        })?;
        for role in Role::ALL {
            let times = launch.process.iter().filter(|entry| entry.role == *role).count();
            if times != 1 && !(times == 0 && role.is_optional()) {
                let problem = format!(
                    "the role {} is filled {times} times, but must be filled once",
                    role.name()
                );
                return Err(ConfigError::new(origin, "process", problem));
            }
        }
        Ok(launch)
    }

    /// Adds our recorder, if there is none yet; `split_bytes` limits the size of its files.
    ///
    /// It starts first, and so stops last: it receives everything, from the first sign of life to the outcome.
    pub fn record(&mut self, split_bytes: Option<u64>) {
        let of_recorder = |entry: &&mut ProcessEntry| entry.role == Role::Recorder;
        if let Some(entry) = self.process.iter_mut().find(of_recorder) {
            entry.split_bytes = split_bytes.or(entry.split_bytes);
            return;
        }
        let entry = ProcessEntry {
            role: Role::Recorder,
            command: None,
            service: None,
            deterministic: None,
            restart_budget: None,
            split_bytes,
        };
        self.process.insert(0, entry);
    }

    /// Whether vehicle, controller and supervisor are our usual ones: then their drives can also be computed by plain
    /// calls.
    pub fn ring_is_ours(&self) -> bool {
        self.first_of_ring_not_ours().is_none()
    }

    /// The first role of vehicle, controller and supervisor that our usual service does not fill.
    pub fn first_of_ring_not_ours(&self) -> Option<Role> {
        let ring = [Role::Vehicle, Role::Controller, Role::Supervisor];
        let other = |role: &Role| self.process.iter().any(|it| it.role == *role && !it.is_usual());
        ring.into_iter().find(other)
    }

    /// Whether the same request always gives the same drive. An adapter of ours drives a car that is not.
    pub fn repeats(&self) -> bool {
        let is_adapter = |it: &ProcessEntry| {
            it.role == Role::Vehicle && !it.is_usual() && it.deterministic.is_none()
        };
        self.process.iter().all(|entry| entry.is_deterministic() && !is_adapter(entry))
    }

    /// Whether the run is recorded from its first tick on.
    pub fn is_recorded(&self) -> bool {
        self.process.iter().any(|entry| entry.role == Role::Recorder)
    }

    /// Puts another service of ours in a role, if no command fills it and no service is named.
    pub fn prefer_service(&mut self, role: Role, service: &str) {
        for entry in self.process.iter_mut().filter(|entry| entry.role == role) {
            if entry.command.is_none() && entry.service.is_none() {
                entry.service = Some(service.to_owned());
            }
        }
    }

    /// Puts another service of ours in a role, whatever fills it now; `deterministic` says whether the same request
    /// always gives the same drive with it.
    pub fn fill(&mut self, role: Role, service: &str, deterministic: bool) {
        for entry in self.process.iter_mut().filter(|entry| entry.role == role) {
            entry.command = None;
            entry.service = Some(service.to_owned());
            entry.deterministic = Some(deterministic);
        }
    }

    /// Puts a command in a role, from `ROLE=COMMAND`; `deterministic` says whether the same request always gives the same
    /// drive with it.
    ///
    /// # Errors
    /// If there is no `=`, no such role, or no command.
    pub fn replace(&mut self, replacement: &str, deterministic: bool) -> Result<(), ConfigError> {
        let origin = format!("--replace {replacement}");
        let Some((role, command)) = replacement.split_once('=') else {
            return Err(ConfigError::new(origin, "", "has no '='; write --replace ROLE='COMMAND'"));
        };
        let Some(role) = Role::parse(role.trim()) else {
            let names: Vec<&str> = Role::ALL.iter().map(|role| role.name()).collect();
            let names = names.join(", ");
            return Err(ConfigError::new(origin, "", format!("unknown role; there are {names}")));
        };
        if command.trim().is_empty() {
            return Err(ConfigError::new(origin, role.name(), "the command is empty"));
        }
        if !self.process.iter().any(|entry| entry.role == role) {
            let problem = "no process has this role; --record adds the recorder";
            return Err(ConfigError::new(origin, role.name(), problem));
        }
        for entry in self.process.iter_mut().filter(|entry| entry.role == role) {
            entry.command = Some(command.to_owned());
            entry.service = None;
            entry.deterministic = deterministic.then_some(true);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn no_text_makes_the_parser_panic(text in ".{0,200}", role in "(vehicle|pilot|[a-z=' ]{0,20})") {
            let _ = Launch::parse("x", &text);
            let _ = Launch::parse("x", &format!("[[process]]\nrole = '{role}'\n{text}"));
            let _ = Launch::train().replace(&format!("{role}={text}"), false);
        }
    }

    #[test]
    fn the_preset_fills_each_role_once() {
        for role in Role::ALL {
            let text =
                toml::to_string(&std::collections::BTreeMap::from([("role", role)])).unwrap();
            assert_eq!(text.trim(), format!("role = {:?}", role.name()));
            assert_eq!(Role::parse(role.name()), Some(*role));
        }
        let launch = Launch::train();
        assert_eq!(launch.process.len(), Role::ALL.len() - 1);
        assert!(launch.process.iter().all(ProcessEntry::is_deterministic));
    }

    #[test]
    fn mistakes_are_named() {
        let check = |text: &str, part: &str| {
            let message = Launch::parse("my.toml", text).unwrap_err().to_string();
            assert!(message.contains(part), "{message:?} lacks {part:?}");
        };
        check("[[process]]\nrole = 'pilot'", "my.toml:2");
        check("[[process]]\nrole = 'vehicle'\ncolour = 1", "my.toml:3");
        check("[[process]]\nrole = 'vehicle'", "supervisor is filled 0 times");
        check("process = [", "my.toml:1");
    }

    #[test]
    fn a_replacement_takes_one_role() {
        let mut launch = Launch::train();
        assert!(launch.ring_is_ours() && launch.repeats());
        launch.replace("vehicle=python3 car.py --port=3", false).unwrap();
        let vehicle = launch.process.iter().find(|entry| entry.role == Role::Vehicle).unwrap();
        assert_eq!(vehicle.command.as_deref(), Some("python3 car.py --port=3"));
        assert!(!vehicle.is_deterministic() && !launch.ring_is_ours() && !launch.repeats());
        launch.replace("vehicle=python3 car.py", true).unwrap();
        assert!(launch.repeats() && !launch.ring_is_ours());
        for wrong in ["vehicle", "pilot=x", "vehicle= ", "recorder=x"] {
            assert!(launch.replace(wrong, false).is_err(), "{wrong}");
        }
    }

    #[test]
    fn an_adapter_of_ours_is_no_simulator() {
        let mut launch = Launch::train();
        launch.prefer_service(Role::Vehicle, "simulator");
        launch.prefer_service(Role::Trainer, "schedule");
        assert!(launch.ring_is_ours() && launch.repeats());
        launch.fill(Role::Vehicle, "ros2-vehicle", false);
        assert!(!launch.ring_is_ours() && !launch.repeats());
        // As a launch file names it.
        let vehicle = launch.process.iter_mut().find(|entry| entry.role == Role::Vehicle).unwrap();
        vehicle.deterministic = None;
        assert!(!launch.repeats());
    }

    #[test]
    fn a_recorder_is_added_once_and_survives_the_file() {
        let mut launch = Launch::train();
        assert!(!launch.is_recorded());
        launch.record(None);
        launch.record(Some(1 << 20));
        assert!(launch.is_recorded());
        assert_eq!(launch.process.len(), Role::ALL.len());
        assert_eq!(launch.process[0].split_bytes, Some(1 << 20));
        let text = toml::to_string(&launch).unwrap();
        assert_eq!(Launch::parse("launch.toml", &text).unwrap(), launch);
        let twice = format!("{text}\n[[process]]\nrole = 'recorder'\n");
        assert!(Launch::parse("launch.toml", &twice).is_err());
    }
}
