"""A ROS 2 node that is a car, by rclpy over the middleware that ROS 2 ships with.

The car is CommonRoad's model, as in ros2_car.py. Without ackermann_msgs it takes geometry_msgs/Twist, or TwistStamped: a
speed and a yaw rate. Needs the packages ros-rclpy[fastrtps], ros-nav-msgs and ros-geometry-msgs.
"""

import argparse
import json
import math
import os
import time

os.environ.setdefault("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")

import rclpy  # noqa: E402
from geometry_msgs.msg import Twist, TwistStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402

from commonroad import Car  # noqa: E402

STEP_S = 0.01
WHEELBASE_M = 2.58
# As many messages as a subscription keeps.
MOST_AT_ONCE = 10


class Node:
    """The car's node: odometry out, commands in, both as ROS 2 does by default."""

    def __init__(self, is_stamped):
        self.node = rclpy.create_node("car")
        self.odometry = self.node.create_publisher(Odometry, "/odom", 10)
        if is_stamped:
            self.node.create_subscription(TwistStamped, "/drive", lambda it: self.hear(it.twist), 10)
        else:
            self.node.create_subscription(Twist, "/drive", self.hear, 10)
        self.speed_mps, self.angle_rad, self.heard = 0.0, 0.0, 0

    def hear(self, twist):
        self.heard += 1
        self.speed_mps = twist.linear.x
        if self.speed_mps != 0.0:
            self.angle_rad = math.atan(WHEELBASE_M * twist.angular.z / self.speed_mps)

    def tell(self, car):
        message = Odometry(child_frame_id="base_link")
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.header.frame_id = "odom"
        x, y, yaw = car.pose()
        pose, twist = message.pose.pose, message.twist.twist
        pose.position.x, pose.position.y = float(x), float(y)
        pose.orientation.z, pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        forward, left, yaw_rate = car.speeds()
        twist.linear.x, twist.linear.y = float(forward), float(left)
        twist.angular.z = float(yaw_rate)
        self.odometry.publish(message)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--domain", type=int, required=True)
    parser.add_argument("--log", required=True)
    parser.add_argument("--stamped", action="store_true", help="takes TwistStamped")
    args = parser.parse_args()
    os.environ["ROS_DOMAIN_ID"] = str(args.domain)
    # Python's own, by which the interrupt below comes between two calls and not within one.
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node, car = Node(args.stamped), Car(0.0, 0.0, 0.0)
    due = time.monotonic()
    with open(args.log, "w", buffering=1) as log:
        while rclpy.ok():
            due += STEP_S
            # Until nothing has come any more: a node that is behind its time must listen all the same.
            for _ in range(MOST_AT_ONCE):
                heard = node.heard
                rclpy.spin_once(node.node, timeout_sec=0)
                if heard == node.heard:
                    break
            car.step(STEP_S, node.speed_mps, node.angle_rad)
            node.tell(car)
            x, y, yaw = (float(number) for number in car.pose())
            line = {"t_ns": time.monotonic_ns(), "x_m": x, "y_m": y, "yaw_rad": yaw}
            line |= {"speed_mps": float(car.speeds()[0]), "heard": node.heard}
            line |= {"told_mps": node.speed_mps, "told_rad": node.angle_rad}
            print(json.dumps(line), file=log)
            time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        rclpy.shutdown()
