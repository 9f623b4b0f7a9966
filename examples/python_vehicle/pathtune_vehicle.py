"""What the contract asks of any vehicle: "What a vehicle does" in ipc_types/CONTRACT.md.

A car is made from the run's configuration, a `DriveRequest` and the `Odometry` that it fills: `step` drives it for a tick
with a speed and a steering angle, `stop` for a tick of its own stop, `observe` fills the odometry.
"""

import sys
from math import isfinite

from pathtune_bus import Inlet, Outlet, now_ns, serve
from pathtune_messages import Command, Credit, DriveRequest, Odometry, Status, TickHeader

CAPACITY = 256


def fill_vehicle_role(run, car):
    """Drives cars of this kind until the process is asked to stop."""
    realtime = "--realtime" in sys.argv[1:] or run.config.run.realtime
    serve(run, Status.VEHICLE, "wake/vehicle", Vehicle(run, car, realtime))


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

    def __init__(self, run, car, realtime):
        self.run, self.car, self.realtime = run, car, realtime
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
        if header.attempt.run != self.run.number or not 0 < count <= min(CAPACITY, self.run.max_len):
            self.status.dropped += 1
            return
        requests = self.requests.items[:count]
        self.slots = [Slot(self.car(self.run.config, *pair)) for pair in zip(requests, self.odometry.items)]
        self.command_tick, self.command_sent_ns = -1, 0
        # Who records one drive asks for the next when it has the last; who records the run says when it is ready.
        wanted = ((DriveRequest.RECORDED, Credit.AHEAD), (DriveRequest.LOGGED, 0))
        flags = 0
        for request in requests:
            flags |= request.flags
        self.allowed = {source: ticks for source, ticks in wanted if flags & source and not self.realtime}
        self.odometry.header = TickHeader(attempt=header.attempt)
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
        self.status.batch, self.status.tick = header.attempt.batch, header.tick
        self.odometry.send(len(self.slots))
        self.waits_for_command = not self.realtime

    def catch_up(self):
        """Publishes what was held back, once every recorder has got far enough. Several may have sent credits."""
        heard, ours = False, self.odometry.header
        while self.credits.receive():
            heard, header, credit = True, self.credits.header, self.credits.items[0]
            if header.attempt != ours.attempt:
                self.status.dropped += 1
            elif credit.source in self.allowed:
                ticks = credit.ticks + Credit.AHEAD
                self.allowed[credit.source] = max(self.allowed[credit.source], ticks)
        if heard:
            self.publish()
        return heard

    def hear_command(self):
        header, ours, now = self.commands.header, self.odometry.header, now_ns()
        fits = header.attempt == ours.attempt
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
