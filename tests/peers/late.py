"""Steering that is late: a dead time, and behind it a lag of the first order."""

from collections import deque
from math import exp


def add_arguments(parser):
    parser.add_argument("--steering-delay-s", type=float, default=0.0)
    parser.add_argument("--steering-lag-s", type=float, default=0.0)


class Steering:
    """What of the commanded steering angles acts, tick by tick."""

    def __init__(self, args, tick_s):
        self.on_the_way = deque([0.0] * round(args.steering_delay_s / tick_s))
        self.share = 1.0 - (exp(-tick_s / args.steering_lag_s) if args.steering_lag_s else 0.0)
        self.acting_rad = 0.0

    def acts(self, steering_rad):
        self.on_the_way.append(steering_rad)
        self.acting_rad += self.share * (self.on_the_way.popleft() - self.acting_rad)
        return self.acting_rad
