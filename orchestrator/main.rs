//! The doorway: one binary, which is the orchestrator and also every process that the orchestrator starts.

use std::process::ExitCode;

use orchestrator::House;

mod calibrate;
mod certify;
mod cut_off;
mod identify;
mod path_bag;
mod services;
mod tools;

fn main() -> ExitCode {
    orchestrator::run(House { services: services::SERVICES, tools: tools::TOOLS })
}
