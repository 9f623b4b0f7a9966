//! The transport: how a process joins a run, sends and receives messages, waits, and gives signs of life.
//!
//! The only crate that uses iceoryx2, and the only one below the orchestrator that reads clocks. A process
//! [attaches](Attachment) to the run named by its environment, opens [`Outlet`]s and [`Inlet`]s on the
//! run's [`Bus`], and hands a [`Service`] to [`serve`], the one loop that all services share.

mod attachment;
mod bus;
pub mod chaos;
pub mod cleanup;
pub mod clock;
pub mod limits;
pub mod log_file;
pub mod logging;
pub mod observer;
pub mod periods;
pub mod ring;
pub mod run;
mod serve;
pub mod waiting;

pub use attachment::Attachment;
pub use bus::{Alarm, Bus, BusError, Inlet, Outlet, Received, Written, iox2_config};
pub use serve::{Counters, Service, join, serve};
pub use waiting::{Wait, Waiting};
