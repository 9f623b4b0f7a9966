//! Embeds every TOML file of this folder, so that a new law, tuner, objective, vehicle or manoeuvre is one file and
//! no row in a list.

use std::path::Path;
use std::{env, fs};

/// The folders that hold presets.
const FOLDERS: [&str; 6] = ["maneuvers", "vehicles", "laws", "tuners", "objectives", "launch"];

fn main() {
    let root = env::var("CARGO_MANIFEST_DIR").expect("set by cargo");
    let mut paths = vec!["readings.toml".to_owned()];
    for folder in FOLDERS {
        println!("cargo::rerun-if-changed={folder}");
        let files = fs::read_dir(Path::new(&root).join(folder)).expect("the folder exists");
        let mut names: Vec<String> = files
            .map(|file| file.expect("readable").file_name().into_string().expect("UTF-8"))
            .filter(|name| name.ends_with(".toml"))
            .collect();
        names.sort();
        paths.extend(names.into_iter().map(|name| format!("{folder}/{name}")));
    }
    let entries: String = paths
        .iter()
        .map(|path| format!("Preset {{ path: {path:?}, text: include_str!(concat!({root:?}, \"/\", {path:?})) }},\n"))
        .collect();
    let out = Path::new(&env::var("OUT_DIR").expect("set by cargo")).join("presets.rs");
    fs::write(out, format!("&[\n{entries}]")).expect("cargo's folder is writable");
}
