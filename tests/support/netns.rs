//! Hosts of our own: network namespaces whose interfaces have multicast, as those of a laboratory do.

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::Sandbox;

/// A network namespace. It lasts as long as this does.
pub struct Host(Child);

/// Two hosts with a cable between them. Skips where this user may have none.
pub fn hosts() -> Option<[Host; 2]> {
    let made = Host::new(None).and_then(|first| {
        let second = Host::new(Some(&first))?;
        let there = second.0.id();
        // Addresses of the block for documentation.
        first.run(&format!(
            "ip link set lo up && ip link add name eth0 type veth peer name eth0 netns {there} && \
             ip address add 192.0.2.1/24 dev eth0 && ip link set eth0 up && ip route add default dev eth0"
        ))?;
        second.run(
            "ip link set lo up && ip address add 192.0.2.2/24 dev eth0 && ip link set eth0 up && \
             ip route add default dev eth0",
        )?;
        Some([first, second])
    });
    if made.is_none() {
        let why = "this user may not have network namespaces, or `ip` is not installed";
        assert!(std::env::var_os("PATHTUNE_NO_SKIPS").is_none(), "{why}");
        eprintln!("skipped: {why}");
    }
    made
}

impl Host {
    /// A host without interfaces, whose owner is that of the other one.
    fn new(beside: Option<&Self>) -> Option<Self> {
        let mut command = match beside {
            None => Command::new("unshare"),
            Some(other) => other.enter("unshare"),
        };
        command.args(if beside.is_none() { &["--map-root-user", "--net"][..] } else { &["--net"] });
        // It ends with this process, whatever happens to it.
        let holder = command.arg("cat").stdin(Stdio::piped()).stderr(Stdio::null()).spawn().ok()?;
        let mut host = Self(holder);
        let until = Instant::now() + Duration::from_secs(5);
        loop {
            let name = std::fs::read_to_string(format!("/proc/{}/comm", host.0.id()));
            if name.is_ok_and(|name| name == "cat\n") {
                return Some(host);
            }
            if host.0.try_wait().unwrap().is_some() || Instant::now() > until {
                return None;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// A program on this host.
    pub fn enter(&self, program: impl AsRef<OsStr>) -> Command {
        let target = self.0.id().to_string();
        let mut command = Command::new("nsenter");
        command.args(["--preserve-credentials", "--user", "--net", "--target", &target, "--"]);
        command.arg(program);
        command
    }

    /// The binary on this host, in a sandbox.
    pub fn command(&self, sandbox: &Sandbox, args: &[&str]) -> Command {
        let plain = sandbox.command(args);
        let mut command = self.enter(plain.get_program());
        command
            .args(plain.get_args())
            .current_dir(plain.get_current_dir().unwrap_or(Path::new(".")));
        for (key, value) in plain.get_envs() {
            command.env(key, value.map(OsStr::to_owned).unwrap_or(OsString::new()));
        }
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    fn run(&self, script: &str) -> Option<()> {
        let output = self.enter("sh").args(["-c", script]).output().ok()?;
        if !output.status.success() {
            eprintln!("{script}: {}", String::from_utf8_lossy(&output.stderr));
        }
        output.status.success().then_some(())
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
