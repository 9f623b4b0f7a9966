//! Logs: one line per event, to the process's log file, to which the orchestrator has redirected its standard error.

use std::path::Path;
use std::sync::Mutex;

use tracing::level_filters::LevelFilter;
use tracing_subscriber::Layer;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::log_file::LogFile;

/// The variable that selects what is logged.
pub(crate) const LOG_VAR: &str = "PATHTUNE_LOG";

/// Starts logging to standard error; if that leads to a log in `folder`, this process keeps it below its limit.
pub(crate) fn init(folder: &Path) {
    match LogFile::of_standard_error(folder) {
        Some(log) => init_to(Mutex::new(log)),
        None => init_to(std::io::stderr),
    }
}

/// Starts logging. `PATHTUNE_LOG` selects what is logged: a level, and levels of single targets, such as
/// `warn,controller=debug`; `info` by default.
pub fn init_to<W>(writer: W)
where
    W: for<'a> MakeWriter<'a> + Send + Sync + 'static,
{
    let usual =
        Targets::new().with_default(LevelFilter::INFO).with_target("iceoryx2", LevelFilter::WARN);
    let asked = std::env::var(LOG_VAR).ok();
    let (filter, refused) = match asked.as_deref().map(str::parse::<Targets>) {
        None => (usual, None),
        Some(Ok(filter)) => (filter, None),
        Some(Err(why)) => (usual, Some(why)),
    };
    let lines = tracing_subscriber::fmt::layer().with_writer(writer).with_ansi(false);
    // Only tests start it twice, and it does no harm.
    let _ = tracing_subscriber::registry().with(lines.with_filter(filter)).try_init();
    if let Some(why) = refused {
        tracing::warn!("{LOG_VAR}={:?} is not understood: {why}", asked.unwrap_or_default());
    }
}
