//! What a file that is no table of numbers looks like.

/// The beginning of a file, and what such a file is.
const MAGIC: [(&[u8], &str); 26] = [
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"GIF8", "a GIF image"),
    (b"P5\n", "a PGM image"),
    (b"\x89MCAP", "an MCAP recording"),
    (b"#ROSBAG", "a bag of ROS 1"),
    (b"SQLite format 3", "an SQLite database, as a bag of ROS 2 may be"),
    (b"%PDF", "a PDF document"),
    (b"PK\x03\x04", "a ZIP archive, as a spreadsheet (.xlsx), a .kmz or an .npz is"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"\x28\xb5\x2f\xfd", "a zstd archive"),
    (b"7z\xbc\xaf", "a 7-Zip archive"),
    (b"\x93NUMPY", "a NumPy array (.npy)"),
    (b"\x89HDF", "an HDF5 file"),
    (b"PAR1", "a Parquet file"),
    (b"MATLAB 5.0", "a MATLAB file (.mat)"),
    (b"\xd0\xcf\x11\xe0", "an old Office document, as .xls is"),
    (b"\x00\x00\x27\x0a", "a shapefile"),
    (b"\x7fELF", "a program"),
    (b"\xff\xfe", "UTF-16 text"),
    (b"\xfe\xff", "UTF-16 text"),
    (b"# .PCD", "a point cloud (.pcd)"),
    (b"ply\n", "a point cloud (.ply)"),
    (b"$GP", "NMEA sentences of a receiver"),
    (b"$GN", "NMEA sentences of a receiver"),
    (b"\x80\x04", "a Python pickle"),
];

/// What a file looks like, if it is none that this reader understands.
pub(super) fn looks_like(bytes: &[u8]) -> Option<&'static str> {
    if let Some((_, what)) = MAGIC.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        return Some(what);
    }
    let start: String = bytes
        .iter()
        .take(4096)
        .map(|byte| char::from(byte.to_ascii_lowercase()))
        .collect::<String>()
        .trim_start()
        .to_owned();
    let has = |word: &str| start.contains(word);
    // Comments may say anything.
    let is_comment = |line: &&str| line.is_empty() || line.starts_with(['#', '/']);
    let mut lines = start.lines().map(str::trim_end).skip_while(is_comment);
    let (first, second) = (lines.next().unwrap_or_default(), lines.next().unwrap_or_default());
    if start.starts_with('<') {
        return Some(match () {
            () if has("<kml") => "KML",
            () if has("<opendrive") => "an OpenDRIVE map",
            () if has("<osm") => "an OpenStreetMap or Lanelet2 map",
            () if has("<commonroad") => "a CommonRoad scenario",
            () if has("<html") || has("<!doctype html") => "a web page",
            () => "XML",
        });
    }
    if start.starts_with('{') || (start.starts_with('[') && (has("[[") || has("[{") || has("[\n")))
    {
        return Some(if has("\"featurecollection\"") || has("\"linestring\"") {
            "GeoJSON"
        } else {
            "JSON"
        });
    }
    // A name, where a row of coordinates has numbers.
    let table = first.strip_prefix('[').and_then(|it| it.strip_suffix(']'));
    if table.is_some_and(|name| name.contains(char::is_alphabetic) && !name.contains([',', ' '])) {
        return Some("TOML");
    }
    // What belongs to a key is indented or a list; a title stands above a table.
    let is_key = first.ends_with(':') && second.starts_with([' ', '-']);
    if first == "---" || is_key || first.starts_with("%yaml") {
        return Some("YAML");
    }
    // Text has no zeros.
    bytes.iter().take(4096).any(|byte| *byte == 0).then_some("a binary file")
}

#[cfg(test)]
mod tests {
    use super::looks_like;

    #[test]
    fn files_of_other_kinds_are_named() {
        for (bytes, what) in [
            (&b"\x89PNG\r\n\x1a\n"[..], "a PNG image"),
            (b"{\"x\": [1, 2]}", "JSON"),
            (b"[[1, 2], [3, 4]]", "JSON"),
            (b"  {\"type\": \"FeatureCollection\"}", "GeoJSON"),
            (b"<?xml version='1.0'?><kml>", "KML"),
            (b"<html><body>404", "a web page"),
            (b"[vehicle]\nname = 1", "TOML"),
            (b"header:\n  seq: 1", "YAML"),
            (b"# recorded\n\nposes:\n- x: 1", "YAML"),
            (b"\xff\xfex\0,\0", "UTF-16 text"),
            (b"abc\0\0\x01", "a binary file"),
        ] {
            assert_eq!(looks_like(bytes), Some(what));
        }
        assert_eq!(looks_like(b"x_m,y_m\n1,2\n"), None);
        assert_eq!(looks_like(b"1 2\n3 4\n"), None);
        for table in [
            &b"# Raceline, columns:\nx_m,y_m\n0,0\n"[..],
            b"Raceline:\nx_m,y_m\n0,0\n",
            b"[0.0, 0.0]\n[1e0, 0.0]\n",
            b"[0.0 0.0]\n[1e0 0.0]\n",
        ] {
            assert_eq!(looks_like(table), None, "{}", table.escape_ascii());
        }
    }
}
