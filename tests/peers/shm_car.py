"""CommonRoad's multi-body car in the vehicle's role over shared memory: the plant of examples/python_vehicle swapped.

    shm_car.py [--steering-delay-s S] [--steering-lag-s S]

puts a dead time and a first-order lag between the command and the steering. Needs the packages iceoryx2 and
commonroad-vehicle-models.
"""

import argparse
import os
import random
import sys
from collections import deque
from math import cos, exp, sin

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, "..", "..", "examples", "python_vehicle"))

import commonroad
import vehicle
from pathtune_messages import DriveRequest


OPTIONS = argparse.ArgumentParser()
OPTIONS.add_argument("--steering-delay-s", type=float, default=0.0)
OPTIONS.add_argument("--steering-lag-s", type=float, default=0.0)


class MultiBody(vehicle.Car):
    """The car of another's making, in the place of ours."""

    options = OPTIONS.parse_args([])

    def __init__(self, config, request, odometry):
        self.kind, self.noise, self.odometry = config.vehicle, config.noise, odometry
        self.random = random.Random(request.seed) if request.flags & DriveRequest.NOISE else None
        self.tick_s = config.drive.tick_s
        start, ahead_m = request.start, self.kind.tracked_point_m
        x, y = start.x_m - ahead_m * cos(start.yaw_rad), start.y_m - ahead_m * sin(start.yaw_rad)
        self.model = commonroad.Car(x, y, start.yaw_rad)
        self.on_the_way = deque([0.0] * round(self.options.steering_delay_s / self.tick_s))
        self.lagged_rad = 0.0
        self.roll(0.0, 0.0)

    def step(self, speed_mps, steering_rad):
        limit = self.kind.steering_limit_rad
        self.on_the_way.append(vehicle.clamp(steering_rad, -limit, limit))
        arrived_rad = self.on_the_way.popleft()
        share = 1.0
        if self.options.steering_lag_s:
            share -= exp(-self.tick_s / self.options.steering_lag_s)
        self.lagged_rad += share * (arrived_rad - self.lagged_rad)
        self.roll(max(speed_mps, 0.0), self.lagged_rad)

    def stop(self):
        self.roll(max(self.speed - self.kind.safety.stop_deceleration_mps2 * self.tick_s, 0.0), 0.0)

    def roll(self, speed_mps, steering_rad):
        self.model.step(self.tick_s, speed_mps, steering_rad)
        self.x_m, self.y_m, self.yaw_rad = self.model.pose()
        self.speed, _, self.yaw_rate = self.model.speeds()
        self.steering = self.model.steering()


if __name__ == "__main__":
    MultiBody.options = OPTIONS.parse_args()
    vehicle.main(MultiBody)
