//! What a control law may look at in one tick.

use std::cell::Cell;

use config::RunConfig;
use tracking::{Path, PathPoint, Pose, Reference, TrackingError, tracking_error};

/// What a control law may look at in one tick. Everything comes from the measured pose, never from the true one.
///
/// Fields are known anyway; what has to be computed is a method, and costs nothing to a law that does not call it.
#[derive(Debug, Clone)]
pub struct Sight<'a> {
    /// The error against the reference pose of this tick, in the vehicle frame.
    pub error: TrackingError,
    /// The measured pose of the tracked point, in the map frame.
    pub pose: Pose,
    /// Forward speed.
    pub speed_mps: f64,
    /// Yaw rate, counter-clockwise.
    pub yaw_rate_radps: f64,
    /// The reference pose of this tick, in the map frame.
    pub reference_pose: Pose,
    reference: &'a Reference,
    tick: u64,
    tracked_point_m: f64,
    wheelbase_m: f64,
    /// Where the last projection was, along the path: the search for the next one starts from it.
    near_m: Cell<f64>,
}

impl<'a> Sight<'a> {
    /// How far beyond a wheelbase from the last projection the next one is looked for: more than a car drives in a
    /// tick, as its axles are projected in turn.
    const WINDOW_M: f64 = 3.0;

    /// The sight at `tick` of the reference's clock, for which `reference` has advanced to `reference_pose`.
    pub fn new(
        config: &RunConfig,
        reference: &'a Reference,
        tick: u64,
        reference_pose: Pose,
        pose: Pose,
        speed_mps: f64,
        yaw_rate_radps: f64,
    ) -> Self {
        let vehicle = &config.vehicle;
        Self::of_vehicle(vehicle.tracked_point_m, vehicle.wheelbase_m, reference, tick).with(
            reference_pose,
            pose,
            speed_mps,
            yaw_rate_radps,
            reference.projection_m(pose),
        )
    }

    #[inline]
    pub(crate) fn of_vehicle(
        tracked_point_m: f64,
        wheelbase_m: f64,
        reference: &'a Reference,
        tick: u64,
    ) -> Self {
        Self {
            error: TrackingError::default(),
            pose: Pose::default(),
            speed_mps: 0.0,
            yaw_rate_radps: 0.0,
            reference_pose: Pose::default(),
            reference,
            tick,
            tracked_point_m,
            wheelbase_m,
            near_m: Cell::new(0.0),
        }
    }

    #[inline]
    pub(crate) fn with(
        self,
        reference_pose: Pose,
        pose: Pose,
        speed_mps: f64,
        yaw_rate_radps: f64,
        near_m: f64,
    ) -> Self {
        let error = tracking_error(reference_pose, pose);
        let near_m = Cell::new(near_m);
        Self { error, pose, speed_mps, yaw_rate_radps, reference_pose, near_m, ..self }
    }

    /// The path, for everything that the methods below do not cover.
    pub fn path(&self) -> &Path {
        self.reference.path()
    }

    /// Place of the reference pose along the path.
    pub fn reference_along_m(&self) -> f64 {
        self.reference.pose_along_m()
    }

    /// Speed at which the reference runs; 0 once it has come to the end of the path.
    pub fn reference_speed_mps(&self) -> f64 {
        self.reference.speed_mps(self.tick)
    }

    /// Curvature of the path at the reference pose, 1/m, positive to the left.
    pub fn reference_curvature(&self) -> f64 {
        self.path().curvature(self.reference_along_m())
    }

    /// The point of the path nearest to the tracked point. Its `offset_m` is positive where the vehicle lies to the left
    /// of the path.
    pub fn projection(&self) -> PathPoint {
        self.project(self.pose)
    }

    /// The point of the path nearest to another point of the vehicle, such as [`Sight::front_axle`].
    pub fn project(&self, pose: Pose) -> PathPoint {
        let point = self.path().project(
            pose.x_m,
            pose.y_m,
            self.near_m.get(),
            self.wheelbase_m + Self::WINDOW_M,
        );
        self.near_m.set(point.along_m);
        point
    }

    /// The pose of the path `ahead_m` beyond a place along it, held at its end.
    pub fn path_ahead(&self, along_m: f64, ahead_m: f64) -> Pose {
        self.path().at(along_m + ahead_m)
    }

    /// Pose of the middle of the rear axle.
    pub fn rear_axle(&self) -> Pose {
        self.beside_tracked(-self.tracked_point_m)
    }

    /// Pose of the middle of the front axle.
    pub fn front_axle(&self) -> Pose {
        self.beside_tracked(self.wheelbase_m - self.tracked_point_m)
    }

    /// Axle to axle.
    pub fn wheelbase_m(&self) -> f64 {
        self.wheelbase_m
    }

    pub(crate) fn near_m(&self) -> f64 {
        self.near_m.get()
    }

    fn beside_tracked(&self, ahead_m: f64) -> Pose {
        let at = self.pose.ahead(ahead_m);
        Pose { x_m: at.x, y_m: at.y, yaw_rad: self.pose.yaw_rad }
    }
}
