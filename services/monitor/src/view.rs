//! The view on a terminal: a table of the hops, what the loop does, what happens to its processes.

use std::collections::VecDeque;
use std::io;
use std::time::Duration;

use ipc_types::Attempt;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Style, Stylize};
use ratatui::text::Line;
use ratatui::widgets::{Block, Cell, Paragraph, Row, Sparkline, Table};
use ratatui::{DefaultTerminal, Frame};
use runtime::clock::now_ns;

use crate::observed::ObservedRun;
use crate::report::{Report, human};
use crate::{LookTimer, MonitorError, Options, POLL, Publish, SECOND_NS, Stop, StopReason, drain};

/// Time between pictures.
const REFRESH_NS: u64 = SECOND_NS / 2;
/// Time between looks for keys.
const KEYS_NS: u64 = 20_000_000;
/// Points of the sparkline that are kept: a wide terminal's worth.
const POINTS: usize = 400;
/// Events that are kept.
const EVENTS: usize = 50;

/// Draws until the end.
pub(crate) fn run(
    options: &Options,
    run: &mut ObservedRun,
    stop: &Stop,
    publish: &mut Publish,
) -> Result<StopReason, MonitorError> {
    let mut screen = Screen::open()?;
    let mut view = View::default();
    let mut timer = LookTimer::new(options);
    run.begin_interval();
    // Something is shown at once, but there are figures only after some time.
    screen.draw(&view)?;
    let (mut draw_ns, mut keys_ns, mut publish_ns) = (now_ns() + REFRESH_NS, now_ns(), now_ns());
    loop {
        if let Some(ended) = drain(run)? {
            return Ok(ended);
        }
        if stop.is_asked_for() || timer.is_over() {
            return Ok(StopReason::Enough);
        }
        view.note_drive(run);
        if timer.is_time_to_look() {
            for event in run.new_restarts() {
                view.live.tell(run.age_s(), event);
            }
            if !run.is_alive() {
                return Ok(StopReason::RunOver);
            }
        }
        let now_ns = now_ns();
        if now_ns >= draw_ns {
            draw_ns = now_ns + REFRESH_NS;
            view.note(run.report(), run.total());
            if now_ns >= publish_ns {
                publish_ns = now_ns + SECOND_NS;
                publish.put(&view.live.interval);
            }
            screen.draw(&view)?;
        }
        if now_ns >= keys_ns {
            keys_ns = now_ns + KEYS_NS;
            while event::poll(Duration::ZERO)? {
                match event::read()? {
                    Event::Key(key) if key.kind != KeyEventKind::Release => match meaning(key) {
                        Some(Key::Quit) => return Ok(StopReason::Enough),
                        Some(Key::Reset) => {
                            run.reset();
                            view.reset();
                            draw_ns = now_ns + REFRESH_NS;
                            view.live.total = run.total();
                            screen.draw(&view)?;
                        }
                        Some(Key::Freeze) => {
                            view.freeze();
                            screen.draw(&view)?;
                        }
                        None => {}
                    },
                    Event::Resize(..) => screen.draw(&view)?,
                    _ => {}
                }
            }
        }
        std::thread::sleep(POLL);
    }
}

/// The terminal, which is restored in any case: at the end of the view, on errors and on panics.
struct Screen(DefaultTerminal);

impl Screen {
    fn open() -> Result<Self, MonitorError> {
        ratatui::try_init().map(Self).map_err(|error| {
            // It may have failed half way.
            let _ = ratatui::try_restore();
            MonitorError::User(format!("failed to draw on this terminal: {error}; use --json"))
        })
    }

    fn draw(&mut self, view: &View) -> io::Result<()> {
        self.0.draw(|frame| view.draw(frame)).map(|_| ())
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = ratatui::try_restore();
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Key {
    Quit,
    Reset,
    Freeze,
}

fn meaning(key: KeyEvent) -> Option<Key> {
    match key.code {
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => Some(Key::Quit),
        KeyCode::Char('q') | KeyCode::Esc => Some(Key::Quit),
        KeyCode::Char('r') => Some(Key::Reset),
        KeyCode::Char('f') => Some(Key::Freeze),
        _ => None,
    }
}

/// What is drawn.
#[derive(Debug, Clone, Default)]
struct Picture {
    /// Since the last picture.
    interval: Report,
    /// Since the beginning, or the last reset.
    total: Report,
    /// End to end, p99 of each picture.
    points: VecDeque<u64>,
    /// What happened, the newest last.
    events: VecDeque<String>,
}

impl Picture {
    fn tell(&mut self, t_s: f64, what: String) {
        self.events.push_back(format!("{t_s:8.1} s  {what}"));
        if self.events.len() > EVENTS {
            self.events.pop_front();
        }
    }
}

#[derive(Debug, Default)]
struct View {
    live: Picture,
    /// The frozen picture, if the view is frozen.
    frozen: Option<Picture>,
    drive: Option<Attempt>,
}

impl View {
    fn note(&mut self, interval: Report, total: Report) {
        let points = &mut self.live.points;
        points.push_back(interval.hops.end_to_end.p99_ns);
        if points.len() > POINTS {
            points.pop_front();
        }
        self.live.interval = interval;
        self.live.total = total;
    }

    /// Notes that a batch is driven again.
    fn note_drive(&mut self, run: &ObservedRun) {
        let drive = run.drive();
        if drive == self.drive {
            return;
        }
        self.drive = drive;
        if let Some(Attempt { batch, attempt, .. }) = drive
            && attempt > 1
        {
            self.live.tell(run.age_s(), format!("batch {batch}: attempt {attempt}"));
        }
    }

    fn reset(&mut self) {
        self.live.points.clear();
        self.frozen = None;
    }

    fn freeze(&mut self) {
        self.frozen = match self.frozen.take() {
            Some(_) => None,
            None => Some(self.live.clone()),
        };
    }

    fn draw(&self, frame: &mut Frame) {
        let picture = self.frozen.as_ref().unwrap_or(&self.live);
        let [head, hops, spark, events, keys] = Layout::vertical([
            Constraint::Length(6),
            Constraint::Length(9),
            Constraint::Length(5),
            Constraint::Fill(1),
            Constraint::Length(1),
        ])
        .areas(frame.area());
        draw_head(frame, head, picture);
        draw_hops(frame, hops, &picture.total);
        // As many as there is room for, the newest at the right.
        let room = spark.width.saturating_sub(2) as usize;
        let skipped = picture.points.len().saturating_sub(room);
        let points: Vec<u64> = picture.points.iter().skip(skipped).copied().collect();
        let most = human(points.iter().copied().max().unwrap_or_default());
        let title = format!(" end to end, p99 of each half second, up to {most} ");
        let sparkline = Sparkline::default().block(Block::bordered().title(title)).data(points);
        frame.render_widget(sparkline, spark);
        let room = events.height.saturating_sub(2) as usize;
        let skipped = picture.events.len().saturating_sub(room);
        let lines: Vec<Line> =
            picture.events.iter().skip(skipped).map(|event| Line::raw(event.as_str())).collect();
        let block = Block::bordered().title(" restarts and attempts ");
        frame.render_widget(Paragraph::new(lines).block(block), events);
        let state = if self.frozen.is_some() { "frozen (collecting goes on)   " } else { "" };
        let keys_line = format!(" {state}r reset   f freeze   q quit");
        frame.render_widget(Paragraph::new(keys_line).dim(), keys);
    }
}

fn draw_head(frame: &mut Frame, area: Rect, picture: &Picture) {
    let Picture { interval, total, .. } = picture;
    let vehicle = &interval.vehicle;
    let flags = match vehicle.flags.as_slice() {
        [] => "no flags".to_owned(),
        flags => flags.join(" "),
    };
    let misses = Line::raw(format!(
        "seen {}   missed {}   deadline misses {} (over {})   left out {}",
        total.ticks,
        total.missed,
        total.deadline_misses,
        human(interval.budget_ns),
        total.implausible + total.strays,
    ));
    let gate = Line::raw(format!(
        "gate {}   {}   changed {}   own {}   actions {}{}",
        vehicle.gate,
        if vehicle.reasons.is_empty() {
            "nothing wrong".to_owned()
        } else {
            vehicle.reasons.join(" ")
        },
        vehicle.changed_commands,
        vehicle.own_commands,
        vehicle.actions,
        if vehicle.own_stop { "   the vehicle stops on its own" } else { "" },
    ));
    let lines = vec![
        Line::raw(format!(
            "{:.0} ticks/s   period {}   jitter {}   age {}   batch {} attempt {} tick {}   restarts {}",
            interval.rate_hz,
            human(interval.period.p50_ns),
            human(interval.jitter_ns),
            interval.age_ns.map_or("-".to_owned(), human),
            interval.batch,
            interval.attempt,
            interval.tick,
            interval.restarts,
        )),
        if total.missed + total.deadline_misses > 0 { misses.yellow() } else { misses },
        Line::raw(format!(
            "vehicle {} of {}   told {:.2} m/s (wanted {:.2})   steering {:+.3} rad   zone {}   {flags}",
            vehicle.slot,
            vehicle.fleet,
            vehicle.speed_mps,
            vehicle.wanted_speed_mps,
            vehicle.steering_rad,
            vehicle.zone,
        )),
        if vehicle.gate == "normal" && !vehicle.own_stop { gate } else { gate.red() },
    ];
    let block = Block::bordered().title(format!(" run {}   {:.0} s ", interval.run, total.t_s));
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

fn draw_hops(frame: &mut Frame, area: Rect, total: &Report) {
    let right = |text: String| Cell::from(Line::raw(text).right_aligned());
    let rows = total.hops.each().map(|(hop, spans)| {
        let mut cells = vec![Cell::from(hop.name().replace('_', " "))];
        cells.extend(spans.each().map(|(_, ns)| right(human(ns))));
        Row::new(cells)
    });
    let mut names = vec![Cell::from("hop")];
    names.extend(["p50", "p90", "p99", "p99.9", "max"].map(|name| right(name.to_owned())));
    let widths = [Constraint::Fill(1)].into_iter().chain([Constraint::Length(10); 5]);
    let table = Table::new(rows, widths)
        .header(Row::new(names).style(Style::new().bold()))
        .block(Block::bordered().title(" since the last reset "));
    frame.render_widget(table, area);
}

#[cfg(test)]
mod tests {
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::*;
    use crate::report::Vehicle;

    fn drawn(view: &View, width: u16, height: u16) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| view.draw(frame)).unwrap();
        terminal.backend().to_string()
    }

    fn a_report() -> Report {
        let mut report = Report {
            t_s: 12.0,
            ticks: 1_234,
            rate_hz: 100.0,
            attempt: 2,
            batch: 17,
            age_ns: Some(81_000),
            run: "00000000000000ab".to_owned(),
            budget_ns: 10_000_000,
            vehicle: Vehicle { fleet: 3, flags: vec!["speed_limited"], ..Vehicle::default() },
            ..Report::default()
        };
        report.hops.controller.p50_ns = 2_050_000;
        report.hops.end_to_end.p99_ns = 2_345_000;
        report
    }

    #[test]
    fn the_view_shows_hops_loop_vehicle_and_events() {
        let mut view = View::default();
        view.note(a_report(), a_report());
        view.live.tell(3.5, "controller was restarted (1)".to_owned());
        let text = drawn(&view, 100, 30);
        for words in [
            "run 00000000000000ab",
            "100 ticks/s",
            "age 81.0 µs",
            "batch 17 attempt 2",
            "seen 1234   missed 0   deadline misses 0 (over 10.00 ms)",
            "vehicle 0 of 3",
            "speed_limited",
            "supervisor to vehicle",
            "2.05 ms",
            "p99.9",
            "up to 2.35 ms",
            "3.5 s  controller was restarted (1)",
            "r reset   f freeze   q quit",
        ] {
            assert!(text.contains(words), "{words} is missing:\n{text}");
        }
    }

    #[test]
    fn a_frozen_view_stands_still_until_it_is_thawed_or_reset() {
        let mut view = View::default();
        view.note(a_report(), a_report());
        view.freeze();
        let frozen = drawn(&view, 100, 30);
        assert!(frozen.contains("frozen"));
        view.note(Report { ticks: 9_999, ..a_report() }, Report { ticks: 9_999, ..a_report() });
        assert_eq!(drawn(&view, 100, 30), frozen);
        view.freeze();
        assert!(drawn(&view, 100, 30).contains("seen 9999"));
        view.freeze();
        view.reset();
        assert!(!drawn(&view, 100, 30).contains("frozen"));
    }

    #[test]
    fn a_terminal_of_any_size_is_drawn_on() {
        let mut view = View::default();
        for size in 0..1_000u64 {
            let mut report = a_report();
            report.hops.end_to_end.p99_ns = size;
            view.note(report, a_report());
            view.live.tell(0.0, "something".repeat(100));
        }
        for (width, height) in [(1, 1), (5, 40), (20, 3), (80, 24), (500, 100)] {
            drawn(&view, width, height);
        }
        assert_eq!((view.live.points.len(), view.live.events.len()), (POINTS, EVENTS));
    }

    #[test]
    fn keys_mean_what_the_last_line_says() {
        let check = |code, modifiers, key| assert_eq!(meaning(KeyEvent::new(code, modifiers)), key);
        check(KeyCode::Char('q'), KeyModifiers::NONE, Some(Key::Quit));
        check(KeyCode::Esc, KeyModifiers::NONE, Some(Key::Quit));
        check(KeyCode::Char('c'), KeyModifiers::CONTROL, Some(Key::Quit));
        check(KeyCode::Char('c'), KeyModifiers::NONE, None);
        check(KeyCode::Char('r'), KeyModifiers::NONE, Some(Key::Reset));
        check(KeyCode::Char('f'), KeyModifiers::NONE, Some(Key::Freeze));
    }
}
