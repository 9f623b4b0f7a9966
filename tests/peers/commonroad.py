"""A car that nobody here wrote: CommonRoad's multi-body model (29 states) of a BMW 320i; also of a Ford Escort and a VW
Vanagon.

Needs the package commonroad-vehicle-models. Poses are those of the rear axle, REP-103.
"""

import importlib
import math

from vehiclemodels.init_mb import init_mb
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb


class Car:
    """The car, with the actuators that an Ackermann command is for."""

    # The stiff suspension and wheels need it.
    STEP_S = 0.0025
    # Proportional control of the speed, by the car's own driver.
    SPEED_PER_S = 2.0
    ACCELERATION_MPS2 = 3.0
    BRAKE_MPS2 = 6.0
    # Friction of tyres that slide sideways.
    SLIDES_MPS2 = 7.0

    def __init__(self, start_x, start_y, start_yaw, parameters=2):
        """Stands with its rear axle at the start. `parameters`: 1 for the Ford, 2 for the BMW, 3 for the VW."""
        name = f"parameters_vehicle{parameters}"
        self.p = getattr(importlib.import_module(f"vehiclemodels.{name}"), name)()
        self.cg_m = self.p.b
        x = start_x + self.cg_m * math.cos(start_yaw)
        y = start_y + self.cg_m * math.sin(start_yaw)
        self._stand(x, y, 0.0, start_yaw)

    def _stand(self, x, y, steering_rad, yaw):
        self.slides = None
        # x, y, steering angle, speed, yaw, yaw rate, slip angle; of the centre of gravity.
        self.state = init_mb([x, y, steering_rad, 0.0, yaw, 0.0, 0.0], self.p)

    def step(self, dt, speed_mps, steering_rad):
        """Drives on for so long, towards a speed and an angle of the road wheels."""
        if self.slides:
            self._slide(dt)
            return
        steps = max(1, round(dt / self.STEP_S))
        h = dt / steps
        for _ in range(steps):
            acceleration = self.SPEED_PER_S * (speed_mps - self.state[3])
            acceleration = min(max(acceleration, -self.BRAKE_MPS2), self.ACCELERATION_MPS2)
            limit = self.p.steering.v_max
            rate = min(max((steering_rad - self.state[2]) / h, -limit), limit)
            try:
                self._heun(h, [rate, acceleration])
            except ZeroDivisionError:
                # It spins: a wheel moves sideways alone, and the model divides by its forward speed.
                yaw, forward, left = self.state[4], self.state[3], self.state[10]
                way = yaw + math.atan2(left, forward)
                self.slides = way, math.hypot(forward, left)
                return
        if speed_mps == 0.0 and abs(self.state[3]) < 0.05:
            # The model's wheels and suspension do not survive a stop, after which it would hardly move.
            self._stand(self.state[0], self.state[1], self.state[2], self.state[4])

    def _slide(self, dt):
        """Goes on straight, as it stands across its way, until it stands."""
        way, speed = self.slides
        slower = max(speed - self.SLIDES_MPS2 * dt, 0.0)
        ahead_m = 0.5 * (speed + slower) * dt
        x, y = self.state[0] + ahead_m * math.cos(way), self.state[1] + ahead_m * math.sin(way)
        if slower == 0.0:
            self._stand(x, y, self.state[2], self.state[4])
            return
        self.slides, self.state[0], self.state[1] = (way, slower), x, y
        self.state[3] = slower * math.cos(way - self.state[4])
        self.state[10] = slower * math.sin(way - self.state[4])
        self.state[5] = 0.0

    def _heun(self, h, inputs):
        first = vehicle_dynamics_mb(self.state, inputs, self.p)
        ahead = [x + h * f for x, f in zip(self.state, first)]
        second = vehicle_dynamics_mb(ahead, inputs, self.p)
        self.state = [x + 0.5 * h * (f + g) for x, f, g in zip(self.state, first, second)]

    def pose(self):
        """x, y and yaw of the rear axle."""
        x, y, yaw = self.state[0], self.state[1], self.state[4]
        return x - self.cg_m * math.cos(yaw), y - self.cg_m * math.sin(yaw), yaw

    def speeds(self):
        """Forward and left speed of the rear axle, and the yaw rate."""
        forward, yaw_rate = self.state[3], self.state[5]
        if abs(forward) < 0.1:
            # The model is kinematic there, and lets its sideways speed stand as it was.
            return forward, 0.0, yaw_rate
        return forward, self.state[10] - self.cg_m * yaw_rate, yaw_rate

    def steering(self):
        """Angle of the road wheels."""
        return self.state[2]
