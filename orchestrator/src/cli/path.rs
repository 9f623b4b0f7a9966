//! The options that say how the file of `--path` is read.

use clap::Args;
use config::{Columns, Crs, PathOptions};

/// How the file of `--path` is read, and what is made of it.
#[derive(Debug, Clone, Args)]
pub struct PathReading {
    /// Which columns of the path's file hold what, counted from 1 or by name: x=1,y=2,v=5, x_cm=2,y_cm=3, v_kmh=4,
    /// lat=1,lon=2 [default: by the header, or told if there is none]
    #[arg(long, value_name = "x=1,y=2,…", requires = "path")]
    pub columns: Option<Columns>,
    /// What the path's coordinates are: metres (of any flat frame, as UTM), web-mercator, or wgs84 (degrees) [default: by
    /// their names and sizes]
    #[arg(long, value_name = "CRS", requires = "path")]
    pub crs: Option<Crs>,
    /// Smooths a path that was measured with noise; the line may lie this far from the points at the mean, in metres
    /// [default: only where points lie to and fro, or noise makes turns that the car cannot drive]
    #[arg(long, value_name = "METRES", requires = "path", value_parser = metres)]
    pub smooth: Option<f64>,
    /// The topic of the path, if --path is a bag of ROS 2 in MCAP: a nav_msgs/Path, or an odometry [default: the only one]
    #[arg(long, value_name = "TOPIC", requires = "path")]
    pub path_topic: Option<String>,
    /// Lowers the speeds of the path to what the vehicle can drive: its limits sideways, forwards and when braking; v_mps,
    /// or reference.speed_mps, bounds them from above
    #[arg(long, requires = "path")]
    pub speed_profile: bool,
}

impl PathReading {
    /// The same as the reader of paths takes it.
    pub fn options(&self) -> PathOptions {
        PathOptions {
            columns: self.columns.clone(),
            crs: self.crs,
            smooth_m: self.smooth,
            speed_profile: self.speed_profile,
        }
    }
}

fn metres(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(metres) if metres > 0.0 && metres <= 10.0 => Ok(metres),
        _ => Err("is not a distance above 0 and up to 10 m".to_owned()),
    }
}
