//! A vehicle's file from a recorded drive.
//!
//! Pure: no clock, no I/O, no log, no thread. The method, step by step:
//!
//! 1. The *speed loop* is fitted by output error: its model runs through the whole drive on the commands alone.
//! 2. *Steering* is fitted to the yaw rate from several starts: the chain runs on the commands, the speed is the measured one.
//! 3. From there, yaw rate and *windows of poses* of 3 s are fitted together, and with them the odometry's point.
//! 4. Keys whose 95 % interval is too wide keep the file's value: they are not identified.
//! 5. The same is done three times with two thirds of the drive, and the rest tells whether the new values predict better
//!    than the file's.
//!
//! All fits are by Levenberg–Marquardt with Huber's weights and a weak prior at the file's values. Intervals are the wider of
//! those from the curvature and from a linearised bootstrap over blocks of 3 s.

// Tests may read and write files, start threads, and know the time.
#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

mod compared;
mod computed;
mod drive;
mod fit;
mod identify;
mod levenberg;
mod prediction;
mod refusal;
mod rows;
mod slip;
mod speed;
mod steering;
mod units;

pub use compared::{Compared, Series, Window};
pub use drive::{Command, Drive, Odometry};
pub use identify::{Identification, NoiseFound, Options, Point, Residuals, identify};
pub use prediction::Prediction;
pub use refusal::Refusal;
pub use rows::Row;
