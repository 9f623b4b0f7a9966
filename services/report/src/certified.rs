//! The page of a certificate: from where the loop converges, and how much later the steering may act at which speed.

use maud::html;

use crate::ReportError;
use crate::axis::Axis;
use crate::canvas::{DASHES, GREY, HALF, Marker, NAVY, ORANGE, Picture, Stroke, WIDE};
use crate::chart::{Chart, Line};
use crate::page::{Page, slug};

/// What is told of gains before they are driven.
#[derive(Debug, Clone)]
pub struct CertifiedGains {
    /// Which gains these are, and where they come from.
    pub note: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// The regions: for each set and speed.
    pub regions: Vec<RegionPicture>,
    /// How much later the steering may act, over the speed.
    pub margins: Vec<MarginCurve>,
    /// Below this a set is fragile.
    pub fragile_below_s: f64,
    /// What is to be said with it.
    pub notes: Vec<String>,
}

/// The region of a set at a speed, on a straight.
#[derive(Debug, Clone)]
pub struct RegionPicture {
    /// The manoeuvre that the gains are for.
    pub maneuver: String,
    /// The speed of the reference.
    pub speed_mps: f64,
    /// P of the certified ellipsoid, of offset and heading: the cut where filter and wheels are straight. `None` without a
    /// certificate.
    pub p: Option<[[f64; 2]; 2]>,
    /// Offset and heading, both ways, of the region from which all of the simulated starts that looked for it came back.
    pub simulated: Option<(f64, f64)>,
    /// Simulated starts: offset, heading, and whether the loop came back.
    pub starts: Vec<(f64, f64, bool)>,
    /// Why there is no certificate.
    pub no_certificate: Option<String>,
}

/// Δ of a set over the speed.
#[derive(Debug, Clone)]
pub struct MarginCurve {
    /// The manoeuvre that the gains are for.
    pub maneuver: String,
    /// Speed and Δ, s: infinite where there is no bound, NaN where nothing is known.
    pub points: Vec<(f64, f64)>,
}

impl CertifiedGains {
    /// The largest Δ that is drawn: a slow car's is many times what matters, and where it is small would not show.
    fn most_shown_s(&self) -> f64 {
        let known = self.margins.iter().flat_map(|curve| &curve.points).map(|point| point.1);
        let least_s = known.filter(|it| it.is_finite()).fold(f64::INFINITY, f64::min);
        let enough_s = 5.0 * self.fragile_below_s;
        if least_s.is_finite() { enough_s.max(2.0 * least_s) } else { enough_s }
    }
}

/// The page, and its pictures.
pub(crate) fn page_of(it: &CertifiedGains) -> Result<(String, Vec<Picture>), ReportError> {
    let facts = html! {
        dl.facts {
            dt { "Vehicle" } dd { (it.vehicle) }
            dt { "Gains" } dd { (it.note) }
        }
    };
    let mut page = Page::titled(&format!("{}: before it is driven", it.vehicle), facts);
    let mut figures = Vec::new();
    for region in &it.regions {
        let caption = match &region.no_certificate {
            None => format!(
                "{} at {} m/s: from inside the ellipse the loop is certain to come back to a straight path, with filter and \
                 wheels straight at first. Points are simulated starts.",
                region.maneuver, region.speed_mps
            ),
            Some(why) => format!(
                "{} at {} m/s: {why}. Points are simulated starts.",
                region.maneuver, region.speed_mps
            ),
        };
        if region.p.is_some() || !region.starts.is_empty() {
            figures.push(page.figure(region_of(region)?, &caption));
        }
    }
    if !figures.is_empty() {
        page.section(
            "From where it comes back",
            html! { div.figures { @for it in &figures { (it) } } },
        );
    }
    let caption = "Additional dead time Δ: how much later than the vehicle’s file says the steering may act until the loop \
                   oscillates.";
    let caption = format!(
        "{caption} Nothing is drawn above {:.0} ms, or where it has no bound.",
        1000.0 * it.most_shown_s()
    );
    let margins = page.figure(margins_of(it)?, &caption);
    page.section("How late the steering may act", html! { div.figures { (margins) } });
    page.section("What that means", html! { ul { @for note in &it.notes { li { (note) } } } });
    Ok(page.finish_without_config())
}

/// The border of {xᵀ·P·x ≤ 1}.
fn ellipse(p: &[[f64; 2]; 2]) -> Vec<(f64, f64)> {
    const POINTS: u32 = 180;
    let point = |index: u32| {
        let angle = std::f64::consts::TAU * f64::from(index) / f64::from(POINTS);
        let (sin, cos) = angle.sin_cos();
        let value = p[0][0] * cos * cos + (p[0][1] + p[1][0]) * cos * sin + p[1][1] * sin * sin;
        (cos / value.sqrt(), sin / value.sqrt())
    };
    (0..=POINTS).map(point).collect()
}

fn region_of(it: &RegionPicture) -> Result<Picture, ReportError> {
    let points = |converges: bool| -> Vec<(f64, f64)> {
        let of = it.starts.iter().filter(|it| it.2 == converges);
        of.map(|(offset_m, heading_rad, _)| (*offset_m, *heading_rad)).collect()
    };
    let marks = |colour, marker| Stroke {
        marker: Some(marker),
        hidden: true,
        ..Stroke::solid(colour, 1.0)
    };
    let mut lines = Vec::new();
    if let Some(p) = &it.p {
        lines.push(Line::new("certain to come back", ellipse(p), Stroke::solid(NAVY, 2.0)));
    }
    if let Some((y, heading)) = it.simulated {
        let corners = [(y, heading), (-y, heading), (-y, -heading), (y, -heading), (y, heading)];
        lines.push(Line::new("simulated region", corners, Stroke::dashed(NAVY, 1.2, DASHES[1])));
    }
    for (label, converges, look) in [
        ("simulated, comes back", true, marks(GREY, Marker::Disc)),
        ("simulated, does not", false, marks(ORANGE, Marker::Cross)),
    ] {
        let points = points(converges);
        if !points.is_empty() {
            // One by one: a line with fewer points than there are would hide starts.
            lines.push(Line { label: label.to_owned(), points, look });
        }
    }
    let all = || lines.iter().flat_map(|line| &line.points);
    Chart {
        name: &format!("region-{}-{}", slug(&it.maneuver), slug(&format!("{}", it.speed_mps))),
        words: "Offset and heading from which the loop comes back to a straight path",
        width: HALF,
        height: 330.0,
        x: Axis::around(all().map(|point| point.0), 6),
        x_name: "offset y [m]",
        y_name: "heading θ [rad]",
        lines: &lines,
        legend_rows: 2,
        borders: &[],
    }
    .draw()
}

fn margins_of(it: &CertifiedGains) -> Result<Picture, ReportError> {
    let curves = it.margins.iter().enumerate().map(|(index, curve)| {
        let shown = curve.points.iter().filter(|point| point.1 <= it.most_shown_s());
        let points = shown.map(|(speed, margin_s)| (*speed, 1000.0 * margin_s));
        Line::new(&*curve.maneuver, points, Stroke { marker: None, ..Stroke::of_many(index) })
    });
    let mut lines: Vec<Line> = curves.collect();
    let speeds = || it.margins.iter().flat_map(|curve| &curve.points).map(|point| point.0);
    let (least, most) =
        speeds().fold((f64::INFINITY, 0.0_f64), |(low, high), it| (low.min(it), high.max(it)));
    if least < most {
        let fragile = [least, most].map(|speed| (speed, 1000.0 * it.fragile_below_s));
        lines.push(Line::new("fragile below", fragile, Stroke::dashed(GREY, 1.2, DASHES[2])));
    }
    Chart {
        name: "additional-dead-time",
        words: "Additional dead time over the speed",
        width: WIDE,
        height: 300.0,
        x: Axis::tight(speeds(), 8),
        x_name: "v [m/s]",
        y_name: "Δ [ms]",
        lines: &lines,
        legend_rows: 1,
        borders: &[],
    }
    .draw()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_border_is_where_v_is_1() {
        let p = [[4.0, 1.0], [1.0, 9.0]];
        for (y, heading) in ellipse(&p) {
            let value = 4.0 * y * y + 2.0 * y * heading + 9.0 * heading * heading;
            assert!((value - 1.0).abs() < 1e-12, "{value}");
        }
    }

    #[test]
    fn regions_starts_and_margins_are_drawn() {
        let region = RegionPicture {
            maneuver: "lane_change".to_owned(),
            speed_mps: 1.5,
            p: Some([[4.0, 0.0], [0.0, 16.0]]),
            simulated: Some((1.2, 0.4)),
            starts: vec![(0.3, 0.1, true), (1.5, -0.5, false)],
            no_certificate: None,
        };
        let points =
            vec![(0.5, f64::INFINITY), (0.7, 7.0), (1.0, 0.9), (2.0, 0.4), (3.0, f64::NAN)];
        let gains = CertifiedGains {
            note: "gains 3 21 21 0.7".to_owned(),
            vehicle: "mine".to_owned(),
            regions: vec![
                RegionPicture {
                    p: None,
                    no_certificate: Some("no certificate: late".into()),
                    speed_mps: 3.0,
                    ..region.clone()
                },
                region,
            ],
            margins: vec![MarginCurve { maneuver: "lane_change".to_owned(), points }],
            fragile_below_s: 0.2,
            notes: vec!["V falls.".to_owned()],
        };
        let (html, pictures) = page_of(&gains).unwrap();
        let names: Vec<&str> = pictures.iter().map(|it| &*it.name).collect();
        assert_eq!(names.len(), 3, "{names:?}");
        for part in ["no certificate: late", "V falls.", "Simulated starts", "mine"] {
            assert!(html.to_lowercase().contains(&part.to_lowercase()), "{part}");
        }
        for picture in &pictures {
            roxmltree::Document::parse(&picture.svg).unwrap();
            assert!(
                !picture.svg.contains("NaN") && !picture.svg.contains("inf"),
                "{}",
                picture.name
            );
        }
        for part in ["certain to come back", "simulated region"] {
            assert!(pictures[1].svg.contains(part), "{part}");
        }
        // What is far above the bound of fragile sets would make the axis too long to show it.
        assert!(html.contains("Nothing is drawn above 1000 ms"));
        assert!(!pictures[2].svg.contains("\n7000\n"), "{}", pictures[2].svg);
    }
}
