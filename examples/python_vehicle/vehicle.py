#!/usr/bin/env python3
"""A vehicle for pathtune: a fleet of kinematic single tracks with a car's actuators, in lockstep or by the clock.

    pathtune train lane_change --replace vehicle='python3 examples/python_vehicle/vehicle.py'

Copy it, and put your own simulator, or the interface of your car, in the place of `Car`.
"""

import random
from math import cos, exp, inf, sin, tan

from pathtune_bus import Run, give_up
from pathtune_messages import DriveRequest
from pathtune_vehicle import fill_vehicle_role


def clamp(value, low, high):
    # Faster than min and max, and this is asked ten million times in a training.
    return low if value < low else high if value > high else value


class Car:
    """The plant. Its state is that of the rear axle; what is told is the tracked point ahead of it."""

    def __init__(self, config, request, odometry):
        """Stands at the request's start, at rest, its noise started afresh; fills `odometry` when it is observed."""
        self.kind, self.noise, self.odometry = config.vehicle, config.noise, odometry
        self.tick_s = config.drive.tick_s
        self.pedal_share = 1.0 - exp(-self.tick_s / self.kind.pedal_lag_s)
        start, ahead_m = request.start, self.kind.tracked_point_m
        self.x_m = start.x_m - ahead_m * cos(start.yaw_rad)
        self.y_m = start.y_m - ahead_m * sin(start.yaw_rad)
        self.yaw_rad = start.yaw_rad
        self.speed = self.yaw_rate = self.steering = 0.0
        self.integral = self.throttle = self.brake = 0.0
        self.engaged, self.in_reverse = self.kind.gear_engaged, False
        self.gear_wait, self.gear_tick = None, 0  # ticks until drive engages, once it was asked for
        self.random = random.Random(request.seed) if request.flags & DriveRequest.NOISE else None

    def step(self, speed_mps, steering_rad):
        """Drives one tick: forward speed, and angle of the road wheels."""
        kind, tick_s = self.kind, self.tick_s
        command = clamp(speed_mps, -inf, kind.speed_limit_mps)
        if not self.engaged:
            self.select_gear(command)
        error = command - self.speed
        integral = self.integral + kind.speed_ki * error * tick_s
        self.integral = clamp(integral, kind.speed_integral_min, kind.speed_integral_max)
        most = 1.0 if command >= 0.0 else 0.0  # a negative speed only brakes
        pedals = clamp(kind.speed_kp * error + self.integral, -1.0, most)
        self.throttle += self.pedal_share * ((pedals if pedals > 0.0 else 0.0) - self.throttle)
        self.brake += self.pedal_share * ((-pedals if pedals < 0.0 else 0.0) - self.brake)
        accel = -kind.drag_per_s * self.speed - kind.brake_decel_mps2 * self.brake
        if self.engaged:
            accel += kind.throttle_accel_mps2 * self.throttle
        self.roll(max(self.speed + (accel - kind.rolling_decel_mps2) * tick_s, 0.0), steering_rad)

    def stop(self):
        """One tick of the vehicle's own stop: wheels straight, speed down."""
        self.integral = self.throttle = self.brake = 0.0
        self.roll(max(self.speed - self.kind.safety.stop_deceleration_mps2 * self.tick_s, 0.0), 0.0)

    def roll(self, speed_mps, steering_rad):
        kind, tick_s = self.kind, self.tick_s
        limit, reach = kind.steering_limit_rad, kind.steering_rate_radps * tick_s
        self.steering += clamp(clamp(steering_rad, -limit, limit) - self.steering, -reach, reach)
        self.speed = speed_mps
        self.yaw_rate = speed_mps * tan(self.steering) / kind.wheelbase_m
        turned = self.yaw_rate * tick_s
        middle = self.yaw_rad + turned / 2.0
        self.x_m += speed_mps * tick_s * cos(middle)
        self.y_m += speed_mps * tick_s * sin(middle)
        self.yaw_rad += turned

    def select_gear(self, command):
        """Drive engages some time after a positive command, later if a negative one put it into reverse before."""
        kind = self.kind
        polls = self.gear_tick % max(self.ticks(kind.gear_poll_s), 1) == 0
        self.gear_tick += 1
        if self.gear_wait:
            self.gear_wait -= 1
        if self.gear_wait == 0:
            self.engaged = True
        elif polls and self.speed < kind.gear_speed_mps:
            if command < 0.0:
                self.in_reverse, self.gear_wait = True, None
            elif command > 0.0 and self.gear_wait is None:
                self.gear_wait = self.ticks(kind.gear_reverse_s if self.in_reverse else kind.gear_drive_s)

    def ticks(self, time_s):
        return int(time_s / self.tick_s + 0.5)

    def observe(self):
        odometry, ahead_m = self.odometry, self.kind.tracked_point_m
        truth, measured = odometry.truth, odometry.measured
        truth.x_m = x_m = self.x_m + ahead_m * cos(self.yaw_rad)
        truth.y_m = y_m = self.y_m + ahead_m * sin(self.yaw_rad)
        truth.yaw_rad = yaw_rad = self.yaw_rad
        if self.random:
            spread, width = self.noise.position_sd_m, self.noise.heading_half_width_rad
            x_m += self.random.gauss(0.0, spread)
            y_m += self.random.gauss(0.0, spread)
            yaw_rad += self.random.triangular(-width, width)
        measured.x_m, measured.y_m, measured.yaw_rad = x_m, y_m, yaw_rad
        odometry.speed_mps, odometry.yaw_rate_radps = self.speed, self.yaw_rate
        odometry.steering_rad = self.steering


def main(car=Car):
    run = Run()
    model = run.config.vehicle.model
    if model != "kinematic":
        give_up(f"vehicle.model = {model!r}: this vehicle is kinematic; leave out --vehicle, or set it to kinematic")
    fill_vehicle_role(run, car)


if __name__ == "__main__":
    main()
