//! Why a drive that was requested does not begin.

/// Who else is on the topic of the commands.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Around {
    /// Somebody receives the commands.
    pub is_heard: bool,
    /// A command has been acknowledged, or whoever receives them acknowledges none.
    pub is_answered: bool,
    /// How many others send commands.
    pub other_drivers: usize,
}

/// How far the car is from the start of the path.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Offset {
    /// In position.
    pub distance_m: f64,
    /// In heading, absolute.
    pub heading_rad: f64,
}

/// What a drive waits for before it begins.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Waits {
    /// It is not known where the car is.
    #[error("the drive waits for odometry")]
    Odometry,
    /// It is not known whether commands arrive.
    #[error(
        "the drive waits for somebody to acknowledge a command: whoever receives them does not answer"
    )]
    Answer,
    /// Commands would go nowhere.
    #[error("the drive waits for somebody who receives the commands")]
    Subscriber,
    /// Another publisher sends commands.
    #[error("the drive waits for the other publisher of commands to stop")]
    OtherDriver,
    /// The car is not at rest.
    #[error("the drive waits for the car to stand still: it drives at {speed_mps:.2} m/s")]
    Standstill {
        /// Its speed.
        speed_mps: f64,
    },
    /// The car is elsewhere.
    #[error(
        "the drive waits for the car to stand at the path's start: it is {:.2} m and {:.2} rad off",
        .0.distance_m, .0.heading_rad
    )]
    Start(Offset),
}
