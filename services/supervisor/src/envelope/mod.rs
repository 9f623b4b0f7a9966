//! The envelope: one score for a drive, which says how far the drive is from those that were calibrated on, and a
//! threshold whose rate of false alarms is bounded.
//!
//! Terms: a *channel* is one number of a drive that is looked at every 0.1 s ([`evidence`]). A channel's *deviation* is its
//! distance from the calibrated mean in calibrated standard deviations; its largest in a drive is divided by the *limit*,
//! the largest that calibrated drives had. The *score* S is the largest of these quotients over all channels ([`score`]).
//! The *threshold* is an order statistic of the scores of other calibrated drives ([`rank`], [`calibration`]).
//!
//! The promise holds for drives like those calibrated on, and for no others, whatever the dependence in time.

mod calibration;
mod evidence;
mod martingale;
mod rank;
mod score;

pub use calibration::{Calibration, DriveTrace};
pub use evidence::{Evidence, Look};
pub use martingale::Martingale;
pub use rank::{Guarantee, rank, supported_share};
pub use score::{Alarm, Envelope};
