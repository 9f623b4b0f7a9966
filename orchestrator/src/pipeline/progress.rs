//! What a user sees while a training runs.
//!
//! A suspended terminal, or a pipe that nobody reads, may block a writer for ever. So a separate thread writes, and the
//! main loop, which must restart dead processes, never waits for it: what the thread cannot take is not shown, but it
//! is in the log.

use std::io::IsTerminal;
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use ipc_types::{LearnerProgress, has};

use crate::pipeline::sequencer::DriveCounts;
use crate::words::terminal::tell;

/// How often the terminal is redrawn.
const REDRAW: Duration = Duration::from_millis(100);
/// How often a line is written where there is no terminal.
const LINE: Duration = Duration::from_secs(2);

/// How many messages may wait to be written; further ones are left out.
const WAITING: usize = 256;
/// How long to wait at the end for the last ones to be written.
const PATIENCE: Duration = Duration::from_millis(500);

/// What a user sees while a training runs.
pub(crate) struct Progress {
    /// Leads to the thread that writes; `None` if nothing is to be shown.
    words: Option<SyncSender<Words>>,
    /// Disconnected when that thread ends.
    written: Receiver<()>,
    is_terminal: bool,
    started: Instant,
    shown: Instant,
    tick_s: f64,
    /// Name of the objective.
    objective: String,
    /// The last line, where there is no terminal: it is not repeated.
    last: String,
}

impl Progress {
    pub(crate) fn new(quiet: bool, tick_s: f64, objective: &str) -> Self {
        let is_terminal = std::io::stderr().is_terminal();
        let (words, to_write) = sync_channel(WAITING);
        let (is_written, written) = channel();
        if !quiet {
            thread::spawn(move || {
                write(&to_write, is_terminal);
                drop(is_written);
            });
        }
        let now = Instant::now();
        let words = (!quiet).then_some(words);
        let objective = objective.to_owned();
        Self {
            words,
            written,
            is_terminal,
            started: now,
            shown: now,
            tick_s,
            objective,
            last: String::new(),
        }
    }

    fn put(&self, words: Words) {
        if let Some(thread) = &self.words {
            let _ = thread.try_send(words);
        }
    }

    /// Something that the user should know at once.
    pub(crate) fn notice(&self, text: &str) {
        tracing::warn!("{text}");
        self.put(Words::Notice(format!("pathtune: {text}")));
    }

    /// Shows where the training stands, not too often.
    pub(crate) fn show(&mut self, flags: u32, learners: &[LearnerProgress], counts: DriveCounts) {
        let every = if self.is_terminal { REDRAW } else { LINE };
        if self.words.is_none() || learners.is_empty() || self.shown.elapsed() < every {
            return;
        }
        self.shown = Instant::now();
        let done: u64 = learners.iter().map(|learner| u64::from(learner.episode)).sum();
        let all: u64 = learners.iter().map(|learner| u64::from(learner.episodes)).sum();
        let message = if has(flags, LearnerProgress::RANKING) {
            format!("ranking the choice among all sets: {:.0} %", 100.0 * done as f64 / all as f64)
        } else if has(flags, LearnerProgress::SIMULATING) {
            format!("simulating sets on plants: {:.0} %", 100.0 * done as f64 / all as f64)
        } else if has(flags, LearnerProgress::DRIVES) {
            format!("drive {done}/{all}  {}", self.speed(counts))
        } else {
            self.message(learners, counts)
        };
        if !self.is_terminal && message == self.last {
            return;
        }
        self.last.clone_from(&message);
        self.put(Words::State { message, of: (all > 0).then_some((done, all)) });
    }

    fn message(&self, learners: &[LearnerProgress], counts: DriveCounts) -> String {
        let slowest = learners.iter().map(|learner| learner.episode).min().unwrap_or_default();
        let episodes = learners[0].episodes;
        let epsilon = learners.iter().map(|learner| learner.epsilon).fold(0.0, f64::max);
        let best = learners.iter().map(|learner| learner.best_value).fold(f64::INFINITY, f64::min);
        if episodes == 0 {
            let asked: u64 = learners.iter().map(|learner| learner.asked).sum();
            let speed = self.speed(counts);
            return format!("{asked} drives asked for  best {} {best:.4}  {speed}", self.objective);
        }
        let episode = (slowest + 1).min(episodes);
        format!(
            "episode {episode}/{episodes}  epsilon {epsilon:.2}  best {} {best:.4}  {}",
            self.objective,
            self.speed(counts),
        )
    }

    fn speed(&self, counts: DriveCounts) -> String {
        let seconds = self.started.elapsed().as_secs_f64();
        format!(
            "{:.0} drives/s  {:.0} x real time",
            (counts.reported + counts.beside) as f64 / seconds,
            counts.ticks as f64 * self.tick_s / seconds,
        )
    }

    /// Shows the progress of a batch that takes long.
    pub(crate) fn show_tick(&mut self, tick: u64, ticks: u64) {
        if self.words.is_none() || self.shown.elapsed() < LINE {
            return;
        }
        self.shown = Instant::now();
        let message = format!("tick {tick}/{ticks} of the drives under way");
        self.put(Words::State { message, of: None });
    }

    /// Clears the bar, once everything that can be written is written.
    pub(crate) fn finish(&mut self) {
        if self.words.take().is_some() {
            let _ = self.written.recv_timeout(PATIENCE);
        }
    }
}

/// What is to be shown.
enum Words {
    /// A line that stays.
    Notice(String),
    /// Progress of the training: how much is done, and of how much.
    State { message: String, of: Option<(u64, u64)> },
}

/// Writes what it receives: a bar on a terminal, lines elsewhere.
fn write(words: &Receiver<Words>, is_terminal: bool) {
    let target =
        if is_terminal { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
    let bar = ProgressBar::with_draw_target(None, target);
    if let Ok(style) = ProgressStyle::with_template("{wide_bar:.cyan} {msg}") {
        bar.set_style(style);
    }
    for words in words {
        match words {
            Words::Notice(text) | Words::State { message: text, .. } if !is_terminal => {
                tell!("{text}");
            }
            Words::Notice(text) => bar.println(text),
            Words::State { message, of } => {
                if let Some((done, all)) = of {
                    bar.set_length(all);
                    bar.set_position(done);
                }
                bar.set_message(message);
            }
        }
    }
    bar.finish_and_clear();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tuner_without_episodes_is_told_by_its_drives() {
        let progress = Progress::new(true, 0.01, "distance");
        let mut learner =
            LearnerProgress { asked: 7, best_value: 0.5, ..LearnerProgress::default() };
        let said = progress.message(&[learner; 2], DriveCounts::default());
        assert!(said.starts_with("14 drives asked for  best distance 0.5000"), "{said}");
        (learner.episode, learner.episodes) = (3, 10);
        let said = progress.message(&[learner; 2], DriveCounts::default());
        assert!(said.starts_with("episode 4/10  epsilon"), "{said}");
    }
}
