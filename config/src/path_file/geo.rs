//! Coordinates of the Earth as metres of a flat frame.

/// Equatorial radius of the Earth, and of the sphere of web-Mercator, m (WGS 84).
const RADIUS_M: f64 = 6_378_137.0;
/// The square of the ellipsoid's eccentricity (WGS 84).
const ECCENTRICITY_2: f64 = 6.694_379_990_141_316_5e-3;
/// The edge of the map of web-Mercator, π times the radius.
const EDGE_M: f64 = 20_037_508.35;
/// Beyond this a coordinate belongs to a grid of the Earth, and not to a map of one's own. A square of MGRS is as wide.
const FAR_M: f64 = 1e5;

/// Metres east and north of the first point, for points of (latitude, longitude) in degrees: the tangent plane's
/// coordinates of WGS 84's ellipsoid at height 0. Within 10 km of the first point lengths are true to a millionth.
pub(super) fn from_degrees(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    // Earth-centred, Earth-fixed.
    let fixed = |[lat_deg, lon_deg]: [f64; 2]| {
        let (lat, lon) = (lat_deg.to_radians(), lon_deg.to_radians());
        let (sin, cos) = (libm::sin(lat), libm::cos(lat));
        let normal_m = RADIUS_M / (1.0 - ECCENTRICITY_2 * sin * sin).sqrt();
        [
            normal_m * cos * libm::cos(lon),
            normal_m * cos * libm::sin(lon),
            normal_m * (1.0 - ECCENTRICITY_2) * sin,
        ]
    };
    let (lat, lon) = (points[0][0].to_radians(), points[0][1].to_radians());
    let origin = fixed(points[0]);
    let (sin_lat, cos_lat) = (libm::sin(lat), libm::cos(lat));
    let (sin_lon, cos_lon) = (libm::sin(lon), libm::cos(lon));
    let flat = |point: &[f64; 2]| {
        let at = fixed(*point);
        let [dx, dy, dz] = [at[0] - origin[0], at[1] - origin[1], at[2] - origin[2]];
        let east_m = cos_lon * dy - sin_lon * dx;
        let north_m = cos_lat * dz - sin_lat * (cos_lon * dx + sin_lon * dy);
        [east_m, north_m]
    };
    points.iter().map(flat).collect()
}

/// The cosine of the latitude at a northing of web-Mercator: the factor from its unit to a metre.
pub(super) fn mercator_scale(y_m: f64) -> f64 {
    1.0 / libm::cosh(y_m / RADIUS_M)
}

/// Metres from the first point, for points of web-Mercator, scaled by the cosine of its latitude.
pub(super) fn from_mercator(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let scale = mercator_scale(points[0][1]);
    relative(points).iter().map(|[x, y]| [scale * x, scale * y]).collect()
}

/// The points seen from the first one.
pub(super) fn relative(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let [x0, y0] = points[0];
    points.iter().map(|[x, y]| [x - x0, y - y0]).collect()
}

/// Whether these are coordinates of a grid of the Earth, and better kept from the first point on.
pub(super) fn is_far(points: &[[f64; 2]]) -> bool {
    points.iter().flatten().any(|it| it.abs() > FAR_M)
}

/// Whether coordinates may be web-Mercator's and cannot be UTM's, at a point of it.
pub(super) fn looks_like_mercator([x, y]: [f64; 2]) -> bool {
    x.abs().max(y.abs()) > FAR_M && x.abs() <= EDGE_M && y.abs() <= EDGE_M && !may_be_utm([x, y])
}

/// Whether a point may be one of UTM: an easting around 500 km within 3.5° of the middle meridian, and a northing from
/// the equator, or from 10,000 km below it.
fn may_be_utm([x, y]: [f64; 2]) -> bool {
    const DEGREE_M: f64 = 111_320.0;
    let reach_m = |lat_deg: f64| 3.5 * DEGREE_M * libm::cos(lat_deg.to_radians());
    let (north_deg, south_deg) = (y / 110_600.0, (1e7 - y) / 110_600.0);
    let half_m = [north_deg, south_deg]
        .into_iter()
        .filter(|it| (0.0..=85.0).contains(it))
        .map(reach_m)
        .fold(0.0, f64::max);
    (x - 500_000.0).abs() <= half_m
}

/// Whether a path whose "length" is this looks like one in degrees.
pub(super) fn looks_like_degrees(points: &[[f64; 2]]) -> bool {
    points.iter().all(|[a, b]| a.abs() <= 180.0 && b.abs() <= 180.0 && a.abs().min(b.abs()) <= 90.0)
        && points[0][0].abs().max(points[0][1].abs()) > 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degrees_become_metres() {
        // A degree of longitude and of latitude at 48°, after the series of the ellipsoid: 74,628 and 111,200 m.
        let flat = from_degrees(&[[48.0, 11.0], [48.0, 11.001], [48.001, 11.0]]);
        assert_eq!(flat[0], [0.0, 0.0]);
        assert!((flat[1][0] - 74.628).abs() < 0.01 && flat[1][1].abs() < 0.01, "{flat:?}");
        assert!((flat[2][1] - 111.2).abs() < 0.02 && flat[2][0].abs() < 1e-6, "{flat:?}");
    }

    #[test]
    fn web_mercator_is_told_from_utm() {
        // Munich, Zurich and Boston in web-Mercator; a place of Spain, one of Australia in UTM.
        for point in
            [[1_289_000.0, 6_131_000.0], [951_000.0, 6_002_000.0], [-7_909_000.0, 5_215_000.0]]
        {
            assert!(looks_like_mercator(point), "{point:?}");
        }
        for point in [
            [482_301.25, 4_419_876.5],
            [320_000.0, 6_250_000.0],
            [12.0, -900.0],
            [32_482_301.0, 5_400_000.0],
        ] {
            assert!(!looks_like_mercator(point), "{point:?}");
        }
        // At 47.5° a unit of web-Mercator is 0.676 m.
        let scale = mercator_scale(6_024_072.0);
        assert!((scale - 0.6756).abs() < 1e-3, "{scale}");
    }
}
