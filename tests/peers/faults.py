"""What is wrong with a car from some moment on: the faults of these peers, over shared memory and over DDS alike."""

import argparse
import json
import math
import time

FAULTS = [
    "none",
    "wrong_sign",
    "stuck_throttle",
    "ignores_commands",
    "no_steering",
    "bent_linkage",
    "point_ahead",
    "held",
    "jump",
]


def add_arguments(parser: argparse.ArgumentParser):
    parser.add_argument("--fault", choices=FAULTS, default="none")
    parser.add_argument("--at", type=float, default=0.0, help="seconds since it was first told to drive; -1: always")
    parser.add_argument("--until", type=float, default=math.inf, help="seconds since then")
    parser.add_argument("--by", type=float, default=1.4, help="metres, of point_ahead and jump; m/s, of stuck_throttle")


class Fault:
    """One car's fault. It counts the time from the first command to drive."""

    def __init__(self, args):
        self.kind, self.at, self.until, self.by = args.fault, args.at, args.until, args.by
        self.time_s, self.had = None, (0.0, 0.0)

    def is_there(self):
        # Before it drives, only what has always been wrong.
        time_s = -1.0 if self.time_s is None else self.time_s
        return self.kind != "none" and self.at <= time_s < self.until

    def does(self, dt, speed_mps, steering_rad):
        """What the car does for so long when it is told this."""
        if self.time_s is not None:
            self.time_s += dt
        elif speed_mps > 0.0:
            self.time_s = 0.0
        if self.is_there():
            if self.kind == "wrong_sign":
                steering_rad = -steering_rad
            elif self.kind == "stuck_throttle":
                speed_mps = self.by
            elif self.kind == "ignores_commands":
                speed_mps, steering_rad = self.had
            elif self.kind == "no_steering":
                steering_rad = 0.0
            elif self.kind == "bent_linkage":
                steering_rad = 0.15 * steering_rad + 0.12
            elif self.kind == "held":
                speed_mps = 0.0
        self.had = speed_mps, steering_rad
        return self.had

    def tells(self, x_m, y_m, yaw_rad):
        """Where its odometry says that it is."""
        if self.is_there() and self.kind == "point_ahead":
            return x_m + self.by * math.cos(yaw_rad), y_m + self.by * math.sin(yaw_rad)
        if self.is_there() and self.kind == "jump":
            return x_m - self.by * math.sin(yaw_rad), y_m + self.by * math.cos(yaw_rad)
        return x_m, y_m


def line(fault, x_m, y_m, yaw_rad, speed_mps, told):
    """What a car writes down of a step."""
    line = {"t_ns": time.monotonic_ns(), "x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad, "speed_mps": speed_mps}
    line |= {"told_mps": told[0], "told_rad": told[1], "fault": fault.is_there()}
    return json.dumps(line)
