"""CommonRoad's multi-body car in the vehicle's role over shared memory: the plant of examples/python_vehicle swapped.

    shm_car.py [--steering-delay-s S] [--steering-lag-s S] [--parameters 1|2|3] [--fault FAULT]

puts a dead time and a first-order lag between the command and the steering; with --fault the car does not do as it is told
from some moment on. Needs the packages iceoryx2 and commonroad-vehicle-models.
"""

import argparse
import os
import random
import sys
from math import cos, sin

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, "..", "..", "examples", "python_vehicle"))

import faults
import late
import vehicle
from pathtune_messages import DriveRequest


def arguments():
    parser = argparse.ArgumentParser()
    parser.add_argument("--realtime", action="store_true", help="by the clock; the run may say so, too")
    parser.add_argument("--small", action="store_true", help="is a car at the scale of 1:10")
    parser.add_argument("--log", default=os.devnull, help="writes down what it does, a line of JSON a step")
    late.add_arguments(parser)
    parser.add_argument("--parameters", type=int, choices=[1, 2, 3], default=2, help="CommonRoad's set: Ford, BMW, VW")
    faults.add_arguments(parser)
    return parser.parse_args()


ARGS = arguments()
if ARGS.small:
    from small_car import Car as Model
else:
    from commonroad import Car as Model


class MultiBody(vehicle.Car):
    """The car of another's making, in the place of ours."""

    def __init__(self, config, request, odometry):
        self.kind, self.noise, self.odometry = config.vehicle, config.noise, odometry
        self.random = random.Random(request.seed) if request.flags & DriveRequest.NOISE else None
        self.tick_s = config.drive.tick_s
        start, ahead_m = request.start, self.kind.tracked_point_m
        x, y = start.x_m - ahead_m * cos(start.yaw_rad), start.y_m - ahead_m * sin(start.yaw_rad)
        which = {} if ARGS.small else {"parameters": ARGS.parameters}
        self.model, self.fault = Model(x, y, start.yaw_rad, **which), faults.Fault(ARGS)
        self.log = open(ARGS.log, "w", buffering=1)
        self.late = late.Steering(ARGS, self.tick_s)
        self.roll(0.0, 0.0)

    def step(self, speed_mps, steering_rad):
        limit = self.kind.steering_limit_rad
        speed_mps, steering_rad = self.fault.does(self.tick_s, max(speed_mps, 0.0), steering_rad)
        self.roll(speed_mps, self.late.acts(vehicle.clamp(steering_rad, -limit, limit)))

    def stop(self):
        # Its driver brakes as hard as the speed's error asks for: a speed just below its own would hardly slow it down.
        self.roll(0.0, 0.0)

    def roll(self, speed_mps, steering_rad):
        self.model.step(self.tick_s, speed_mps, steering_rad)
        self.x_m, self.y_m, self.yaw_rad = self.model.pose()
        self.speed, _, self.yaw_rate = self.model.speeds()
        self.steering = self.model.steering()
        print(faults.line(self.fault, *self.model.pose(), self.speed, (speed_mps, steering_rad)), file=self.log)

    def observe(self):
        super().observe()
        measured = self.odometry.measured
        at = self.fault.tells(measured.x_m, measured.y_m, measured.yaw_rad)
        measured.x_m, measured.y_m = at


if __name__ == "__main__":
    vehicle.main(MultiBody)
