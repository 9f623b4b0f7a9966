//! Logs: one line an event, to standard error, which the orchestrator turns into the process's log file.

use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::MakeWriter;

/// Starts logging to standard error.
pub fn init() {
    init_to(std::io::stderr);
}

/// Starts logging. `PATHTUNE_LOG` chooses what is told (as `tracing`'s filters do); `info` by default.
pub fn init_to<W>(writer: W)
where
    W: for<'a> MakeWriter<'a> + Send + Sync + 'static,
{
    let filter = EnvFilter::try_from_env("PATHTUNE_LOG")
        .unwrap_or_else(|_| EnvFilter::new("info,iceoryx2=warn"));
    // Starting it twice is a test's doing, and harmless.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(writer)
        .with_ansi(false)
        .try_init();
}
