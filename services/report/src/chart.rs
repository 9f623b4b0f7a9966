//! Lines over a common axis, and maps.

use tracking::Pose;

use crate::ReportError;
use crate::axis::{Axis, HUGE};
use crate::canvas::{
    BOTTOM, DASHES, Frame, GREY, INK, LEFT, Legend, Picture, Plot, RIGHT, Stroke, WIDE, badge,
    picture, rule,
};
use crate::decimate::decimate;

/// One line of a chart.
#[derive(Debug, Clone)]
pub(crate) struct Line {
    /// Its name in the legend; empty for a line that belongs to another one.
    pub(crate) label: String,
    pub(crate) points: Vec<(f64, f64)>,
    pub(crate) look: Stroke,
}

impl Line {
    /// A line with no more points than a picture needs.
    pub(crate) fn new(
        label: impl Into<String>,
        points: impl IntoIterator<Item = (f64, f64)>,
        look: Stroke,
    ) -> Self {
        let points: Vec<_> = points.into_iter().collect();
        Self { label: label.into(), points: decimate(&points), look }
    }
}

/// Lines over a common axis. The first line is on top.
pub(crate) struct Chart<'a> {
    pub(crate) name: &'a str,
    /// What the picture shows, for readers who cannot see it.
    pub(crate) words: &'a str,
    pub(crate) width: f64,
    pub(crate) height: f64,
    pub(crate) x: Axis,
    pub(crate) x_name: &'a str,
    pub(crate) y_name: &'a str,
    pub(crate) lines: &'a [Line],
    /// The least number of rows for the legend.
    pub(crate) legend_rows: usize,
    /// Borders between zones, each with its number.
    pub(crate) borders: &'a [(f64, String)],
}

impl Chart<'_> {
    pub(crate) fn draw(&self) -> Result<Picture, ReportError> {
        let y = Axis::around(self.lines.iter().flat_map(|line| &line.points).map(|p| p.1), 5);
        let legend = legend(self.lines, self.width).at_least(self.legend_rows);
        let top = legend.height() + if self.borders.is_empty() { 0.0 } else { 22.0 };
        let frame =
            Frame { left: LEFT, top, width: self.width - LEFT - RIGHT, height: self.height };
        picture(self.name, self.words, (self.width, top + self.height + BOTTOM), |surface| {
            legend.draw(surface)?;
            let plot = Plot::new(surface, frame, (&self.x, self.x_name), (&y, self.y_name))?;
            plot.verticals(self.borders, &Stroke::dashed(GREY, 0.9, DASHES[2]))?;
            self.lines.iter().rev().try_for_each(|line| plot.line(&line.points, &line.look))
        })
    }
}

fn legend(lines: &[Line], width: f64) -> Legend<'_> {
    let named = lines.iter().filter(|line| !line.label.is_empty());
    Legend::new(named.map(|line| (line.label.as_str(), line.look)), width)
}

/// Lines in the plane, with the same scale in both directions.
pub(crate) struct Map<'a> {
    pub(crate) name: &'a str,
    /// What the picture shows, for readers who cannot see it.
    pub(crate) words: &'a str,
    pub(crate) lines: &'a [Line],
    /// Where lines end.
    pub(crate) ends: &'a [((f64, f64), Stroke)],
    /// Where the zones begin, each with its number.
    pub(crate) borders: &'a [(Pose, String)],
}

impl Map<'_> {
    pub(crate) fn draw(&self) -> Result<Picture, ReportError> {
        let points = || self.lines.iter().flat_map(|line| &line.points);
        let (x, y, width, height) = equal_axes(points().map(|p| p.0), points().map(|p| p.1));
        let whole = (width + LEFT + RIGHT).max(360.0);
        let legend = legend(self.lines, whole);
        let top = legend.height() + if self.borders.is_empty() { 0.0 } else { 4.0 };
        let frame = Frame { left: LEFT, top, width, height };
        picture(self.name, self.words, (whole, top + height + BOTTOM), |surface| {
            legend.draw(surface)?;
            let plot = Plot::new(surface, frame, (&x, "x [m]"), (&y, "y [m]"))?;
            self.lines.iter().rev().try_for_each(|line| plot.line(&line.points, &line.look))?;
            for (end, look) in self.ends {
                plot.line(&[*end], look)?;
            }
            for (pose, label) in self.borders {
                let at = plot.place((pose.x_m, pose.y_m));
                // Pixels count downwards, so this is the left of the path.
                let left = (-pose.yaw_rad.sin(), -pose.yaw_rad.cos());
                let beside = |side: f64| (at.0 + side * left.0, at.1 + side * left.1);
                let inside = |p: (f64, f64)| {
                    (frame.left + 9.0..frame.left + width - 9.0).contains(&p.0)
                        && (top + 9.0..top + height - 9.0).contains(&p.1)
                };
                rule(surface, beside(-11.0), beside(11.0), &Stroke::solid(INK, 1.4))?;
                let side = if inside(beside(20.0)) { 20.0 } else { -20.0 };
                badge(surface, beside(side), label)?;
            }
            Ok(())
        })
    }
}

/// Both axes of a map, and the size of its plot: as large as possible, and never too narrow for its ticks.
fn equal_axes(
    x: impl Iterator<Item = f64>,
    y: impl Iterator<Item = f64>,
) -> (Axis, Axis, f64, f64) {
    const MOST: (f64, f64) = (WIDE - LEFT - RIGHT, 620.0);
    const LEAST: (f64, f64) = (240.0, 150.0);
    let span = |values: &mut dyn Iterator<Item = f64>| {
        let (low, high) = values
            .map(|value| value.clamp(-HUGE, HUGE))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high { (0.0, 0.0) } else { (low, high) }
    };
    let ((x_low, x_high), (y_low, y_high)) = (span(&mut { x }), span(&mut { y }));
    let largest = (x_high - x_low).max(y_high - y_low);
    let magnitude =
        [x_low, x_high, y_low, y_high].into_iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    // For a vehicle that stood still, the map shows a metre around it.
    let largest = if largest <= magnitude * 1e-9 { (magnitude * 0.1).max(1.0) } else { largest };
    let air = 0.05 * largest;
    let (dx, dy) = (x_high - x_low + 2.0 * air, y_high - y_low + 2.0 * air);
    let pixels_per_metre = (MOST.0 / dx).min(MOST.1 / dy);
    // Uses whole pixels, so that rounding does not stretch one of the directions.
    let width = (dx * pixels_per_metre).max(LEAST.0).round();
    let height = (dy * pixels_per_metre).max(LEAST.1).round();
    let axis = |low: f64, high: f64, pixels: f64| {
        let middle = 0.5 * low + 0.5 * high;
        let half = 0.5 * pixels / pixels_per_metre;
        Axis::between(middle - half, middle + half, (pixels / 90.0).ceil() as usize)
    };
    (axis(x_low, x_high, width), axis(y_low, y_high, height), width, height)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_metre_is_as_long_in_both_directions() {
        for (x, y) in [
            (vec![0.0, 7.0], vec![-3.5, 0.0]),
            (vec![0.0, 1.0], vec![0.0, 500.0]),
            (vec![0.0, 500.0], vec![0.0, 1.0]),
            (vec![3.0], vec![4.0]),
            (vec![], vec![]),
            (vec![-1e200, 1e200], vec![0.0, 1.0]),
        ] {
            let (x, y, width, height) = equal_axes(x.into_iter(), y.into_iter());
            let (across, up) = (width / (x.high - x.low), height / (y.high - y.low));
            assert!((across / up - 1.0).abs() < 1e-6, "{across} {up}");
            assert!((150.0..=900.0).contains(&width) && (150.0..=620.0).contains(&height));
        }
    }
}
