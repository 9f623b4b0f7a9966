//! Pipeline = oracle: every pose, command and report equals `rollout()`, bit for bit.
//!
//! A process of this test takes the trainer's role: it proposes random gain sets, watches every message of the
//! drives from the side, and compares them with plain calls. A drive is shorter than an observer's buffer, so
//! that nothing can be missed.

mod support;

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use config::{Parameters, RunConfig};
use ipc_types::topics::OBSERVER_BUFFER;
use ipc_types::{
    Attempt, BatchHeader, Command, DriveOutcome, DriveReport, DriveRequest, Odometry, Proposal,
    RawCommand, WakeRole, WirePose,
};
use rollout::{Rollout, TickRecord};
use runtime::{Bus, Counters, Inlet, Outlet, Service, join, serve};
use support::Sandbox;
use tracking::Pose;

const SETS: usize = 50;

#[test]
fn the_pipeline_equals_plain_calls_bit_for_bit() {
    for maneuver in ["lane_change", "roundabout"] {
        for noise in [false, true] {
            for fleet in ["1", "5", "16"] {
                let mut args = vec!["train", maneuver, "--fleet", fleet];
                if maneuver == "roundabout" {
                    args.extend(["--set", "drive.loop_time_s=10.0"]);
                }
                if noise {
                    args.push("--noise");
                }
                equals(&args);
            }
        }
    }
}

#[test]
fn a_car_with_delays_and_lags_equals_plain_calls_too() {
    let car = "steering_delay_s=0.153 steering_lag_s=0.1 steering_gain=0.9 steering_offset_rad=0.01 \
               steering_dead_band_rad=0.004 speed_delay_s=0.117";
    let car: Vec<String> = car.split(' ').map(|key| format!("vehicle.{key}")).collect();
    let car: Vec<&str> = car.iter().flat_map(|key| ["--set", key]).collect();
    for (vehicle, fleet) in [("tesla_model_3", "16"), ("tesla_model_3_dynamic", "5")] {
        let args = ["train", "lane_change", "--fleet", fleet, "--noise", "--vehicle", vehicle];
        equals(&[&args, &car[..]].concat());
    }
}

/// A training with these arguments makes the drives that plain calls make.
fn equals(args: &[&str]) {
    let trainer = format!(
        "trainer={} --exact trainer_process --ignored --nocapture",
        std::env::current_exe().unwrap().display()
    );
    let sandbox = Sandbox::new();
    let own = ["--out", "out", "--quiet", "--replace", &trainer, "--restart-budget", "0"];
    let output = sandbox.run(&[args, &own].concat());
    let compared = fs::read_to_string(sandbox.path("out").join("compared"));
    assert_eq!(
        compared.unwrap_or_default(),
        format!("{SETS} sets"),
        "{args:?}: {}",
        sandbox.story("out", &output)
    );
    sandbox.assert_clean();
}

/// Not a test: the process in the trainer's role.
#[test]
#[ignore = "a process of the test above"]
fn trainer_process() {
    let (attachment, bus, config) = join().unwrap();
    let mut comparer =
        Comparer::new(&bus, config, attachment.names.run, attachment.folder.clone()).unwrap();
    serve(&attachment, &bus, WakeRole::Trainer, &mut comparer).unwrap();
}

struct Comparer {
    outcomes: Inlet<DriveOutcome>,
    proposals: Outlet<Proposal>,
    odometry: Inlet<Odometry>,
    raw_commands: Inlet<RawCommand>,
    commands: Inlet<Command>,
    run: u64,
    folder: PathBuf,
    config: RunConfig,
    rollout: Rollout,
    sets: Vec<Parameters>,
    compared: usize,
    waiting: bool,
}

impl Comparer {
    fn new(bus: &Bus, config: RunConfig, run: u64, folder: PathBuf) -> Result<Self> {
        assert!(config.ticks() < OBSERVER_BUFFER as u64);
        Ok(Self {
            outcomes: bus.inlet()?,
            proposals: bus.outlet()?,
            odometry: bus.observe()?,
            raw_commands: bus.observe()?,
            commands: bus.observe()?,
            run,
            folder,
            rollout: Rollout::new(&config),
            sets: random_sets(&config),
            config,
            compared: 0,
            waiting: false,
        })
    }

    fn propose(&mut self) -> Result<()> {
        let attempt = Attempt::between_batches(self.run);
        let header = BatchHeader { attempt, ..BatchHeader::default() };
        let rest = SETS - self.compared;
        if rest == 0 {
            fs::write(self.folder.join("compared"), format!("{SETS} sets"))?;
            fs::write(self.folder.join("outcome.json"), "{}")?;
            let over = BatchHeader { flags: Proposal::FINISHED, ..header };
            self.proposals.send(over, 1, |_| Proposal::default())?;
            return Ok(());
        }
        let (sets, compared, ticks) = (&self.sets, self.compared, self.config.ticks());
        let noise = self.config.noise.enabled;
        self.proposals.send(header, rest.min(self.config.fleet()), |slot| Proposal {
            parameters: sets[compared + slot].0,
            seed: (compared + slot) as u64,
            ticks,
            learner: slot as u32,
            step: compared as u32,
            flags: if noise { DriveRequest::NOISE } else { 0 },
            plant: 0,
        })?;
        Ok(())
    }

    fn compare(&mut self, outcomes: &[DriveOutcome]) -> Result<()> {
        let ticks = outcomes[0].report.ticks as usize;
        let odometry = take(&self.odometry, ticks)?;
        let raw_commands = take(&self.raw_commands, ticks)?;
        let commands = take(&self.commands, ticks)?;
        for (slot, outcome) in outcomes.iter().enumerate() {
            let report = outcome.report;
            let index = self.compared + slot;
            ensure!((report.learner, report.step) == (slot as u32, self.compared as u32));
            let seed = self.config.noise.enabled.then_some(index as u64);
            let mut records: Vec<TickRecord> = Vec::new();
            let ended = self.rollout.drive_with(self.sets[index], seed, |_, it| records.push(*it));
            for messages in [odometry.len(), raw_commands.len(), commands.len()] {
                ensure!(messages == records.len(), "{messages} messages, {} ticks", records.len());
            }
            for (tick, record) in records.iter().enumerate() {
                let seen = &odometry[tick][slot];
                let wire = &record.observation;
                same_pose(seen.measured, wire.measured)?;
                same_pose(seen.truth, wire.truth)?;
                same(seen.speed_mps, wire.speed_mps)?;
                same(seen.yaw_rate_radps, wire.yaw_rate_radps)?;
                same(seen.steering_rad, wire.steering_rad)?;
                let (raw, wanted) = (&raw_commands[tick][slot], record.decision.command);
                same(raw.speed_mps, wanted.speed_mps)?;
                same(raw.yaw_rate_radps, wanted.yaw_rate_radps)?;
                same(raw.steering_rad, wanted.steering_rad)?;
                let passed = &commands[tick][slot];
                let ended = passed.flags & Command::ENDED != 0;
                ensure!(ended == (tick + 1 == records.len()));
                same(passed.speed_mps, record.passed.speed_mps)?;
                same(passed.yaw_rate_radps, record.passed.yaw_rate_radps)?;
                same(passed.steering_rad, record.passed.steering_rad)?;
            }
            ensure!((report.trace, report.ticks) == (ended.trace, ended.ticks));
            ensure!(report.reason == DriveReport::TIME);
            ensure!(report.steering_limited_ticks == ended.steering_limited_ticks);
            same(report.mean_abs_along_m, ended.mean_abs_along_m)?;
            same(report.mean_abs_cross_m, ended.mean_abs_cross_m)?;
            same(report.mean_abs_heading_rad, ended.mean_abs_heading_rad)?;
            same(report.along_mse_m2, ended.along_mse_m2)?;
            same(report.cross_mse_m2, ended.cross_mse_m2)?;
            same(report.max_abs_cross_m, ended.max_abs_cross_m)?;
            same(report.path_mean_m, ended.path_mean_m)?;
            same(report.path_p95_m, ended.path_p95_m)?;
            same(report.path_max_m, ended.path_max_m)?;
            same(report.progress, ended.progress)?;
            same(report.steering_travel_radps, ended.steering_travel_radps)?;
            same(report.lateral_acceleration_max_mps2, ended.lateral_acceleration_max_mps2)?;
        }
        self.compared += outcomes.len();
        Ok(())
    }
}

impl Service for Comparer {
    fn poll(&mut self) -> Result<bool> {
        if !self.waiting {
            self.waiting = true;
            self.propose()?;
            return Ok(true);
        }
        let Some(outcomes) = self.outcomes.receive()? else { return Ok(false) };
        self.compare(outcomes.items())?;
        self.propose()?;
        Ok(true)
    }

    fn status(&self) -> Counters {
        Counters::default()
    }
}

/// The next `count` messages. The report may overtake the last command, which goes one hop further.
fn take<M: ipc_types::Message>(inlet: &Inlet<M>, count: usize) -> Result<Vec<Vec<M>>> {
    let mut all = Vec::new();
    let until = Instant::now() + Duration::from_secs(5);
    while all.len() < count {
        ensure!(Instant::now() < until, "{} messages instead of {count}", all.len());
        while let Some(message) = inlet.receive()? {
            all.push(message.items().to_vec());
        }
    }
    Ok(all)
}

fn same(got: f64, wanted: f64) -> Result<()> {
    ensure!(got.to_bits() == wanted.to_bits(), "{got} is not {wanted}");
    Ok(())
}

fn same_pose(got: WirePose, wanted: Pose) -> Result<()> {
    same(got.x_m, wanted.x_m)?;
    same(got.y_m, wanted.y_m)?;
    same(got.yaw_rad, wanted.yaw_rad)
}

/// Uniform over the grid's ranges, on no grid point.
fn random_sets(config: &RunConfig) -> Vec<Parameters> {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut uniform = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let set = |_| {
        let axes = config.law.keys().map(|key| config.grid[key]);
        let values: Vec<f64> = axes.map(|it| it.min + (it.max - it.min) * uniform()).collect();
        Parameters::of(&values)
    };
    (0..SETS).map(set).collect()
}
