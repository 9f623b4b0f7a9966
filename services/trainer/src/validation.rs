//! Parameter sets compared with the paper's: without noise, and with it.

use std::collections::BTreeMap;

use config::{ConfigError, PaperRow, Parameters, RunConfig, SweepPlan};
use outcome::{NoiseFree, Noisy, PlantCheck, Switch, ValidateResult, ValidatedRow};
use tracking::Objective;

use crate::digest::digest_of_drives;
use crate::ranking::measures_of;
use crate::statistics::{Estimate, mean};
use crate::sweep::PlannedDrive;
use crate::wire::Driven;

/// What a validation drives, and how its reports become a result.
#[derive(Debug, Clone)]
pub struct Validation {
    config: RunConfig,
    objective: Objective,
    rows: Vec<Vec<Parameters>>,
    repeats: u64,
    /// Whether the paper's figures are of this path, car and law.
    has_paper_s_figures: bool,
}

impl Validation {
    /// The rows of a plan, or those of the paper's table if it names none.
    ///
    /// # Errors
    /// If the plan's sets are not of the configuration's law.
    pub fn new(config: &RunConfig, plan: &SweepPlan) -> Result<Self, ConfigError> {
        let mut rows = plan.parameters(&config.law)?;
        if rows.is_empty() {
            rows.extend(config.paper_rows().into_iter().map(|row| row.sets));
        }
        let objective = crate::objective_of(config);
        let has_paper_s_figures = config.has_figures_of_the_paper();
        let (config, repeats) = (config.clone(), plan.repeats.into());
        Ok(Self { config, objective, rows, repeats, has_paper_s_figures })
    }

    /// The drives: row by row, first without noise, then with the noise seeds 1, 2, …. The row that the paper
    /// chose is recorded, or the first row if that is not among them.
    pub fn drives(&self) -> Vec<PlannedDrive> {
        let chosen = self.rows.iter().position(|row| self.paper(row).is_some_and(|it| it.chosen));
        let shown = chosen.unwrap_or_default();
        let name = if chosen.is_some() { "paper" } else { "first" };
        let mut drives = Vec::new();
        for (index, row) in self.rows.iter().enumerate() {
            let by_zone = if row.len() == 1 { row.clone() } else { self.config.sets_by_zone(row) };
            for seed in std::iter::once(None).chain((1..=self.repeats).map(Some)) {
                let record = match seed {
                    None => Some(format!("{name}_noise_free")),
                    Some(1) => Some(format!("{name}_noisy")),
                    Some(_) => None,
                };
                drives.push(PlannedDrive {
                    by_zone: by_zone.clone(),
                    seed,
                    plant: 0,
                    record: record.filter(|_| index == shown),
                });
            }
        }
        drives
    }

    /// The number of the row, if drive number `index` is without noise.
    pub fn noise_free_row(&self, index: usize) -> Option<usize> {
        let drives_of_row = self.repeats as usize + 1;
        index.is_multiple_of(drives_of_row).then_some(index / drives_of_row)
    }

    /// The same with only those rows of which every drive was made; returns these drives, and the numbers that the rows
    /// had before.
    pub fn cut(&self, driven: &[Option<Driven>]) -> (Self, Vec<Driven>, Vec<usize>) {
        let mut cut = Self { rows: Vec::new(), ..self.clone() };
        let (mut whole, mut numbers) = (Vec::new(), Vec::new());
        let drives_of_row = driven.chunks(self.repeats as usize + 1);
        for (number, (row, driven)) in self.rows.iter().zip(drives_of_row).enumerate() {
            if let Some(driven) = driven.iter().copied().collect::<Option<Vec<Driven>>>() {
                cut.rows.push(row.clone());
                whole.extend(driven);
                numbers.push(number);
            }
        }
        (cut, whole, numbers)
    }

    /// What each row's set does on plausible plants; `None` for a row with several sets. It drives each on all plants, so it
    /// takes a while.
    pub fn plant_checks(&self) -> Vec<Option<PlantCheck>> {
        let check = |sets: &[Parameters]| match sets {
            [set] => Some(crate::plants::check(&self.config, &self.objective, set, Vec::new())),
            _ => None,
        };
        self.rows.iter().map(|sets| check(sets)).collect()
    }

    /// Number of rows in the table.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The result of the reports of [`Validation::drives`]; `switches` are those of each row.
    pub fn result(&self, driven: &[Driven], switches: &[Vec<Switch>]) -> ValidateResult {
        let rows: Vec<ValidatedRow> = self
            .rows
            .iter()
            .zip(driven.chunks(self.repeats as usize + 1))
            .zip(switches)
            .map(|((sets, driven), switches)| self.row(sets, driven, switches))
            .collect();
        let logs: Vec<f64> = rows
            .iter()
            .flat_map(|row| [row.noise_free.factor, row.noisy.factor])
            .flatten()
            .map(libm::log)
            .collect();
        let square = logs.iter().map(|log| log * log).sum::<f64>() / logs.len() as f64;
        ValidateResult {
            digest: digest_of_drives(driven, self.config.law.count()),
            repeats: self.repeats,
            rms_factor: (!logs.is_empty()).then(|| libm::exp(square.sqrt())),
            rows,
            drives_recorded: Vec::new(),
            drives_lacking: BTreeMap::new(),
            laps: BTreeMap::new(),
        }
    }

    fn row(&self, sets: &[Parameters], driven: &[Driven], switches: &[Switch]) -> ValidatedRow {
        let paper = self.paper(sets);
        let (plain, noisy) = driven.split_first().expect("each row has a drive without noise");
        let plain = &plain.record;
        let factor = |ours: f64, paper: Option<f64>| paper.map(|it| (ours / it).max(it / ours));
        let noisy_mse: Vec<f64> = noisy.iter().map(|it| it.record.mse_m2()).collect();
        let noisy_path: Vec<f64> = noisy.iter().map(|it| it.record.path_mean_m).collect();
        let Estimate { mean: mse_m2_mean, low, high } = Estimate::of(&noisy_mse);
        let worst = |of: fn(&Driven) -> f64| noisy.iter().map(of).fold(0.0, f64::max);
        let mse_m2_worst = worst(|it| it.record.mse_m2());
        // Of another car the paper has no figures, although its sets can be driven.
        let figures = paper.as_ref().filter(|_| self.has_paper_s_figures);
        let (plain_paper, noisy_paper) =
            (figures.map(|row| row.mse_m2), figures.map(|row| row.noisy_mse_m2));
        let weight = self.config.learning.heading_weight;
        ValidatedRow {
            gains: sets.iter().map(|set| self.config.law.named(set)).collect(),
            chosen_by_paper: paper.is_some_and(|row| row.chosen),
            noise_free: NoiseFree {
                measures: measures_of(&self.objective, weight, plain),
                along_m2: plain.along_mse_m2,
                cross_m2: plain.cross_mse_m2,
                max_cross_track_m: plain.max_abs_cross_m,
                steering_limited: plain.steering_limited_ticks as f64 / plain.ticks.max(1) as f64,
                collisions: u32::from(plain.collided()),
                driven: plain.ticks as f64 / self.config.ticks() as f64,
                paper_mse_m2: plain_paper,
                factor: factor(plain.mse_m2(), plain_paper),
            },
            noisy: Noisy {
                mse_m2_mean,
                mse_m2_low: low,
                mse_m2_high: high,
                mse_m2_worst,
                path_mean_m: mean(&noisy_path),
                path_max_m: worst(|it| it.record.path_max_m),
                collisions: noisy.iter().map(|it| u32::from(it.record.collided())).sum(),
                paper_mse_m2: noisy_paper,
                factor: factor(mse_m2_worst, noisy_paper),
            },
            plants: None,
            switches: switches.to_vec(),
        }
    }

    /// The paper's row with these sets.
    fn paper(&self, sets: &[Parameters]) -> Option<PaperRow> {
        self.config.paper_rows().into_iter().find(|row| row.sets == sets)
    }
}
