//! Reports as lines: JSON, CSV, or text for people, one per second.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use runtime::clock::now_ns;

use crate::observed::ObservedRun;
use crate::report::Report;
use crate::{LookTimer, MonitorError, Options, POLL, Publish, SECOND_NS, Stop, StopReason, drain};

/// Outputs a report per second until the end.
pub(crate) fn run(
    options: &Options,
    run: &mut ObservedRun,
    stop: &Stop,
    publish: &mut Publish,
) -> Result<StopReason, MonitorError> {
    let mut outputs = Outputs::new(options)?;
    let mut timer = LookTimer::new(options);
    run.begin_interval();
    // A single report covers the whole time that the user wants to watch.
    let interval_ns = match options.duration {
        Some(duration) if options.once => duration.as_nanos() as u64,
        _ => SECOND_NS,
    };
    let mut due_ns = now_ns() + interval_ns;
    let mut reports = 0u32;
    let mut has_begun = !options.once;
    let ended = loop {
        let ended = drain(run)?;
        if !has_begun && run.has_seen_ticks() {
            // It also covers a time in which something was driven.
            has_begun = true;
            run.begin_interval();
            due_ns = now_ns() + interval_ns;
        }
        if has_begun && now_ns() >= due_ns {
            let report = run.report();
            publish.put(&report);
            reports += 1;
            if !outputs.put(&report)? || options.once {
                break StopReason::Enough;
            }
            // A monitor that was frozen for a while does not catch up on lines.
            while due_ns <= now_ns() {
                due_ns += SECOND_NS;
            }
        }
        if let Some(ended) = ended {
            break ended;
        }
        if stop.is_asked_for() || (timer.is_over() && !(options.once && has_begun)) {
            break StopReason::Enough;
        }
        if timer.is_time_to_look() {
            run.new_restarts();
            if !run.is_alive() {
                drain(run)?;
                break StopReason::RunOver;
            }
        }
        std::thread::sleep(POLL);
    };
    // A user who watches for less than a second gets a report over less than a second.
    if reports == 0 && run.has_seen_ticks() {
        outputs.put(&run.report())?;
    } else if outputs.is_text() && reports > 1 {
        outputs.put_text(&format!("in all\n{}", run.total().table()))?;
    }
    Ok(ended)
}

struct Outputs {
    json: bool,
    table: bool,
    csv: Option<csv::Writer<File>>,
    has_header: bool,
}

impl Outputs {
    fn new(options: &Options) -> Result<Self, MonitorError> {
        let create = |path: &Path| match File::create(path) {
            Ok(file) => Ok(csv::Writer::from_writer(file)),
            Err(error) => {
                Err(MonitorError::User(format!("failed to write {}: {error}", path.display())))
            }
        };
        let csv = options.csv.as_deref().map(create).transpose()?;
        Ok(Self { json: options.json, table: options.once, csv, has_header: false })
    }

    fn is_text(&self) -> bool {
        !self.json && self.csv.is_none()
    }

    /// Returns whether the output is still being read.
    fn put(&mut self, report: &Report) -> Result<bool, MonitorError> {
        if let Some(csv) = &mut self.csv {
            let (names, values): (Vec<_>, Vec<_>) = report.columns().into_iter().unzip();
            let mut write = || -> csv::Result<()> {
                if !std::mem::replace(&mut self.has_header, true) {
                    csv.write_record(&names)?;
                }
                csv.write_record(&values)?;
                Ok(csv.flush()?)
            };
            write().map_err(|error| anyhow::Error::new(error).context("failed to write a row"))?;
        }
        if self.json {
            let line = serde_json::to_string(report).map_err(anyhow::Error::new)?;
            return self.put_text(&line);
        }
        if self.is_text() {
            let text = if self.table { report.table() } else { report.line() };
            return self.put_text(&text);
        }
        Ok(true)
    }

    fn put_text(&self, text: &str) -> Result<bool, MonitorError> {
        let mut out = io::stdout().lock();
        match writeln!(out, "{text}").and_then(|()| out.flush()) {
            Ok(()) => Ok(true),
            // It is not an error if the reader has gone away.
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(false),
            Err(error) => {
                Err(anyhow::Error::new(error).context("failed to write to standard output").into())
            }
        }
    }
}
