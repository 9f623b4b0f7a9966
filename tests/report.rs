//! The report of a run, in a real browser.

mod support;

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;
use support::Sandbox;

/// What a browser had to say about a page: messages on its console, and requests that the page made.
#[derive(Debug, PartialEq)]
struct Visit {
    console: Vec<String>,
    requests: Vec<String>,
}

#[test]
fn reports_open_in_a_browser_without_a_word_and_without_a_request() {
    let Some(browser) = browser() else { return };
    let sandbox = Sandbox::new();
    let visit = |page: &Path| visit(browser, &sandbox, page);

    // A page that does both, to see that it would be seen.
    let noisy = sandbox.path("noisy.html");
    let text = "<img src='http://example.com/x.png'><script>console.log('a word')</script>";
    fs::write(&noisy, text).unwrap();
    let seen = visit(&noisy);
    assert!(seen.console.iter().any(|line| line.contains("a word")), "{seen:?}");
    assert_eq!(seen.requests, ["http://example.com/x.png"]);

    let short = ["--episodes", "3", "--set", "learning.step_limit=10"];
    let noisy = ["--noise", "--set", "robust.holdout=1"];
    for (out, args) in [
        ("train", &[&["train", "lane_change"][..], &short].concat()),
        ("noise", &[&["train", "lane_change"][..], &short, &noisy].concat()),
        ("circuit", &vec!["validate", "circuit"]),
        ("grid", &vec!["grid", "lane_change"]),
    ] {
        let result = sandbox.run(&[&args[..], &["--out", out, "--quiet"]].concat());
        assert!(result.status.success(), "{}", sandbox.story(out, &result));
        let page = sandbox.path(out).join("report/index.html");
        let last = String::from_utf8_lossy(&result.stdout).lines().last().unwrap().to_owned();
        assert_eq!(last, format!("{out}/report/index.html"));
        let seen = visit(&page);
        assert_eq!(seen, Visit { console: Vec::new(), requests: Vec::new() }, "{out}");
        // The pictures are files, too, and the page holds them itself.
        let pictures = fs::read_dir(page.parent().unwrap()).unwrap().flatten();
        let pictures =
            pictures.filter(|entry| entry.path().extension().is_some_and(|it| it == "svg"));
        assert!(pictures.count() >= 3);
        let text = fs::read_to_string(&page).unwrap();
        assert!(text.matches("<svg").count() >= 3 && !text.contains("<script"));
    }

    // Again, from the folder alone.
    let output = sandbox.run(&["report", "circuit"]);
    assert!(output.status.success());
    assert_eq!(String::from_utf8_lossy(&output.stdout), "circuit/report/index.html\n");
    sandbox.assert_clean();
}

#[test]
fn a_folder_without_a_run_is_told_apart() {
    let sandbox = Sandbox::new();
    fs::create_dir(sandbox.path("empty")).unwrap();
    for (folder, part) in [("empty", "result.json"), ("none", "none")] {
        let output = sandbox.run(&["report", folder]);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(64), "{stderr}");
        assert!(stderr.contains(part) && stderr.trim_end().lines().count() == 1, "{stderr}");
    }
}

/// The browser, where there is one; where every test must run, there has to be.
fn browser() -> Option<&'static str> {
    let known = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
    let found = known.into_iter().find(|path| Path::new(path).exists());
    if found.is_none() {
        assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "no browser, and no skips");
        println!("skipped: no Chromium");
    }
    found
}

fn visit(browser: &str, sandbox: &Sandbox, page: &Path) -> Visit {
    let (profile, log) = (sandbox.path("profile"), sandbox.path("net.json"));
    let output = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"])
        .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
        .args(["--enable-logging=stderr", "--v=0", "--dump-dom"])
        .arg(format!("--user-data-dir={}", profile.display()))
        .arg(format!("--log-net-log={}", log.display()))
        .arg(format!("file://{}", page.display()))
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    let console = stderr.lines().filter(|line| line.contains(":CONSOLE:")).map(str::to_owned);
    let log: Value = serde_json::from_slice(&fs::read(&log).unwrap()).unwrap();
    let started = &log["constants"]["logEventTypes"]["URL_REQUEST_START_JOB"];
    let requests = log["events"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|event| event["type"] == *started)
        // What the browser asks for on its own account has no page as its origin.
        .filter(|event| event["params"]["initiator"] != "not an origin")
        .filter_map(|event| event["params"]["url"].as_str())
        .filter(|url| !url.starts_with("file:") && !url.starts_with("data:"))
        .map(str::to_owned);
    Visit { console: console.collect(), requests: requests.collect() }
}
