//! What can be said of a set of gains before it is driven: margins of the lateral loop, and regions around the path from
//! which it is certain to converge.
//!
//! The loop is that of the paper's law around the kinematic single track, with the reference that runs ahead of the car,
//! the dead time and the lag of the steering. Terms:
//!
//! - *lead*: how far the reference runs ahead of the tracked point. The law turns the car towards the reference, so the
//!   lead adds to the gain of the heading: at a steady speed v it is v/Kv.
//! - *additional dead time* Δ: by how much the dead time of the steering may grow until the loop oscillates.
//! - *region*: an ellipsoid of states that the loop does not leave and in which it converges.
//!
//! Pure: no clock, no files, no threads. All loops have a fixed order, so that results have the same bits everywhere.

// Tests may read and write files, start threads, and know the time.
#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_types))]

mod assessment;
mod car;
mod check;
mod file;
mod interior;
mod joints;
mod lateral;
mod law;
mod margin;
mod region;
mod segment;
mod simulated;
mod simulated_law;
mod small;
mod spectrum;
mod switches;
mod vertices;

pub use assessment::{AtSpeed, CLAIM, Certified, Extent, JointAtSpeed, SetAtSpeed, Subject};
pub use car::{Car, Gains};
pub use check::{Refusal, check};
pub use file::Certificate;
pub use joints::{Joint, Piece, Way, joints};
pub use lateral::{FRAGILE_BELOW_S, LateralLoop};
pub use law::LawLoop;
pub use margin::additional_dead_time_s;
pub use region::{Region, START};
pub use segment::Equilibrium;
pub use simulated::{LARGEST_LEVEL, STARTS, Simulated, Start};
pub use switches::zone_regions;
pub use vertices::{HEADING_RAD, Intervals, State};
