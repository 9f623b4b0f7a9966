//! The newest report as a page in Prometheus' text format.
//!
//! Every request is answered with the page, whatever it asks for: one page does not need a web server. Each reader gets
//! a second, so that none can block the others, and a separate thread serves them, so that none can keep
//! the monitor from the bus.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::report::Report;

const PATIENCE: Duration = Duration::from_secs(1);

/// The page, and the thread that serves it until the process ends.
pub(crate) struct Page {
    text: Arc<Mutex<String>>,
}

impl Page {
    /// Starts to listen.
    pub(crate) fn open(address: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        let text = Arc::new(Mutex::new(String::new()));
        let shared = text.clone();
        std::thread::Builder::new().name("prometheus".to_owned()).spawn(move || {
            for stream in listener.incoming().flatten() {
                let text = shared.lock().unwrap_or_else(PoisonError::into_inner).clone();
                // It is not an error if the reader does not read.
                let _ = answer(stream, &text);
            }
        })?;
        Ok(Self { text })
    }

    /// Replaces the page.
    pub(crate) fn put(&self, report: &Report) {
        *self.text.lock().unwrap_or_else(PoisonError::into_inner) = page(report);
    }
}

fn answer(mut stream: TcpStream, text: &str) -> io::Result<()> {
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    // If a part of the request were left unread, the connection would be reset before the answer is received.
    let _ = stream.read(&mut [0; 4096])?;
    write!(
        stream,
        "HTTP/1.1 200 OK\r\nContent-Type: text/plain; version=0.0.4\r\nContent-Length: {}\r\n\
         Connection: close\r\n\r\n{text}",
        text.len()
    )
}

fn page(report: &Report) -> String {
    let run = &report.run;
    let mut page = String::new();
    let mut describe = |name: &str, kind: &str, help: &str, samples: &[(String, f64)]| {
        page += &format!("# HELP pathtune_{name} {help}\n# TYPE pathtune_{name} {kind}\n");
        for (labels, value) in samples {
            page += &format!("pathtune_{name}{{run=\"{run}\"{labels}}} {value}\n");
        }
    };
    let mut spans = Vec::new();
    for (hop, of) in report.hops.each() {
        for (quantile, ns) in ["0.5", "0.9", "0.99", "0.999", "1"].into_iter().zip(of.each()) {
            let labels = format!(",hop=\"{}\",quantile=\"{quantile}\"", hop.name());
            spans.push((labels, ns.1 as f64 * 1e-9));
        }
    }
    describe("hop_seconds", "gauge", "Latency of a hop over the last second.", &spans);
    let mut one = |name: &str, kind: &str, help: &str, value: f64| {
        describe(name, kind, help, &[(String::new(), value)]);
    };
    one("rate_hz", "gauge", "Ticks a second over the last second.", report.rate_hz);
    one("period_seconds", "gauge", "Median period.", report.period.p50_ns as f64 * 1e-9);
    one("jitter_seconds", "gauge", "Period's p99 less its median.", report.jitter_ns as f64 * 1e-9);
    if let Some(age_ns) = report.age_ns {
        let help = "Age of the last command when it was applied.";
        one("command_age_seconds", "gauge", help, age_ns as f64 * 1e-9);
    }
    one("ticks_total", "counter", "Ticks seen.", report.ticks as f64);
    one("missed_total", "counter", "Ticks that the monitor missed.", report.missed as f64);
    let help = "Commands applied later than the budget allows.";
    one("deadline_misses_total", "counter", help, report.deadline_misses as f64);
    one("implausible_total", "counter", "Spans left out.", report.implausible as f64);
    one("restarts_total", "counter", "Restarts of processes.", f64::from(report.restarts));
    one("batch", "gauge", "The batch.", report.batch as f64);
    one("attempt", "gauge", "The attempt at the batch.", f64::from(report.attempt));
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_handed_out_and_a_silent_reader_keeps_nobody_from_it() {
        let address = {
            let free = TcpListener::bind("127.0.0.1:0").unwrap();
            free.local_addr().unwrap()
        };
        let page = Page::open(address).unwrap();
        let report = Report { ticks: 12, run: "ab".to_owned(), ..Report::default() };
        page.put(&report);
        let _silent = TcpStream::connect(address).unwrap();
        let mut stream = TcpStream::connect(address).unwrap();
        stream.write_all(b"GET /metrics HTTP/1.1\r\n\r\n").unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        assert!(text.starts_with("HTTP/1.1 200 OK\r\n"), "{text}");
        assert!(text.contains("pathtune_ticks_total{run=\"ab\"} 12\n"), "{text}");
        assert!(text.contains("hop=\"end_to_end\",quantile=\"0.999\"} 0\n"), "{text}");
    }
}
