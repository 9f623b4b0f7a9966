//! The doorway: one binary that is the orchestrator, and every process that it starts.

use std::process::ExitCode;

use orchestrator::House;

mod services;
mod tools;

fn main() -> ExitCode {
    orchestrator::run(House { services: services::SERVICES, tools: tools::TOOLS })
}
