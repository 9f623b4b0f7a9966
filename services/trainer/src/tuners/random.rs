//! Random search: sets drawn evenly, none of them twice.

use config::RunConfig;

use crate::search::{Method, Point, Search, Space};

/// Sets that are drawn at a time.
const AT_A_TIME: usize = 64;

/// The tuner.
pub(super) fn new(config: &RunConfig) -> Search<Random> {
    Search::new(config, |_| Random)
}

/// Remembers nothing.
#[derive(Debug, Clone)]
pub(crate) struct Random;

impl Method for Random {
    fn propose(&mut self, space: &mut Space, room: usize) -> Vec<Point> {
        let mut points = Vec::new();
        while points.len() < room.min(AT_A_TIME) {
            let Some(point) = space.draw_new(&points) else { break };
            points.push(point);
        }
        points
    }
}
