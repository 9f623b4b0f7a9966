#!/usr/bin/env python3
"""A vehicle for pathtune: a fleet of kinematic single tracks with a car's actuators, in lockstep or by the clock.

    pathtune train lane_change --replace vehicle='python3 examples/python_vehicle/vehicle.py'

Copy it, and put your own simulator, or the interface of your car, in the place of `Car`. The rest keeps to "What a
vehicle does" in ipc_types/CONTRACT.md.
"""

import random
import sys
from math import cos, exp, inf, isfinite, sin, tan

from pathtune_bus import Inlet, Outlet, Run, give_up, now_ns, serve
from pathtune_messages import Command, Credit, DriveRequest, Odometry, Status, TickHeader

CAPACITY = 256


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


class Slot:
    """One car of the fleet, with the command that it holds."""

    def __init__(self, car):
        self.car, self.odometry = car, car.odometry
        self.odometry.status, self.odometry.reserved = Odometry.HAS_TRUTH, 0
        self.speed_mps, self.steering_rad, self.ended = 0.0, 0.0, False

    def take(self, command):
        """Takes a command over; whether its numbers were finite."""
        if command.flags & Command.ENDED:
            self.ended = True
            self.odometry.status |= Odometry.ENDED
        self.speed_mps, self.steering_rad = command.speed_mps, command.steering_rad
        if isfinite(self.speed_mps) and isfinite(self.steering_rad):
            return True
        self.speed_mps, self.steering_rad = 0.0, 0.0
        return self.ended


class Vehicle:
    """The vehicle's part of the contract."""

    def __init__(self, run, realtime):
        self.run, self.realtime = run, realtime
        self.requests, self.commands = Inlet(run, "drive_request"), Inlet(run, "command")
        self.credits, self.odometry = Inlet(run, "credit"), Outlet(run, "odometry")
        self.outlets = [self.odometry]
        self.status = Status(capacity=CAPACITY, pacing=Status.REAL_TIME if realtime else 0)
        self.tick_ns = round(run.config.drive.tick_s * 1e9)
        self.age_limit_ns = round(run.config.vehicle.safety.command_age_limit_s * 1e9)
        self.started_ns = now_ns()
        self.slots = []  # none before the first batch
        self.waits_for_command = False
        self.held_back = False  # a tick that waits for a recorder

    def poll(self):
        if self.commands.receive():
            self.hear_command()
        elif self.requests.receive():
            while self.requests.receive():
                pass
            self.start_batch()
        elif self.held_back:
            return self.catch_up()
        else:
            return self.realtime and self.drive_by_clock()
        return True

    def due_ns(self):
        """When the next tick is due, in real time."""
        if self.realtime and self.slots:
            return self.zero_ns + (self.odometry.header.tick + 1) * self.tick_ns
        return None

    def start_batch(self):
        header, count = self.requests.header, self.requests.len
        self.waits_for_command, self.held_back, self.slots = False, False, []
        if header.run != self.run.number or not 0 < count <= min(CAPACITY, self.run.max_len):
            self.status.dropped += 1
            return
        requests = self.requests.items[:count]
        self.slots = [Slot(Car(self.run.config, *pair)) for pair in zip(requests, self.odometry.items)]
        self.command_tick, self.command_sent_ns = -1, 0
        # Who records one drive asks for the next when it has the last; who records the run says when it is ready.
        wanted = ((DriveRequest.RECORDED, Credit.AHEAD), (DriveRequest.LOGGED, 0))
        flags = 0
        for request in requests:
            flags |= request.flags
        self.allowed = {source: ticks for source, ticks in wanted if flags & source and not self.realtime}
        self.odometry.header = TickHeader(run=header.run, batch=header.batch, attempt=header.attempt)
        self.zero_ns = now_ns()
        if self.realtime and self.run.incarnation > 1 and header.sent_ns < self.started_ns:
            # Restarted during a drive: it goes on with that, from where this car now stands, which is the start.
            self.zero_ns = header.sent_ns
            self.odometry.header.tick = (now_ns() - self.zero_ns) // self.tick_ns
        self.publish()

    def publish(self):
        header = self.odometry.header
        self.held_back = any(header.tick >= ticks for ticks in self.allowed.values())
        if self.held_back:
            return
        for slot in self.slots:
            # In lockstep an ended slot's numbers stand still; by the clock it may still roll.
            if self.realtime or not slot.ended:
                slot.car.observe()
        header.odometry_sent_ns = now_ns()
        self.status.batch, self.status.tick = header.batch, header.tick
        self.odometry.send(len(self.slots))
        self.waits_for_command = not self.realtime

    def catch_up(self):
        """Publishes what was held back, once every recorder has got far enough. Several may have sent credits."""
        heard, ours = False, self.odometry.header
        while self.credits.receive():
            heard, header, credit = True, self.credits.header, self.credits.items[0]
            if (header.run, header.batch, header.attempt) != (ours.run, ours.batch, ours.attempt):
                self.status.dropped += 1
            elif credit.source in self.allowed:
                ticks = credit.ticks + Credit.AHEAD
                self.allowed[credit.source] = max(self.allowed[credit.source], ticks)
        if heard:
            self.publish()
        return heard

    def hear_command(self):
        header, ours, now = self.commands.header, self.odometry.header, now_ns()
        fits = (header.run, header.batch, header.attempt) == (ours.run, ours.batch, ours.attempt)
        if self.realtime:
            fits = fits and self.command_tick <= header.tick <= ours.tick
        else:
            fits = fits and self.waits_for_command and header.tick == ours.tick
        if not fits or self.commands.len != len(self.slots):
            self.status.dropped += 1
            return
        if self.realtime and now - header.supervisor_sent_ns > self.age_limit_ns:
            self.status.late += 1
            return
        for slot, command in zip(self.slots, self.commands.items):
            if not (slot.ended or slot.take(command)):
                self.status.rejected += 1
        ours.applied_ns = now
        self.command_tick, self.command_sent_ns = header.tick, header.supervisor_sent_ns
        if not self.realtime:
            self.drive_in_lockstep()

    def drive_in_lockstep(self):
        self.waits_for_command = False
        live = [slot for slot in self.slots if not slot.ended]
        for slot in live:
            slot.car.step(slot.speed_mps, slot.steering_rad)
        if live:
            self.odometry.header.tick += 1
            self.publish()

    def drive_by_clock(self):
        """Drives the ticks that have passed with the commands that are held, and publishes the last of them."""
        now = now_ns()
        if not self.slots or now < self.due_ns():
            return False
        header = self.odometry.header
        tick = (now - self.zero_ns) // self.tick_ns
        is_stale = now - self.command_sent_ns > self.age_limit_ns
        for slot in self.slots:
            for _ in range(tick - header.tick):
                if slot.ended or is_stale:
                    slot.car.stop()
                else:
                    slot.car.step(slot.speed_mps, slot.steering_rad)
            slot.odometry.status &= ~Odometry.OWN_STOP
            slot.odometry.status |= Odometry.OWN_STOP if is_stale else 0
        header.tick = tick
        self.publish()
        return True


def main():
    run = Run()
    model = run.config.vehicle.model
    if model != "kinematic":
        give_up(f"vehicle.model = {model!r}: this vehicle is kinematic; leave out --vehicle, or set it to kinematic")
    realtime = "--realtime" in sys.argv[1:] or run.config.run.realtime
    serve(run, Status.VEHICLE, "wake/vehicle", Vehicle(run, realtime))


if __name__ == "__main__":
    main()
