"""CommonRoad's multi-body car in the vehicle's role over shared memory: the plant of examples/python_vehicle swapped.

Needs the packages iceoryx2 and commonroad-vehicle-models.
"""

import os
import sys
from math import cos, sin

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, "..", "..", "examples", "python_vehicle"))

import commonroad
import vehicle


class MultiBody(vehicle.Car):
    """The car of another's making, in the place of ours."""

    def __init__(self, config, request, odometry):
        self.kind, self.odometry, self.random = config.vehicle, odometry, None
        self.tick_s = config.drive.tick_s
        start, ahead_m = request.start, self.kind.tracked_point_m
        x, y = start.x_m - ahead_m * cos(start.yaw_rad), start.y_m - ahead_m * sin(start.yaw_rad)
        self.model = commonroad.Car(x, y, start.yaw_rad)
        self.roll(0.0, 0.0)

    def step(self, speed_mps, steering_rad):
        limit = self.kind.steering_limit_rad
        self.roll(max(speed_mps, 0.0), vehicle.clamp(steering_rad, -limit, limit))

    def stop(self):
        self.roll(max(self.speed - self.kind.safety.stop_deceleration_mps2 * self.tick_s, 0.0), 0.0)

    def roll(self, speed_mps, steering_rad):
        self.model.step(self.tick_s, speed_mps, steering_rad)
        self.x_m, self.y_m, self.yaw_rad = self.model.pose()
        self.speed, _, self.yaw_rate = self.model.speeds()
        self.steering = self.model.steering()


if __name__ == "__main__":
    vehicle.main(MultiBody)
