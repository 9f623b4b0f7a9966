//! Fewer points for the same line: only the extremes of a line are visible.

/// The largest number of points of a line in a picture.
pub(crate) const MOST_POINTS: usize = 1500;

/// The line with at most [`MOST_POINTS`] points. Every stretch keeps its ends and its extremes in both directions, so
/// that no spike is lost and no corner is cut.
pub(crate) fn decimate(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    // At most six points of a stretch are kept.
    const STRETCHES: usize = MOST_POINTS / 6;
    if points.len() <= MOST_POINTS {
        return points.to_vec();
    }
    let length = points.len().div_ceil(STRETCHES);
    let mut kept = Vec::with_capacity(MOST_POINTS);
    for stretch in points.chunks(length) {
        let mut places = [0, 0, 0, 0, 0, stretch.len() - 1];
        for (place, point) in stretch.iter().enumerate() {
            if point.0 < stretch[places[1]].0 {
                places[1] = place;
            }
            if point.0 > stretch[places[2]].0 {
                places[2] = place;
            }
            if point.1 < stretch[places[3]].1 {
                places[3] = place;
            }
            if point.1 > stretch[places[4]].1 {
                places[4] = place;
            }
        }
        places.sort_unstable();
        let mut last = None;
        for place in places {
            if last != Some(place) {
                kept.push(stretch[place]);
                last = Some(place);
            }
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spikes_and_ends_survive() {
        let mut points: Vec<_> =
            (0..100_000).map(|tick| (f64::from(tick), f64::from(tick % 7))).collect();
        points[51_234].1 = 99.0;
        points[51_235].1 = -99.0;
        let fewer = decimate(&points);
        assert!(fewer.len() <= MOST_POINTS);
        assert!(fewer.contains(&points[51_234]) && fewer.contains(&points[51_235]));
        assert_eq!((fewer.first(), fewer.last()), (points.first(), points.last()));
        assert!(fewer.is_sorted_by(|a, b| a.0 < b.0));
    }

    #[test]
    fn short_lines_stay_as_they_are() {
        let points = vec![(0.0, 1.0), (1.0, 1.0)];
        assert_eq!(decimate(&points), points);
        assert!(decimate(&[]).is_empty());
    }
}
