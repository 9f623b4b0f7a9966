//! The latency monitor: looks into a running pipeline from another terminal, without slowing it.
//!
//! It is one more reader of odometry, raw commands and commands, and computes everything from the stamps that
//! these carry anyway: nobody in the pipeline does anything for it. [`latency`] is the pure part; [`report`] its
//! figures as they are put out; the rest reads the bus and draws.

pub mod latency;
