//! Why drives cannot tell a car.

use std::fmt;

/// Why nothing was identified; displays as one line with the cause and the way out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Refusal {
    /// The car moved for too short a time.
    TooShort {
        /// How long it moved.
        moving_s: f64,
        /// How long it has to.
        needed_s: f64,
        /// The usual time between two samples of the odometry.
        apart_s: f64,
        /// It drives backwards.
        is_backwards: bool,
    },
    /// A quantity is told in another unit.
    WrongUnit {
        /// The quantity.
        what: &'static str,
        /// How many times what another quantity says.
        times: f64,
        /// What says otherwise.
        than: &'static str,
        /// The unit in which it seems to be.
        looks_like: &'static str,
        /// The unit in which it has to be.
        needed: &'static str,
    },
    /// No wheels turn as far as the commands say.
    NotRadians {
        /// The largest commanded angle.
        most_rad: f64,
    },
    /// The yaw rate is computed from the command.
    Computed {
        /// The wheelbase in the formula.
        wheelbase_m: f64,
    },
    /// The yaw rate is another function of the command.
    OfCommand,
    /// The yaw rate is 0 while the car steers.
    NoYawRate,
    /// The car turns to the other side.
    WrongWay,
    /// The car does not follow the commands.
    DoesNotFollow {
        /// How well it does.
        correlation: f64,
    },
    /// A key has no effect whatever.
    Undetermined,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooShort { moving_s, needed_s, apart_s, is_backwards } => {
                write!(
                    f,
                    "the car moves forwards for {moving_s:.1} s without a gap in the odometry, and {needed_s:.0} s are needed: "
                )?;
                match () {
                    () if *apart_s > 1.0 => {
                        write!(f, "its samples are {apart_s:.1} s apart; is their time in seconds?")
                    }
                    () if *is_backwards => f.write_str("in this drive it goes backwards"),
                    () => f.write_str("record a longer drive, without gaps of 0.25 s or more"),
                }
            }
            Self::WrongUnit { what, times, than, looks_like, needed } => write!(
                f,
                "{what} {times:.3} times what {than} say: in {looks_like}? Give them in {needed}"
            ),
            Self::NotRadians { most_rad } => write!(
                f,
                "the commanded steering angle reaches {most_rad:.1}, and no wheels turn by so many radians: give it in radians, of \
                 the road wheels (1° is 0.01745)"
            ),
            Self::Computed { wheelbase_m } => write!(
                f,
                "the odometry's yaw rate is v·tan(commanded steering)/{wheelbase_m:.3} m, computed and not measured, so it tells \
                 nothing of the steering (vesc_to_odom does so unless use_servo_cmd_to_calc_angular_velocity is false): give an \
                 IMU's yaw rate or a localised pose; for a simulation without lag and noise, add --simulated"
            ),
            Self::OfCommand => f.write_str(
                "the odometry's yaw rate follows the commanded steering without any lag, computed and not measured, so it tells \
                 nothing of the steering: give an IMU's yaw rate or a localised pose; for a simulation without lag and noise, add \
                 --simulated",
            ),
            Self::NoYawRate => f.write_str(
                "the odometry's yaw rate is 0 while the car steers: its driver does not know the heading; give an IMU's yaw rate \
                 or a localised pose",
            ),
            Self::WrongWay => f.write_str(
                "the car turns to the right where the command says left: correct the sign of its steering first (ros2.steering_sign \
                 of the vehicle's file, or the adapter)",
            ),
            Self::DoesNotFollow { correlation } => write!(
                f,
                "the car's yaw rate does not follow the commands (correlation {correlation:.2}): was it driven by hand, or does it \
                 never steer in this drive?"
            ),
            Self::Undetermined => {
                f.write_str("the drive does not determine the car: a key has no effect in it")
            }
        }
    }
}

impl std::error::Error for Refusal {}
