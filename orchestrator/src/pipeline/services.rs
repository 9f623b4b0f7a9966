//! Our own services: what `pathtune service NAME` runs, and which of them can fill a role.
//!
//! The table itself is in the binary, next to its `main`, because this library links no service.

use config::launch::{Launch, ProcessEntry, Role};

use crate::pipeline::process::Program;
use crate::words::{Failure, known};

/// One of our own services: a row of the table.
#[derive(Debug, Clone, Copy)]
pub struct Service {
    /// Its name: `pathtune service NAME`.
    pub name: &'static str,
    /// The role that it can fill; `None` for a helper.
    pub role: Option<Role>,
    /// Why this build does not contain it, and what to do about that.
    pub missing: Option<&'static str>,
    /// Runs it to its end, with the words after its name.
    pub run: fn(&[String]) -> Result<(), Failure>,
}

impl Service {
    /// A service that is in every build.
    pub const fn new(
        name: &'static str,
        role: Option<Role>,
        run: fn(&[String]) -> Result<(), Failure>,
    ) -> Self {
        Self { name, role, missing: None, run }
    }
}

/// The table of our own services. The first that can fill a role is the usual one for it.
#[derive(Debug, Clone, Copy)]
pub struct Services(pub &'static [Service]);

impl Services {
    /// Runs the service of this name to its end.
    ///
    /// # Errors
    /// If there is no service of this name; otherwise, whatever error ends it.
    pub fn run(self, name: &str, words: &[String]) -> Result<(), Failure> {
        match self.0.iter().find(|service| service.name == name) {
            Some(service) => (service.run)(words),
            None => {
                let names = self.0.iter().map(|service| service.name);
                Err(Failure::User(format!("no service {name}; {}", known(name, names))))
            }
        }
    }

    /// The service that fills a role unless another one is named.
    ///
    /// # Panics
    /// If no service in the table can fill it.
    pub fn usual(self, role: Role) -> &'static Service {
        self.filling(role).next().expect("the table has a service for each role")
    }

    /// The service of this name, to fill a role.
    ///
    /// # Errors
    /// If it cannot fill the role, or this build does not contain it. The error says what to do.
    pub fn named(self, role: Role, name: &str) -> Result<&'static Service, String> {
        let Some(service) = self.filling(role).find(|service| service.name == name) else {
            let names = self.filling(role).map(|service| service.name);
            let known = known(name, names);
            return Err(format!("{name} cannot be the {}; {known}", role.name()));
        };
        match service.missing {
            None => Ok(service),
            Some(why) => Err(why.to_owned()),
        }
    }

    /// Checks the services that a launch file names; `origin` names the file in errors.
    pub(crate) fn check(self, origin: &str, launch: &Launch) -> Result<(), Failure> {
        for entry in launch.process.iter().filter(|entry| entry.command.is_none()) {
            if let Some(name) = &entry.service {
                self.named(entry.role, name)
                    .map_err(|why| Failure::User(format!("{origin}: process.service: {why}")))?;
            }
        }
        Ok(())
    }

    /// The program that an entry of a checked launch file runs.
    pub(crate) fn program(self, entry: &ProcessEntry) -> Program {
        match (&entry.command, &entry.service) {
            (Some(command), _) => Program::Command(command.clone()),
            (None, Some(name)) => {
                let service = self.named(entry.role, name);
                Program::Service(service.expect("the launch file was checked").name)
            }
            (None, None) => Program::Service(self.usual(entry.role).name),
        }
    }

    fn filling(self, role: Role) -> impl Iterator<Item = &'static Service> {
        self.0.iter().filter(move |service| service.role == Some(role))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SERVICES: Services = Services(&[
        Service::new("simulator", Some(Role::Vehicle), |_| Ok(())),
        Service {
            missing: Some("build it with --features sea"),
            ..Service::new("boat", Some(Role::Vehicle), |_| Ok(()))
        },
        Service::new("cleaner", None, |_| Ok(())),
    ]);

    #[test]
    fn a_role_is_filled_by_its_first_service_unless_another_is_named() {
        let mut launch = Launch::train();
        let vehicle = launch.process.iter_mut().find(|it| it.role == Role::Vehicle).unwrap();
        assert_eq!(SERVICES.program(vehicle), Program::Service("simulator"));
        for (name, part) in [("cleaner", "cannot be the vehicle"), ("boat", "--features sea")] {
            vehicle.service = Some(name.to_owned());
            let why = SERVICES.named(Role::Vehicle, name).unwrap_err();
            assert!(why.contains(part), "{why}");
        }
        let why = SERVICES.check("my.toml", &launch).unwrap_err().message();
        assert!(why.starts_with("my.toml: process.service: build it"), "{why}");
    }

    #[test]
    fn an_unknown_service_is_refused() {
        assert!(SERVICES.run("cleaner", &[]).is_ok());
        let why = SERVICES.run("simulater", &[]).unwrap_err().message();
        assert!(why.contains("did you mean simulator?"), "{why}");
    }
}
