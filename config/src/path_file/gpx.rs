//! The track or route of a GPX file (topografix.com/GPX/1/1): latitude and longitude of its points.
//!
//! Read by its tags alone, without the structure around them: a track's points (`trkpt`), else a route's (`rtept`).

/// A point's line, latitude and longitude in degrees.
pub(super) type GpxPoint = (usize, [f64; 2]);

/// Whether a text is a GPX file.
pub(super) fn is_gpx(text: &str) -> bool {
    let start = text.trim_start();
    start.starts_with('<') && start.get(..start.len().min(4096)).unwrap_or(start).contains("<gpx")
}

/// The points of a track, or else of a route.
///
/// # Errors
/// With the line of the first point that is incomplete, or without one if there are no points; and with the line of a second
/// track: two of them are two drives, and no line leads from one to the other.
pub(super) fn points(text: &str) -> Result<Vec<GpxPoint>, (usize, String)> {
    let text = without_comments(text);
    for (tag, whole, words) in [("trkpt", "trk", "tracks"), ("rtept", "rte", "routes")] {
        let points = with_tag(&text, tag)?;
        if points.is_empty() {
            continue;
        }
        // Those that hold a point.
        let open = format!("<{tag}");
        let starts = starts(&text, whole);
        let held: Vec<usize> = (0..starts.len())
            .filter(|&at| {
                let end = starts.get(at + 1).copied().unwrap_or(text.len());
                text[starts[at]..end].contains(&open)
            })
            .collect();
        if let [_, second, ..] = held[..] {
            let lines = text[..starts[second]].bytes().filter(|byte| *byte == b'\n').count();
            let problem = format!(
                "begins the second of {} {words}, and a path is one; leave the one in the file that is to be driven",
                held.len()
            );
            return Err((lines + 1, problem));
        }
        return Ok(points);
    }
    Err((1, "is a GPX file without points of a track (trkpt) or a route (rtept)".to_owned()))
}

/// Where elements of this name begin.
fn starts(text: &str, name: &str) -> Vec<usize> {
    let open = format!("<{name}");
    let is_whole =
        |at: &usize| text[at + open.len()..].starts_with(|c: char| c.is_whitespace() || c == '>');
    text.match_indices(&open).map(|(at, _)| at).filter(is_whole).collect()
}

/// The text with its comments blanked, so that lines keep their numbers.
fn without_comments(text: &str) -> String {
    let mut kept = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(from) = rest.find("<!--") {
        kept.push_str(&rest[..from]);
        let to = rest[from..].find("-->").map_or(rest.len(), |to| from + to + 3);
        kept.extend(rest[from..to].chars().filter(|c| *c == '\n'));
        rest = &rest[to..];
    }
    kept.push_str(rest);
    kept
}

fn with_tag(text: &str, tag: &str) -> Result<Vec<GpxPoint>, (usize, String)> {
    let open = format!("<{tag}");
    let mut points = Vec::new();
    let (mut line, mut counted) = (1, 0);
    for (at, _) in text.match_indices(&open) {
        line += text[counted..at].bytes().filter(|byte| *byte == b'\n').count();
        counted = at;
        let rest = &text[at + open.len()..];
        if !rest.starts_with(|c: char| c.is_whitespace()) {
            continue;
        }
        let inside = &rest[..rest.find('>').unwrap_or(rest.len())];
        let degrees = |name: &str, most: f64| {
            let value = attribute(inside, name).ok_or_else(|| {
                (line, format!("holds a {tag} without {name}; write it in degrees"))
            })?;
            match value.trim().parse::<f64>() {
                Ok(degrees) if degrees.abs() <= most => Ok(degrees),
                _ => Err((
                    line,
                    format!("{name} is {value:?}, but must be a number of degrees up to {most}"),
                )),
            }
        };
        points.push((line, [degrees("lat", 90.0)?, degrees("lon", 180.0)?]));
    }
    Ok(points)
}

/// The value of an attribute among those of a tag.
fn attribute<'a>(inside: &'a str, name: &str) -> Option<&'a str> {
    let (at, _) = inside.match_indices(name).find(|(at, _)| {
        let before = inside[..*at].chars().next_back();
        before.is_none_or(char::is_whitespace)
            && inside[at + name.len()..].trim_start().starts_with('=')
    })?;
    let value = inside[at + name.len()..].trim_start().strip_prefix('=')?.trim_start();
    let quote = value.chars().next().filter(|c| matches!(c, '"' | '\''))?;
    value[1..].split(quote).next()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_track_is_read_before_a_route() {
        let gpx = "<?xml version=\"1.0\"?>\n<gpx><!-- <trkpt lat='1' lon='2'/>\n -->\n<rte><rtept lat='9' lon='9'/></rte>\n\
                   <trk><trkseg>\n<trkpt lat=\"48.1\" lon=\"11.5\"><ele>500</ele></trkpt>\n<trkpt\n lon='11.6' lat='48.2'/>\n";
        assert!(is_gpx(gpx));
        assert_eq!(points(gpx), Ok(vec![(6, [48.1, 11.5]), (7, [48.2, 11.6])]));
        assert!(
            points("<gpx>\n<wpt lat='1' lon='2'/></gpx>").unwrap_err().1.contains("without points")
        );
        let wrong = points("<gpx>\n<trkpt lat='91' lon='2'/></gpx>").unwrap_err();
        assert_eq!((wrong.0, wrong.1.contains("lat is \"91\"")), (2, true));
        assert!(points("<gpx><trkpt lat='1'></gpx>").unwrap_err().1.contains("without lon"));
    }

    #[test]
    fn two_tracks_are_two_paths() {
        let track = |lat: f64| {
            format!(
                "<trk><name>x</name><trkseg>\n<trkpt lat='{lat}' lon='1'/></trkseg>\n<trkseg><trkpt lat='2' lon='1'/></trkseg></trk>\n"
            )
        };
        let two = points(&format!("<gpx>\n{}<trk></trk>{}</gpx>", track(1.0), track(1.5)));
        let (line, problem) = two.unwrap_err();
        assert_eq!(line, 5);
        assert!(problem.contains("second of 2 tracks"), "{problem}");
        // Parts of one, as where a receiver lost its satellites, and empty ones are no others.
        let one = points(&format!("<gpx>{}<trk></trk></gpx>", track(1.0)));
        assert_eq!(one.unwrap().len(), 2);
    }
}
