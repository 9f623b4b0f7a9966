//! Sobol points: sets spread more evenly than by chance, none of them twice.

use config::RunConfig;

use crate::search::{self, Method, Point, Search, Space};

/// Sets that are proposed at a time.
const AT_A_TIME: usize = 64;
/// Points in a row whose sets were driven, after which a set is drawn at random: the end of a grid is near.
const DRIVEN_IN_A_ROW: usize = 4096;

/// The tuner.
pub(super) fn new(config: &RunConfig) -> Search<Sobol> {
    Search::new(config, |space| Sobol { sequence: space.sobol(), next: 0 })
}

/// The sequence, and how far it was followed.
#[derive(Debug, Clone)]
pub(crate) struct Sobol {
    sequence: search::Sobol,
    next: u32,
}

impl Method for Sobol {
    fn propose(&mut self, space: &mut Space, room: usize) -> Vec<Point> {
        let mut points: Vec<Point> = Vec::new();
        while points.len() < room.min(AT_A_TIME) {
            let mut new = None;
            for _ in 0..DRIVEN_IN_A_ROW {
                let point = space.cube.evenly(&self.sequence.point(self.next));
                self.next = self.next.wrapping_add(1);
                if space.is_new(&point, &points) {
                    new = Some(point);
                    break;
                }
            }
            let Some(point) = new.or_else(|| space.draw_new(&points)) else { break };
            points.push(point);
        }
        points
    }

    fn state(&self) -> Vec<f64> {
        vec![f64::from(self.next)]
    }

    fn restore(&mut self, state: &[f64]) -> bool {
        let [next] = state else { return false };
        self.next = *next as u32;
        true
    }
}
