//! What a user sees while the jobs of a study run: how many are done, how fast, and the time to go.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::study::local::Event;
use crate::words::terminal::tell;

/// How often a line is written where there is no terminal.
const LINE: Duration = Duration::from_secs(10);

pub(crate) struct Progress {
    /// Jobs that are done, those of earlier starts included.
    pub(crate) done: usize,
    /// Those of earlier starts.
    before: usize,
    all: usize,
    failed: usize,
    started: Instant,
    shown: Instant,
    bar: Option<ProgressBar>,
    is_terminal: bool,
}

impl Progress {
    pub(crate) fn new(quiet: bool, done: usize, all: usize) -> Self {
        let is_terminal = std::io::stderr().is_terminal();
        let target =
            if is_terminal { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(Some(all as u64), target);
        if let Ok(style) = ProgressStyle::with_template("{wide_bar:.cyan} {msg}") {
            bar.set_style(style);
        }
        let now = Instant::now();
        let bar = (!quiet).then_some(bar);
        Self { done, before: done, all, failed: 0, started: now, shown: now, bar, is_terminal }
    }

    /// Takes what a job has come to.
    pub(crate) fn take(&mut self, event: Event) {
        match event {
            Event::Done => self.done += 1,
            Event::Failed { line, is_last } => {
                self.failed += usize::from(is_last);
                let line = if is_last { line } else { format!("{line} (tried again later)") };
                match &self.bar {
                    Some(bar) if self.is_terminal => bar.println(line),
                    _ => tell!("{line}"),
                }
            }
        }
        self.show();
    }

    /// Shows where the study stands, not too often.
    pub(crate) fn show(&mut self) {
        let Some(bar) = &self.bar else { return };
        let seconds = self.started.elapsed().as_secs_f64();
        let message = words(self.done, self.before, self.failed, self.all, seconds);
        if self.is_terminal {
            bar.set_position(self.done as u64);
            bar.set_message(message);
        } else if self.shown.elapsed() >= LINE {
            self.shown = Instant::now();
            tell!("{message}");
        }
    }

    pub(crate) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Where a study stands after this many seconds.
fn words(done: usize, before: usize, failed: usize, all: usize, seconds: f64) -> String {
    let mut words = format!("{done}/{all} jobs");
    if failed > 0 {
        words += &format!("  {failed} failed");
    }
    let made = done - before;
    if made > 0 {
        let to_go = (all - done - failed) as f64 * seconds / made as f64;
        let rate = 60.0 * made as f64 / seconds;
        words += &format!("  {rate:.1} jobs/min  {} to go", time(to_go));
    }
    words
}

/// A time as in `2 h 05 min`, `3 min 20 s` or `7 s`.
fn time(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match whole {
        0..=59 => format!("{whole} s"),
        60..=3599 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole / 60 % 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_and_time_to_go_leave_out_what_was_done_before() {
        assert_eq!(words(5, 5, 0, 20, 3.0), "5/20 jobs");
        assert_eq!(
            words(10, 5, 1, 20, 60.0),
            "10/20 jobs  1 failed  5.0 jobs/min  1 min 48 s to go"
        );
        assert_eq!(time(7.4), "7 s");
        assert_eq!(time(7500.0), "2 h 05 min");
    }
}
