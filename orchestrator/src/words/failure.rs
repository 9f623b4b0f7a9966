//! How a command ends when it does not succeed, and with which exit code.

use config::ConfigError;

/// How a command ends when it does not succeed.
#[derive(Debug)]
pub enum Failure {
    /// A drive was made, but did not arrive; why. Exit code 2.
    NotArrived(String),
    /// A user's mistake: one line that says what to do. Exit code 64.
    User(String),
    /// The pipeline could not be kept alive. Exit code 70.
    GaveUp(String),
    /// A job of a study failed for a reason that may pass. Exit code 75.
    TryAgain(String),
    /// A signal asked the run to stop; what it left and how to go on. Exit code 128 + the signal's number.
    Interrupted(i32, String),
    /// Anything else. Exit code 1.
    Other(anyhow::Error),
}

impl Failure {
    /// The exit code.
    pub fn code(&self) -> u8 {
        match self {
            Failure::NotArrived(_) => 2,
            Failure::User(_) => 64,
            Failure::GaveUp(_) => 70,
            Failure::TryAgain(_) => 75,
            Failure::Interrupted(signal, _) => 128 + *signal as u8,
            Failure::Other(_) => 1,
        }
    }

    /// The line that the user sees.
    pub fn message(&self) -> String {
        match self {
            Failure::NotArrived(why) => format!("the drive did not arrive: {why}"),
            Failure::User(message) | Failure::GaveUp(message) | Failure::TryAgain(message) => {
                message.clone()
            }
            Failure::Interrupted(_, left) => format!("interrupted; {left}"),
            Failure::Other(error) => format!("{error:#}"),
        }
    }
}

impl Failure {
    /// The same with other words, if it is a user's mistake or may pass.
    pub(crate) fn with(self, words: impl FnOnce(String) -> String) -> Self {
        match self {
            Failure::User(message) => Failure::User(words(message)),
            Failure::TryAgain(message) => Failure::TryAgain(words(message)),
            other => other,
        }
    }
}

impl From<ConfigError> for Failure {
    fn from(error: ConfigError) -> Self {
        Failure::User(error.to_string())
    }
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Failure::Other(error)
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        Failure::Other(error.into())
    }
}

impl From<runtime::BusError> for Failure {
    fn from(error: runtime::BusError) -> Self {
        Failure::Other(error.into())
    }
}

/// The advice for a user who wrote `word` instead of one of `names`: the nearest name, and all of them.
pub(crate) fn known<'a>(word: &str, names: impl IntoIterator<Item = &'a str>) -> String {
    let names: Vec<&str> = names.into_iter().collect();
    let all = names.join(", ");
    match config::nearest(word, names) {
        Some(near) => format!("did you mean {near}? There are {all}"),
        None => format!("there are {all}"),
    }
}
