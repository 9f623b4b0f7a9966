"""A car at the scale of 1:10, as that of config/vehicles/f1tenth.toml: a kinematic single track, with the same methods as
commonroad.Car."""

import math


class Car:
    WHEELBASE_M = 0.33
    STEERING_RATE_RADPS = 3.2
    SPEED_PER_S = 4.755
    ACCELERATION_MPS2 = 9.51

    def __init__(self, start_x, start_y, start_yaw):
        """Stands with its rear axle at the start."""
        self.x, self.y, self.yaw = start_x, start_y, start_yaw
        self.speed = self.yaw_rate = self.angle = 0.0

    def step(self, dt, speed_mps, steering_rad):
        """Drives on for so long, towards a speed and an angle of the road wheels."""
        reach = self.STEERING_RATE_RADPS * dt
        self.angle += min(max(steering_rad - self.angle, -reach), reach)
        limit = self.ACCELERATION_MPS2
        acceleration = min(max(self.SPEED_PER_S * (speed_mps - self.speed), -limit), limit)
        self.speed = max(self.speed + acceleration * dt, 0.0)
        self.yaw_rate = self.speed * math.tan(self.angle) / self.WHEELBASE_M
        middle = self.yaw + self.yaw_rate * dt / 2
        self.x += self.speed * dt * math.cos(middle)
        self.y += self.speed * dt * math.sin(middle)
        self.yaw += self.yaw_rate * dt

    def pose(self):
        return self.x, self.y, self.yaw

    def speeds(self):
        return self.speed, 0.0, self.yaw_rate

    def steering(self):
        return self.angle
