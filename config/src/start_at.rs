//! Where on a closed path a drive begins.

use std::fmt;
use std::str::FromStr;

use crate::ConfigError;
use crate::resample::{Resampled, headings};

/// Where a vehicle stands: a place in the path's frame, in metres, and its heading, if that is to decide between two
/// stretches that pass the place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StartAt {
    /// Forward along the frame's first axis.
    pub x_m: f64,
    /// To the left of it.
    pub y_m: f64,
    /// Counter-clockwise from it, in radians.
    pub yaw_rad: Option<f64>,
}

/// How far from the path a vehicle may stand: farther off, the place belongs to another path or another frame.
const FARTHEST_M: f64 = 10.0;

impl FromStr for StartAt {
    type Err = String;

    /// `X,Y` or `X,Y,YAW`.
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|it| it.trim().parse()).collect();
        match numbers.as_deref() {
            Ok(numbers) if numbers.iter().any(|it| !it.is_finite()) => {}
            Ok(&[_, _, yaw_rad]) if yaw_rad.abs() > std::f64::consts::TAU => {
                return Err(format!(
                    "the heading {yaw_rad} is more than a full turn; give it in radians: {yaw_rad}° is {:.4}",
                    yaw_rad.to_radians()
                ));
            }
            Ok(&[x_m, y_m]) => return Ok(Self { x_m, y_m, yaw_rad: None }),
            Ok(&[x_m, y_m, yaw_rad]) => return Ok(Self { x_m, y_m, yaw_rad: Some(yaw_rad) }),
            _ => {}
        }
        Err("give X,Y in metres, or X,Y,YAW with the heading in radians, as 12.5,-3,1.57"
            .to_owned())
    }
}

impl fmt::Display for StartAt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}, {})", self.x_m, self.y_m)
    }
}

impl Resampled {
    /// Lets a closed path begin at the point nearest to a place, of those whose heading is within 90° of the place's.
    ///
    /// # Errors
    /// If the path is not closed, or no such point is near.
    pub(crate) fn begin_at(&mut self, origin: &str, start: StartAt) -> Result<(), ConfigError> {
        let mistake = |problem: String| Err(ConfigError::new("--start", "", problem));
        let count = self.points.len() - 1;
        if self.points[0] != self.points[count] {
            let problem = format!(
                "asks for a start on the way, but {origin} is not closed: only a path that ends where it begins can be \
                 started anywhere"
            );
            return mistake(problem);
        }
        let apart_m = |point: &[f64; 2]| libm::hypot(point[0] - start.x_m, point[1] - start.y_m);
        let is_along = |yaw_rad: f64| {
            start.yaw_rad.is_none_or(|wanted_rad| libm::cos(yaw_rad - wanted_rad) > 0.0)
        };
        let all_headings = headings(&self.points);
        let nearest = (0..count)
            .filter(|&index| is_along(all_headings[index]))
            .min_by(|&a, &b| apart_m(&self.points[a]).total_cmp(&apart_m(&self.points[b])));
        let Some(nearest) = nearest.filter(|&it| apart_m(&self.points[it]) <= FARTHEST_M) else {
            let heading = if start.yaw_rad.is_some() { " that leads in its direction" } else { "" };
            let problem = format!(
                "names {start}, but no point of {origin}{heading} is within {FARTHEST_M} m of it; give a place on the path, in \
                 its frame"
            );
            return mistake(problem);
        };
        turn(&mut self.points, nearest);
        turn(&mut self.given, nearest);
        if !self.speeds_mps.is_empty() {
            turn(&mut self.speeds_mps, nearest);
        }
        if !self.widths_m.is_empty() {
            turn(&mut self.widths_m, nearest);
        }
        self.yaw_rad = all_headings[nearest];
        Ok(())
    }
}

/// Lets a list whose last element stands for its first begin at another element.
fn turn<T: Copy>(closed: &mut Vec<T>, first: usize) {
    closed.pop();
    closed.rotate_left(first);
    closed.push(closed[0]);
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI, TAU};

    use super::*;
    use crate::resample::resample;

    /// A figure eight: it passes (0, 0) twice.
    fn eight() -> Resampled {
        let points: Vec<[f64; 2]> = (0..=200)
            .map(|index| {
                let angle = TAU * f64::from(index % 200) / 200.0;
                [20.0 * angle.sin(), 10.0 * (2.0 * angle).sin()]
            })
            .collect();
        let speeds: Vec<f64> =
            (0..=200).map(|index| 1.0 + f64::from(index % 200) / 100.0).collect();
        resample(&points, &speeds, 100_000)
    }

    #[test]
    fn the_nearest_point_with_the_right_heading_comes_first() {
        let whole = eight();
        for (yaw_rad, speed_mps) in
            [(Some(FRAC_PI_2 / 2.0), 1.0), (Some(PI - FRAC_PI_2 / 2.0), 2.0)]
        {
            let mut path = eight();
            path.begin_at("p.csv", StartAt { x_m: 0.3, y_m: 0.1, yaw_rad }).unwrap();
            assert_eq!(path.points.first(), path.points.last());
            assert_eq!(path.points.len(), whole.points.len());
            assert!((path.speeds_mps[0] - speed_mps).abs() < 0.05, "{}", path.speeds_mps[0]);
            assert!(libm::hypot(path.points[0][0], path.points[0][1]) < 0.5);
            // Only the order has changed.
            let sorted = |path: &Resampled| {
                let mut points = path.points[1..].to_vec();
                points.sort_by(|a, b| a.partial_cmp(b).unwrap());
                points
            };
            assert_eq!(sorted(&path), sorted(&whole));
            let step =
                [path.points[1][0] - path.points[0][0], path.points[1][1] - path.points[0][1]];
            let ahead_rad = libm::atan2(step[1], step[0]);
            assert!(libm::cos(ahead_rad - path.yaw_rad) > 0.99);
        }
    }

    #[test]
    fn a_place_that_does_not_fit_is_refused() {
        let far = eight().begin_at("p.csv", StartAt { x_m: 90.0, y_m: 0.0, yaw_rad: None });
        assert!(far.unwrap_err().to_string().contains("(90, 0)"));
        let mut open = resample(&[[0.0, 0.0], [10.0, 0.0], [20.0, 1.0]], &[], 1000);
        let refused = open.begin_at("p.csv", StartAt { x_m: 5.0, y_m: 0.0, yaw_rad: None });
        assert!(refused.unwrap_err().to_string().contains("p.csv is not closed"));
        for text in ["1", "1,2,3,4", "a,b", "1,inf", "", "1,2,177"] {
            assert!(text.parse::<StartAt>().is_err(), "{text}");
        }
        assert_eq!("1, -2,3".parse(), Ok(StartAt { x_m: 1.0, y_m: -2.0, yaw_rad: Some(3.0) }));
    }
}
