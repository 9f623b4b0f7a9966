"""A ROS 2 car, or somebody else who drives one.

The car is CommonRoad's model, paced by the clock; it is spoken to by Cyclone DDS. What it did and was told it writes
down, a line of JSON a step.
"""

import argparse
import json
import math
import random
import time

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

import faults
import late
import ros_messages as ros

STEP_S = 0.01


def arguments():
    parser = argparse.ArgumentParser()
    parser.add_argument("--domain", type=int, required=True)
    parser.add_argument("--log", required=True)
    parser.add_argument("--start", default="0,0,0", help="x,y,yaw of the rear axle")
    parser.add_argument("--odometry", default="/odom")
    parser.add_argument("--drive", default="/drive")
    parser.add_argument("--frame", default="odom")
    parser.add_argument("--bare", action="store_true", help="takes AckermannDrive")
    parser.add_argument("--point", type=float, default=0.0, help="of its odometry, ahead of the rear axle")
    parser.add_argument("--sign", type=float, default=1.0, help="-1: a positive angle steers to the right")
    parser.add_argument("--collision", default="", help="topic of the collisions")
    parser.add_argument("--collides-after", type=float, default=math.inf, help="metres driven")
    parser.add_argument("--habit", default="", help="what its odometry is like: one of HABITS")
    parser.add_argument("--deaf", action="store_true", help="takes no commands")
    parser.add_argument("--ear", action="store_true", help="takes commands, but tells no odometry")
    parser.add_argument("--driver", action="store_true", help="is no car, but could drive one: publishes nothing yet")
    parser.add_argument("--small", action="store_true", help="is a car at the scale of 1:10")
    parser.add_argument("--position-sd-m", type=float, default=0.0, help="noise of its odometry, while it drives")
    parser.add_argument("--heading-half-width-rad", type=float, default=0.0, help="noise of its odometry")
    parser.add_argument("--parameters", type=int, choices=[1, 2, 3], default=2, help="CommonRoad's set: Ford, BMW, VW")
    late.add_arguments(parser)
    faults.add_arguments(parser)
    return parser.parse_args()


def drive(participant, args):
    writer = DataWriter(
        participant, Topic(participant, "rt" + args.drive, ros.AckermannDriveStamped), qos=ros.qos(True)
    )
    with open(args.log, "w") as log:
        print("{}", file=log)
    while writer:
        time.sleep(1)


def stamp_stands(message):
    message.header.stamp = ros.Time(1234567890, 0)


def stamp_is_late(message):
    message.header.stamp.sec -= 5


def simulated_time(message):
    message.header.stamp.sec -= 1_700_000_000


def no_quaternion(message):
    message.pose.pose.orientation = ros.Quaternion(w=0.0)


def not_a_number(message):
    message.twist.twist.linear.x = math.nan


HABITS = {
    "": lambda message: None,
    "stamp-stands": stamp_stands,
    "stamp-late": stamp_is_late,
    "simulated-time": simulated_time,
    "no-quaternion": no_quaternion,
    "not-a-number": not_a_number,
    # Offers it reliably, and sends none.
    "mute": lambda message: None,
}


def odometry(car, fault, args):
    x, y, yaw = car.pose()
    forward, left, yaw_rate = car.speeds()
    now = time.time_ns()
    message = ros.Odometry(child_frame_id="base_link")
    message.header = ros.Header(ros.Time(now // 10**9, now % 10**9), args.frame)
    pose, twist = message.pose.pose, message.twist.twist
    x, y = x + args.point * math.cos(yaw), y + args.point * math.sin(yaw)
    if abs(forward) > 0.05:
        # Where it stands, it has had the time to find out.
        x, y = random.gauss(x, args.position_sd_m), random.gauss(y, args.position_sd_m)
        yaw += random.uniform(-args.heading_half_width_rad, args.heading_half_width_rad)
    pose.position.x, pose.position.y = fault.tells(x, y, yaw)
    pose.orientation.z, pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    twist.linear.x, twist.linear.y, twist.angular.z = forward, left, yaw_rate
    HABITS[args.habit](message)
    return message


def main():
    args = arguments()
    participant = DomainParticipant(args.domain)
    if args.driver:
        drive(participant, args)
    kind = ros.AckermannDrive if args.bare else ros.AckermannDriveStamped
    commands = None
    if not args.deaf:
        commands = DataReader(participant, Topic(participant, "rt" + args.drive, kind), qos=ros.qos(True))
    is_mute = args.habit == "mute"
    if not args.ear:
        odometry_topic = Topic(participant, "rt" + args.odometry, ros.Odometry)
        writer = DataWriter(participant, odometry_topic, qos=ros.qos(is_mute))
    collisions = None
    if args.collision:
        topic = Topic(participant, "rt" + args.collision, ros.CarlaCollisionEvent)
        collisions = DataWriter(participant, topic, qos=ros.qos(True))
    if args.small:
        from small_car import Car
    else:
        from commonroad import Car
    which = {} if args.small else {"parameters": args.parameters}
    car = Car(*(float(part) for part in args.start.split(",")), **which)
    steering = late.Steering(args, STEP_S)
    fault = faults.Fault(args)
    start = car.pose()
    told, heard = ros.AckermannDrive(), 0
    due = time.monotonic()
    with open(args.log, "w", buffering=1) as log:
        while True:
            # The others say that a writer is gone.
            taken = commands.take(100) if commands else []
            fresh = [sample for sample in taken if isinstance(sample, kind)]
            heard += len(fresh)
            if fresh:
                told = fresh[-1] if args.bare else fresh[-1].drive
            speed, angle = fault.does(STEP_S, told.speed, args.sign * told.steering_angle)
            car.step(STEP_S, speed, steering.acts(angle))
            x, y, yaw = car.pose()
            if collisions and math.hypot(x - start[0], y - start[1]) > args.collides_after:
                collisions.write(ros.CarlaCollisionEvent(other_actor_id=1))
                collisions = None
            if not (is_mute or args.ear):
                writer.write(odometry(car, fault, args))
            line = {"t_ns": time.monotonic_ns(), "x_m": x, "y_m": y, "yaw_rad": yaw}
            line |= {"speed_mps": car.speeds()[0], "steering_rad": car.steering(), "heard": heard}
            line |= {"told_mps": told.speed, "told_rad": told.steering_angle}
            line |= {"fault": fault.is_there()}
            print(json.dumps(line), file=log)
            due += STEP_S
            time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        pass
