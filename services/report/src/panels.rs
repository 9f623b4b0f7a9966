//! Small plots side by side, one for each parameter; and intervals, one below the other.

use crate::ReportError;
use crate::axis::{Axis, short};
use crate::canvas::{
    Anchor, BLUE, BOTTOM, Frame, GREY, LEFT, Legend, Marker, NAVY, Picture, Plot, RIGHT, Stroke,
    Surface, WIDE, block, picture, rule, text_width, write,
};

/// One of the small plots.
#[derive(Debug)]
pub(crate) struct Panel {
    /// Name of its parameter, with the unit.
    pub(crate) name: String,
    /// Value of the parameter, and the height above it.
    pub(crate) points: Vec<(f64, f64)>,
}

/// How the heights are shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Shown {
    /// As bars from 0.
    Bars,
    /// As points on a line.
    Points,
}

/// The largest number of plots in one row: with more, there would be no room for names and ticks.
const MOST_IN_A_ROW: usize = 4;

/// Small plots with a common vertical axis, so that they can be compared, in as many rows as they need.
pub(crate) fn panels(
    name: &str,
    words: &str,
    y_name: &str,
    panels: &[Panel],
    shown: Shown,
) -> Result<Picture, ReportError> {
    const GAP: f64 = 14.0;
    const TOP: f64 = 10.0;
    const HEIGHT: f64 = 190.0;
    let heights = panels.iter().flat_map(|panel| &panel.points).map(|point| point.1);
    let y = match shown {
        Shown::Bars => Axis::from_zero(heights, 4),
        Shown::Points => Axis::around(heights, 4),
    };
    let rows = panels.len().div_ceil(MOST_IN_A_ROW).max(1);
    let columns = panels.len().div_ceil(rows).max(1);
    let width = (WIDE - LEFT - RIGHT - GAP * (columns - 1) as f64) / columns as f64;
    let row_height = TOP + HEIGHT + BOTTOM;
    picture(name, words, (WIDE, row_height * rows as f64), |surface| {
        for (index, panel) in panels.iter().enumerate() {
            let (row, column) = (index / columns, index % columns);
            let left = LEFT + column as f64 * (width + GAP);
            let frame = Frame { left, top: TOP + row as f64 * row_height, width, height: HEIGHT };
            let x = places(panel, width);
            let y_name = if column == 0 { y_name } else { "" };
            let plot = Plot::new(surface, frame, (&x, &panel.name), (&y, y_name))?;
            let points: Vec<(f64, f64)> =
                panel.points.iter().enumerate().map(|(i, p)| (i as f64, p.1)).collect();
            match shown {
                Shown::Bars => bars(surface, &plot, &points)?,
                Shown::Points => {
                    let look = Stroke { marker: Some(Marker::Disc), ..Stroke::solid(NAVY, 1.4) };
                    plot.line(&points, &look)?;
                }
            }
        }
        Ok(())
    })
}

/// Values at equal distances, whatever their differences: an axis of places, with as many labels as there is room for.
fn places(panel: &Panel, width: f64) -> Axis {
    let count = panel.points.len().max(1);
    let labels: Vec<String> = panel.points.iter().map(|point| short(point.0)).collect();
    let widest = labels.iter().map(|label| text_width(label)).fold(10.0, f64::max) + 6.0;
    let each = (widest * count as f64 / width).ceil().max(1.0) as usize;
    let ticks = labels
        .into_iter()
        .enumerate()
        .filter(|(index, _)| index % each == 0)
        .map(|(index, label)| (index as f64, label))
        .collect();
    Axis { low: -0.6, high: count as f64 - 0.4, ticks }
}

fn bars(surface: &Surface, plot: &Plot, points: &[(f64, f64)]) -> Result<(), String> {
    for &(at, height) in points {
        let (corner, opposite) = (plot.place((at - 0.36, 0.0)), plot.place((at + 0.36, height)));
        block(surface, (corner.0, opposite.1), (opposite.0, corner.1), BLUE)?;
    }
    Ok(())
}

/// A mean and its interval.
#[derive(Debug)]
pub(crate) struct Interval {
    pub(crate) label: String,
    pub(crate) mean: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
}

/// Means with their intervals, one below the other.
pub(crate) fn intervals(
    name: &str,
    words: &str,
    x_name: &str,
    rows: &[Interval],
) -> Result<Picture, ReportError> {
    const ROW: f64 = 24.0;
    let x = Axis::around(rows.iter().flat_map(|row| [row.mean, row.low, row.high]), 7);
    // Rows are drawn from top to bottom, so the axis runs upwards from the last one.
    let y = Axis { low: -0.7, high: rows.len() as f64 - 0.3, ticks: Vec::new() };
    let labels = rows.iter().map(|row| text_width(&row.label)).fold(0.0, f64::max) + 16.0;
    let look = Stroke { marker: Some(Marker::Disc), ..Stroke::solid(NAVY, 1.8) };
    let legend = Legend::new([("mean and its interval", look)], WIDE);
    let frame = Frame {
        left: labels,
        top: legend.height(),
        width: WIDE - labels - RIGHT,
        height: ROW * rows.len() as f64 + 10.0,
    };
    let size = (WIDE, frame.top + frame.height + BOTTOM);
    picture(name, words, size, |surface| {
        legend.draw(surface)?;
        let plot = Plot::new(surface, frame, (&x, x_name), (&y, ""))?;
        for (index, row) in rows.iter().enumerate() {
            let height = (rows.len() - 1 - index) as f64;
            let (from, to) = (plot.place((row.low, height)), plot.place((row.high, height)));
            write(surface, &row.label, (frame.left - 8.0, from.1), Anchor::End)?;
            rule(
                surface,
                (frame.left, from.1),
                (from.0, from.1),
                &Stroke::dashed(GREY, 0.6, &[1.0, 4.0]),
            )?;
            for end in [from, to] {
                rule(surface, (end.0, end.1 - 4.0), (end.0, end.1 + 4.0), &look)?;
            }
            rule(surface, from, to, &look)?;
            plot.line(&[(row.mean, height)], &look)?;
        }
        Ok(())
    })
}
