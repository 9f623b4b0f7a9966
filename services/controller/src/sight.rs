//! What a control law may look at in one tick.

use std::cell::Cell;

use config::{RunConfig, Vehicle};
use tracking::{Path, PathPoint, Pose, Reference, TrackingError, Turning, tracking_error};

/// Where the points of a car lie that laws look at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Points {
    /// The tracked point, ahead of the rear axle.
    tracked_point_m: f64,
    turning: Turning,
    rear_slip_s2pm: f64,
}

impl Points {
    /// Those of a vehicle.
    pub(crate) fn new(vehicle: &Vehicle) -> Self {
        Self {
            tracked_point_m: vehicle.tracked_point_m,
            turning: Turning::new(vehicle),
            rear_slip_s2pm: vehicle.rear_slip_s2pm,
        }
    }

    /// How far the tracked point lies ahead of the one that moves where the car points. That is the rear axle; where its
    /// tyres slip, a point ahead of it: a lateral acceleration of v·r moves the axle sideways at c·v·r times v, with the
    /// slip c, and a point c·v² ahead of it by as much less. From there on a car that slips moves as one that does not.
    #[inline]
    pub(crate) fn tracked_m(&self, speed_mps: f64) -> f64 {
        self.tracked_point_m - self.rear_slip_s2pm * speed_mps * speed_mps
    }

    /// Axle to axle; of a car that understeers, that of one that does not and drives the same circles at this speed.
    #[inline]
    pub(crate) fn wheelbase_m(&self, speed_mps: f64) -> f64 {
        self.turning.wheelbase_m(speed_mps)
    }
}

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
    /// The time of the reference's clock, in ticks since it last started from rest.
    phase_ticks: f64,
    points: Points,
    /// The lateness of the vehicle, where the sight is not one of the present moment.
    known_lateness_m: Option<f64>,
    /// Where the last projection was, along the path: the search for the next one starts from it.
    near_m: Cell<f64>,
}

impl<'a> Sight<'a> {
    /// How far beyond a wheelbase from the last projection the next one is looked for: more than a car drives in a
    /// tick, as its axles are projected in turn.
    const WINDOW_M: f64 = 3.0;

    /// The sight at a time of the reference's clock, for which `reference` has advanced to `reference_pose`.
    pub fn new(
        config: &RunConfig,
        reference: &'a Reference,
        phase_ticks: f64,
        reference_pose: Pose,
        pose: Pose,
        speed_mps: f64,
        yaw_rate_radps: f64,
    ) -> Self {
        Self::of_vehicle(Points::new(&config.vehicle), reference, phase_ticks).with(
            reference_pose,
            pose,
            speed_mps,
            yaw_rate_radps,
            reference.projection_m(pose),
        )
    }

    #[inline]
    pub(crate) fn of_vehicle(points: Points, reference: &'a Reference, phase_ticks: f64) -> Self {
        Self {
            error: TrackingError::default(),
            pose: Pose::default(),
            speed_mps: 0.0,
            yaw_rate_radps: 0.0,
            reference_pose: Pose::default(),
            reference,
            phase_ticks,
            points,
            known_lateness_m: None,
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

    /// Speed at which the reference runs while its clock does; 0 once it has come to the end of the path.
    pub fn reference_speed_mps(&self) -> f64 {
        self.reference.speed_mps(self.phase_ticks)
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
            self.wheelbase_m() + Self::WINDOW_M,
        );
        self.near_m.set(point.along_m);
        point
    }

    /// How far the vehicle is behind its reference, along the path, m.
    pub fn lateness_m(&self) -> f64 {
        self.known_lateness_m
            .unwrap_or_else(|| self.reference_along_m() - self.projection().along_m)
    }

    /// The sight of a vehicle that will be at `pose` some ticks from now, on the reference of then, which is put into
    /// `reference`. It knows the lateness of now: speed is commanded with less delay than steering.
    pub(crate) fn ahead<'b>(
        &self,
        reference: &'b mut Reference,
        ticks: f64,
        pose: Pose,
    ) -> Sight<'b> {
        let lateness_m = self.lateness_m();
        let phase_ticks = self.phase_ticks + ticks;
        let reference_pose = reference.advance(phase_ticks, pose);
        let moved_m = libm::hypot(pose.x_m - self.pose.x_m, pose.y_m - self.pose.y_m);
        let near_m = self.near_m.get() + moved_m.copysign(self.speed_mps);
        Sight {
            known_lateness_m: Some(lateness_m),
            ..Sight::of_vehicle(self.points, reference, phase_ticks).with(
                reference_pose,
                pose,
                self.speed_mps,
                self.yaw_rate_radps,
                near_m,
            )
        }
    }

    /// The reference, at this moment.
    pub(crate) fn reference(&self) -> &Reference {
        self.reference
    }

    /// The pose of the path `ahead_m` beyond a place along it. Beyond the end of a closed path lies its beginning; another
    /// is held at its end.
    pub fn path_ahead(&self, along_m: f64, ahead_m: f64) -> Pose {
        self.path().at_or_round(along_m + ahead_m)
    }

    /// As [`Sight::path_ahead`], but beyond an end straight on.
    pub fn path_ahead_or_beyond(&self, along_m: f64, ahead_m: f64) -> Pose {
        let pose = self.path_ahead(along_m, ahead_m);
        if self.path().is_closed() {
            return pose;
        }
        let beyond_m = (along_m + ahead_m - self.path().length_m()).max(0.0);
        let at = pose.ahead(beyond_m);
        Pose { x_m: at.x, y_m: at.y, yaw_rad: pose.yaw_rad }
    }

    /// Pose of the middle of the rear axle. Where its tyres slip, that of the point ahead of it from which on the car moves as
    /// one that does not slip.
    pub fn rear_axle(&self) -> Pose {
        self.beside_tracked(-self.tracked_m())
    }

    /// Pose of the point a wheelbase ahead of [`Sight::rear_axle`]: the middle of the front axle, unless tyres slip.
    pub fn front_axle(&self) -> Pose {
        self.beside_tracked(self.wheelbase_m() - self.tracked_m())
    }

    /// How far the tracked point lies ahead of [`Sight::rear_axle`], m.
    pub fn tracked_m(&self) -> f64 {
        self.points.tracked_m(self.speed_mps)
    }

    /// Axle to axle; of a car that understeers, that of one that does not and drives the same circles at this speed.
    pub fn wheelbase_m(&self) -> f64 {
        self.points.wheelbase_m(self.speed_mps)
    }

    pub(crate) fn near_m(&self) -> f64 {
        self.near_m.get()
    }

    fn beside_tracked(&self, ahead_m: f64) -> Pose {
        let at = self.pose.ahead(ahead_m);
        Pose { x_m: at.x, y_m: at.y, yaw_rad: self.pose.yaw_rad }
    }
}
