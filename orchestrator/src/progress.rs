//! What a user sees while a training runs.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use ipc_types::{LearnerProgress, has};

use crate::sequencer::Counts;
use crate::terminal::tell;

/// How often the terminal is drawn anew.
const REDRAW: Duration = Duration::from_millis(100);
/// How often a line is written where there is no terminal.
const LINE: Duration = Duration::from_secs(2);

/// What a user sees while a training runs.
pub(crate) struct Progress {
    bar: ProgressBar,
    quiet: bool,
    started: Instant,
    shown: Instant,
    tick_s: f64,
}

impl Progress {
    pub(crate) fn new(quiet: bool, tick_s: f64) -> Self {
        let terminal = std::io::stderr().is_terminal() && !quiet;
        let target =
            if terminal { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(None, target);
        if let Ok(style) = ProgressStyle::with_template("{wide_bar:.cyan} {msg}") {
            bar.set_style(style);
        }
        let now = Instant::now();
        Self { bar, quiet, started: now, shown: now, tick_s }
    }

    /// Something that the user should know at once.
    pub(crate) fn notice(&self, text: &str) {
        tracing::warn!("{text}");
        if self.quiet {
        } else if self.bar.is_hidden() {
            tell!("pathtune: {text}");
        } else {
            self.bar.println(format!("pathtune: {text}"));
        }
    }

    /// Shows where the training stands, not too often.
    pub(crate) fn show(&mut self, flags: u32, learners: &[LearnerProgress], counts: Counts) {
        let every = if self.bar.is_hidden() { LINE } else { REDRAW };
        if self.quiet || learners.is_empty() || self.shown.elapsed() < every {
            return;
        }
        self.shown = Instant::now();
        let done: u64 = learners.iter().map(|learner| u64::from(learner.episode)).sum();
        let all: u64 = learners.iter().map(|learner| u64::from(learner.episodes)).sum();
        let message = if has(flags, LearnerProgress::RANKING) {
            format!("ranking the choice among all sets: {:.0} %", 100.0 * done as f64 / all as f64)
        } else if has(flags, LearnerProgress::DRIVES) {
            format!("drive {done}/{all}  {}", self.speed(counts))
        } else {
            self.message(learners, counts)
        };
        self.bar.set_length(all);
        self.bar.set_position(done);
        self.bar.set_message(message.clone());
        if self.bar.is_hidden() {
            tell!("{message}");
        }
    }

    fn message(&self, learners: &[LearnerProgress], counts: Counts) -> String {
        let slowest = learners.iter().map(|learner| learner.episode).min().unwrap_or_default();
        let episodes = learners[0].episodes;
        let epsilon = learners.iter().map(|learner| learner.epsilon).fold(0.0, f64::max);
        let best =
            learners.iter().map(|learner| learner.best_distance).fold(f64::INFINITY, f64::min);
        let episode = (slowest + 1).min(episodes);
        format!(
            "episode {episode}/{episodes}  epsilon {epsilon:.2}  best distance {best:.4}  {}",
            self.speed(counts),
        )
    }

    fn speed(&self, counts: Counts) -> String {
        let seconds = self.started.elapsed().as_secs_f64();
        format!(
            "{:.0} drives/s  {:.0} x real time",
            (counts.driven + counts.beside) as f64 / seconds,
            counts.ticks as f64 * self.tick_s / seconds,
        )
    }

    /// Shows where a batch stands that lasts long.
    pub(crate) fn show_tick(&mut self, tick: u64, ticks: u64) {
        if self.quiet || self.shown.elapsed() < LINE {
            return;
        }
        self.shown = Instant::now();
        let message = format!("tick {tick}/{ticks} of the drives under way");
        self.bar.set_message(message.clone());
        if self.bar.is_hidden() {
            tell!("{message}");
        }
    }

    pub(crate) fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
