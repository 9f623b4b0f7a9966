//! How the reference pose advances along the path.

use std::sync::Arc;

use config::{Advance, RunConfig};

use crate::{Path, Pose};

/// The fastest that a reference's clock runs, in ticks of the clock in a tick of the vehicle. It runs faster than 1 only
/// beside a vehicle that cannot be stopped.
pub const FASTEST_CLOCK: f64 = 16.0;

/// The pose that the vehicle should have, tick by tick.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// Shared by all copies, so that the state of all vehicles of a fleet fits into the nearest cache.
    plan: Arc<Plan>,
    along_m: f64,
    /// Where its clock last started, and the path's own time there.
    origin_m: f64,
    origin_s: f64,
    /// The share of the path's speed at which it started: 0 from rest.
    origin_share: f64,
}

/// The part of a reference that never changes.
#[derive(Debug, Clone, PartialEq)]
struct Plan {
    path: Path,
    end: Pose,
    advance: Advance,
    lookahead_m: f64,
    speed_mps: f64,
    ramp_s: f64,
    /// The share of the path's speed at which a drive begins.
    start_share: f64,
    /// How far from a place along the path to look first for the stretch on which a vehicle stands, and how far from the
    /// path it may stand.
    window_m: f64,
    reach_m: f64,
    /// The times of a path with speeds of its own.
    timetable: Option<Timetable>,
    tick_s: f64,
}

/// When the reference passes each point of a path, at speeds that change evenly in time between them.
#[derive(Debug, Clone, PartialEq)]
struct Timetable {
    /// In the order of the points; the first time is 0.
    rows: Vec<TimetableRow>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct TimetableRow {
    time_s: f64,
    along_m: f64,
    speed_mps: f64,
}

impl Timetable {
    /// The timetable of a path with these speeds at its joints.
    fn new(path: &Path, speeds_mps: &[f64]) -> Self {
        let mut rows: Vec<TimetableRow> = Vec::with_capacity(speeds_mps.len());
        // The last point of a lap is the first one of the next.
        let (last, others) = speeds_mps.split_last().expect("a speed for each point");
        let of_laps = others.iter().cycle().take(others.len() * path.laps()).chain([last]);
        for (along_m, &speed_mps) in path.joints_m().zip(of_laps) {
            let time_s = rows.last().map_or(0.0, |last| {
                last.time_s + 2.0 * (along_m - last.along_m) / (last.speed_mps + speed_mps)
            });
            rows.push(TimetableRow { time_s, along_m, speed_mps });
        }
        Self { rows }
    }

    /// When the reference passes a place: the inverse of [`Timetable::along_m`].
    fn time_s(&self, along_m: f64) -> f64 {
        let behind = self.rows.partition_point(|row| row.along_m <= along_m);
        let last = self.rows[behind.saturating_sub(1)];
        let Some(next) = self.rows.get(behind) else { return last.time_s };
        let accel_mps2 = (next.speed_mps - last.speed_mps) / (next.time_s - last.time_s);
        let apart_m = along_m - last.along_m;
        // The root of v·t + a/2·t² = s, in the form that also holds for a = 0.
        let root_mps =
            (last.speed_mps * last.speed_mps + 2.0 * accel_mps2 * apart_m).max(0.0).sqrt();
        last.time_s + 2.0 * apart_m / (last.speed_mps + root_mps)
    }

    /// Speed at a place, which changes evenly in time between two points.
    fn speed_mps(&self, along_m: f64) -> f64 {
        let behind = self.rows.partition_point(|row| row.along_m <= along_m);
        let last = self.rows[behind.saturating_sub(1)];
        let Some(next) = self.rows.get(behind) else { return last.speed_mps };
        let share = (along_m - last.along_m) / (next.along_m - last.along_m);
        let (from, to) = (last.speed_mps * last.speed_mps, next.speed_mps * next.speed_mps);
        (from + share * (to - from)).max(0.0).sqrt()
    }

    /// Distance run after a time, held at the end.
    fn along_m(&self, time_s: f64) -> f64 {
        let behind = self.rows.partition_point(|row| row.time_s <= time_s);
        let last = self.rows[behind.saturating_sub(1)];
        let Some(next) = self.rows.get(behind) else { return last.along_m };
        let since_s = time_s - last.time_s;
        let accel_mps2 = (next.speed_mps - last.speed_mps) / (next.time_s - last.time_s);
        last.along_m + since_s * (last.speed_mps + 0.5 * accel_mps2 * since_s)
    }
}

impl Reference {
    /// With [`Advance::Projection`], how far from the last projection the next one is looked for.
    const WINDOW_M: f64 = 3.0;

    /// How far from the reference to look first for a vehicle that was stopped during its drive, and how far from the
    /// path it may stand, in wheelbases: 20 m and 12 m for a full-size car.
    const WINDOW_WHEELBASES: f64 = 7.0;
    const REACH_WHEELBASES: f64 = 4.0;

    /// The reference of a configuration, at the start of its path.
    pub fn new(config: &RunConfig) -> Self {
        let path = Path::new(&config.path);
        let speeds_mps = &config.path.speeds_mps;
        let timetable = (!speeds_mps.is_empty()).then(|| Timetable::new(&path, speeds_mps));
        let first_mps = speeds_mps.first().copied().unwrap_or(config.reference.speed_mps);
        let start_share = config.drive.start_speed_mps / first_mps;
        let plan = Plan {
            timetable,
            start_share,
            end: path.end(),
            path,
            advance: config.reference.advance,
            lookahead_m: config.reference.lookahead_m,
            speed_mps: config.reference.speed_mps,
            ramp_s: config.reference.ramp_s,
            window_m: Self::WINDOW_WHEELBASES * config.vehicle.wheelbase_m,
            reach_m: Self::REACH_WHEELBASES * config.vehicle.wheelbase_m,
            tick_s: config.drive.tick_s,
        };
        Self {
            plan: Arc::new(plan),
            along_m: 0.0,
            origin_m: 0.0,
            origin_s: 0.0,
            origin_share: start_share,
        }
    }

    /// Moves to a time of its clock, in ticks since it last started from rest, with the pose that was measured then, and
    /// returns the reference pose.
    pub fn advance(&mut self, phase_ticks: f64, measured: Pose) -> Pose {
        match self.plan.advance {
            Advance::Time => {
                self.along_m = self.distance_after(phase_ticks * self.plan.tick_s);
                self.plan.path.at(self.along_m)
            }
            Advance::Projection => {
                let (x_m, y_m) = (measured.x_m, measured.y_m);
                self.along_m =
                    self.plan.path.project(x_m, y_m, self.along_m, Self::WINDOW_M).along_m;
                self.plan.path.at(self.along_m + self.plan.lookahead_m)
            }
        }
    }

    /// Whether it moves by its clock, whatever the vehicle does; otherwise the vehicle pushes it ahead of itself.
    pub fn advances_by_time(&self) -> bool {
        self.plan.advance == Advance::Time
    }

    /// Returns to the start of the path.
    pub fn reset(&mut self) {
        self.resume_from(0.0);
    }

    /// Starts again from a place along the path, at rest, with the clock at 0.
    pub fn restart_at(&mut self, origin_m: f64) {
        // Never quite 0: that is where a drive begins, which may be rolling.
        self.resume_from(if self.plan.start_share > 0.0 {
            origin_m.max(f64::MIN_POSITIVE)
        } else {
            origin_m
        });
    }

    /// Goes on with a clock that last started at this place along the path: at rest, or where a drive begins at its speed.
    pub fn resume_from(&mut self, origin_m: f64) {
        self.origin_share = if origin_m == 0.0 { self.plan.start_share } else { 0.0 };
        self.origin_m = origin_m;
        self.origin_s = self.plan.timetable.as_ref().map_or(0.0, |it| it.time_s(origin_m));
        self.along_m = origin_m;
    }

    /// Where the clock last started from rest, along the path.
    pub fn origin_m(&self) -> f64 {
        self.origin_m
    }

    /// The place of the path on which a vehicle stands: the nearest one that the vehicle's heading fits, on the stretch
    /// around `near_m` along the path if there is one, else farther and farther away. `None` if no place within reach of
    /// the vehicle fits its heading.
    ///
    /// So the stretch decides before the distance: on a path that returns to its start, the vehicle is looked for where
    /// it was, not at the other end.
    pub fn leg_m(&self, pose: Pose, near_m: f64) -> Option<f64> {
        let Plan { path, window_m, reach_m, .. } = &*self.plan;
        let mut window_m = *window_m;
        loop {
            let low_m = (near_m - window_m).max(0.0);
            let high_m = (near_m + window_m).min(path.length_m());
            let found = path.project_along(pose, near_m, window_m).filter(|point| {
                // At an edge of the window that is no end of the path, the nearest point lies beyond it.
                let is_inside = (point.along_m > low_m || low_m == 0.0)
                    && (point.along_m < high_m || high_m == path.length_m());
                is_inside && apart_m(pose, point.pose) <= *reach_m
            });
            if found.is_some() || window_m >= path.length_m() {
                return found.map(|point| point.along_m);
            }
            window_m *= 2.0;
        }
    }

    /// The place of the path on which a vehicle stands, or the nearest one if there is none.
    pub fn projection_m(&self, pose: Pose) -> f64 {
        let anywhere =
            || self.plan.path.project(pose.x_m, pose.y_m, self.along_m, f64::INFINITY).along_m;
        self.leg_m(pose, self.along_m).unwrap_or_else(anywhere)
    }

    /// Progress along the path.
    pub fn along_m(&self) -> f64 {
        self.along_m.min(self.plan.path.length_m())
    }

    /// The path itself.
    pub fn path(&self) -> &Path {
        &self.plan.path
    }

    /// The place of the reference pose along the path, held at its end.
    pub fn pose_along_m(&self) -> f64 {
        (self.along_m + self.ahead_m()).min(self.plan.path.length_m())
    }

    /// How far the reference pose lies ahead of the progress: only with [`Advance::Projection`].
    fn ahead_m(&self) -> f64 {
        if self.plan.advance == Advance::Projection { self.plan.lookahead_m } else { 0.0 }
    }

    /// The reference's speed at a time of its clock, while the clock runs; 0 once it has come to the end of the path.
    pub fn speed_mps(&self, phase_ticks: f64) -> f64 {
        let Plan { speed_mps, ramp_s, tick_s, advance, .. } = &*self.plan;
        if *advance == Advance::Projection {
            return *speed_mps;
        }
        if self.at_end() {
            return 0.0;
        }
        let time_s = phase_ticks * tick_s;
        let from = self.origin_share;
        let share = if time_s < *ramp_s { from + (1.0 - from) * (time_s / ramp_s) } else { 1.0 };
        share * self.path_speed_mps(self.along_m)
    }

    /// The speed at which a place of the path is to be passed.
    pub fn path_speed_mps(&self, along_m: f64) -> f64 {
        let Plan { timetable, speed_mps, .. } = &*self.plan;
        timetable.as_ref().map_or(*speed_mps, |table| table.speed_mps(along_m))
    }

    /// The highest speed for a vehicle that pushes its reference ahead of itself, on a path with speeds of its own: the one
    /// at its place. Otherwise there is none, since the clock of the reference keeps the speed.
    pub fn bound_mps(&self) -> f64 {
        match (self.plan.advance, &self.plan.timetable) {
            (Advance::Projection, Some(table)) => table.speed_mps(self.along_m),
            _ => f64::INFINITY,
        }
    }

    /// Pose of the path's end.
    pub fn end(&self) -> Pose {
        self.plan.end
    }

    /// Whether the reference has reached the end of the path.
    pub fn at_end(&self) -> bool {
        self.along_m + self.ahead_m() >= self.plan.path.length_m()
    }

    /// Place along the path after a time: a linear ramp from rest or from the speed at which the drive begins, then the set
    /// speed, or the path's own.
    fn distance_after(&self, time_s: f64) -> f64 {
        let Plan { timetable, speed_mps, ramp_s, .. } = &*self.plan;
        // By how much it is ahead of a ramp from rest.
        let ramped_s = time_s.min(*ramp_s);
        let ahead_s = if self.origin_share == 0.0 || *ramp_s == 0.0 {
            0.0
        } else {
            self.origin_share * (ramped_s - 0.5 * ramped_s * ramped_s / ramp_s)
        };
        if let Some(timetable) = timetable {
            // The ramp stretches time, as it does at a set speed: each of the path's speeds is reached at its
            // place, and there is no jump at the end of the ramp.
            let at_speed_s = if time_s < *ramp_s {
                0.5 * time_s * time_s / ramp_s
            } else {
                time_s - 0.5 * ramp_s
            };
            return timetable.along_m(self.origin_s + (at_speed_s + ahead_s));
        }
        let run_m = if time_s < *ramp_s {
            0.5 * speed_mps * time_s * time_s / ramp_s
        } else {
            speed_mps * (time_s - 0.5 * ramp_s)
        };
        self.origin_m + (run_m + speed_mps * ahead_s)
    }
}

fn apart_m(a: Pose, b: Pose) -> f64 {
    libm::hypot(a.x_m - b.x_m, a.y_m - b.y_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Layers;

    fn lane_change(sets: &[&str]) -> Reference {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        for set in sets {
            layers.set(set).unwrap();
        }
        Reference::new(&layers.resolve().unwrap())
    }

    #[test]
    fn the_ramp_ends_at_the_set_speed() {
        let mut reference = lane_change(&[]);
        let measured = Pose::default();
        reference.advance(0.0, measured);
        assert_eq!(reference.along_m(), 0.0);
        reference.advance(100.0, measured);
        assert!((reference.along_m() - 0.75).abs() < 1e-12);
        reference.advance(300.0, measured);
        assert!((reference.along_m() - 3.75).abs() < 1e-12);
        assert!(!reference.at_end());
    }

    /// A straight of 10 m in 41 points, with the speed that `speed_mps` gives for each place.
    fn straight(ramp_s: f64, speed_mps: impl Fn(f64) -> f64) -> Reference {
        let mut layers = Layers::maneuver("lane_change").unwrap();
        layers.set(&format!("reference.ramp_s={ramp_s:?}")).unwrap();
        let mut config = layers.resolve().unwrap();
        let along = |index: i32| 0.25 * f64::from(index);
        config.path.pieces.clear();
        config.path.points = (0..=40).map(|index| [along(index), 0.0]).collect();
        config.path.speeds_mps = (0..=40).map(|index| speed_mps(along(index))).collect();
        Reference::new(&config)
    }

    #[test]
    fn the_reference_s_speed_follows_the_profile() {
        let profile = |along_m: f64| 1.0 + 0.8 * libm::sin(along_m);
        for ramp_s in [0.0, 1.0] {
            let mut reference = straight(ramp_s, profile);
            let mut last_m = reference.advance(0.0, Pose::default()).x_m;
            let mut ended = false;
            for tick in 1..3000 {
                let along_m = reference.advance(f64::from(tick), Pose::default()).x_m;
                let speed_mps = (along_m - last_m) / 0.01;
                let share = (0.01 * (f64::from(tick) - 0.5) / ramp_s).min(1.0);
                let wanted_mps = share * profile(0.5 * (along_m + last_m));
                if !reference.at_end() {
                    assert!(
                        (speed_mps - wanted_mps).abs() < 0.02,
                        "{tick}: {speed_mps} {wanted_mps}"
                    );
                    let told_mps = reference.speed_mps(f64::from(tick));
                    assert!((told_mps - speed_mps).abs() < 0.03, "{tick}: {told_mps} {speed_mps}");
                }
                ended |= reference.at_end();
                last_m = along_m;
            }
            assert!(ended);
            assert_eq!((last_m, reference.along_m()), (10.0, 10.0));
            reference.reset();
            assert_eq!(reference.advance(0.0, Pose::default()).x_m, 0.0);
        }
    }

    #[test]
    fn a_file_s_drive_lasts_until_the_reference_is_at_the_end_and_5_s_more() {
        let check = |path: &str, ramp_s: &str| {
            let folder = tempfile::tempdir().unwrap();
            let file = folder.path().join("p.csv");
            std::fs::write(&file, path).unwrap();
            let mut layers = Layers::maneuver("lane_change").unwrap();
            layers.set(&format!("reference.ramp_s={ramp_s}")).unwrap();
            layers.add_path(&file).unwrap();
            let config = layers.resolve().unwrap();
            let mut reference = Reference::new(&config);
            let end = (0..config.ticks()).find(|tick| {
                reference.advance(*tick as f64, Pose::default());
                reference.at_end()
            });
            let rest_s = config.drive.loop_time_s - 0.01 * end.unwrap() as f64;
            assert!((4.98..6.0).contains(&rest_s), "{path:?} {ramp_s}: {rest_s} s");
        };
        for ramp_s in ["0.0", "1.0", "20.0", "60.0"] {
            check("x_m,y_m\n0,0\n7,0\n14,1\n", ramp_s);
            check("x_m,y_m,v_mps\n0,0,0.2\n7,0,5\n14,1,0.3\n", ramp_s);
        }
    }

    #[test]
    fn an_even_profile_is_a_set_speed() {
        let (mut profile, mut set) = (straight(1.0, |_| 1.5), straight(1.0, |_| 1.5));
        Arc::make_mut(&mut set.plan).timetable = None;
        for tick in (0..700).map(f64::from) {
            let apart_m =
                profile.advance(tick, Pose::default()).x_m - set.advance(tick, Pose::default()).x_m;
            assert!(apart_m.abs() < 1e-12);
            assert_eq!(profile.at_end(), set.at_end());
        }
    }

    /// A reference on this path, for a car with a wheelbase of 1 m: it looks within 7 m first, and reaches 4 m.
    fn on(pieces: &str) -> Reference {
        lane_change(&[&format!("path.pieces={pieces}"), "vehicle.wheelbase_m=1.0"])
    }

    fn at(x_m: f64, y_m: f64, yaw_rad: f64) -> Pose {
        Pose { x_m, y_m, yaw_rad }
    }

    const BACK_RAD: f64 = std::f64::consts::PI;
    const HAIRPIN: &str = "[{kind='straight',length_m=12.0},{kind='arc',radius_m=0.8,angle_deg=180.0},\
        {kind='straight',length_m=12.0}]";

    #[test]
    fn a_vehicle_stands_on_the_leg_that_its_heading_fits() {
        let hairpin = on(HAIRPIN);
        let leg_m = |pose, near_m| hairpin.leg_m(pose, near_m).unwrap();
        // Nearer to the leg back, which is 1.6 m beside the leg there.
        assert!((leg_m(at(6.0, 1.0, 0.1), 6.0) - 6.0).abs() < 1e-9);
        assert!((leg_m(at(6.0, 1.0, 0.1), 20.0) - 6.0).abs() < 1e-9);
        let back_m = hairpin.path().length_m() - 6.0;
        assert!((leg_m(at(6.0, 0.6, BACK_RAD + 0.1), 6.0) - back_m).abs() < 1e-9);
        // A yaw that has wrapped is the same heading.
        assert!((leg_m(at(6.0, 0.6, -BACK_RAD), 6.0) - back_m).abs() < 1e-9);
        assert_eq!(hairpin.projection_m(at(6.0, 1.0, 0.1)), 6.0);
    }

    #[test]
    fn a_vehicle_that_no_leg_fits_stands_on_none() {
        let straight = on("[{kind='straight',length_m=50.0}]");
        assert_eq!(straight.leg_m(at(6.0, 0.0, BACK_RAD), 6.0), None);
        assert_eq!(straight.leg_m(at(6.0, 4.1, 0.0), 6.0), None);
        assert!(straight.leg_m(at(6.0, 3.9, 0.0), 6.0).is_some());
        // Farther along than it looks first, and where the window's edge is the nearest point but not the place.
        assert_eq!(straight.leg_m(at(30.0, 0.0, 0.0), 6.0), Some(30.0));
        assert_eq!(straight.leg_m(at(14.0, 0.0, 0.0), 6.0), Some(14.0));
        // Off the legs it is the nearest place, as where there is no choice.
        assert_eq!(straight.projection_m(at(6.0, 0.0, BACK_RAD)), 6.0);
    }

    #[test]
    fn on_a_path_that_returns_to_its_start_a_vehicle_is_looked_for_where_it_was() {
        let loop_m = std::f64::consts::TAU * 10.0;
        let circle = on("[{kind='arc',radius_m=10.0,angle_deg=360.0}]");
        for (near_m, expected_m) in
            [(0.0, 0.0), (20.0, 0.0), (loop_m - 20.0, loop_m), (loop_m, loop_m)]
        {
            let found_m = circle.leg_m(at(0.0, 0.0, 0.0), near_m).unwrap();
            assert!((found_m - expected_m).abs() < 1e-6, "{near_m}: {found_m}");
        }
        // Just behind the start, and far from the reference.
        assert_eq!(circle.leg_m(at(-0.1, 0.0, 0.0), 25.0), Some(0.0));
        assert_eq!(circle.leg_m(at(0.0, -50.0, 0.0), 0.0), None);
    }

    #[test]
    fn a_phase_need_not_be_whole() {
        let mut reference = lane_change(&[]);
        reference.advance(150.5, Pose::default());
        assert!((reference.along_m() - (0.75 + 1.5 * 0.505)).abs() < 1e-12);
        assert_eq!((reference.speed_mps(150.5), reference.speed_mps(50.5)), (1.5, 1.5 * 0.505));
    }

    #[test]
    fn a_projected_reference_keeps_its_distance() {
        let mut reference =
            lane_change(&["reference.advance=projection", "reference.lookahead_m=0.5"]);
        let pose = reference.advance(7.0, Pose { x_m: 0.2, y_m: 0.4, yaw_rad: 0.0 });
        assert!((pose.x_m - 0.7).abs() < 1e-12 && pose.y_m == 0.0);
    }
}
