"""Sends numbered commands to a gate at 50 Hz, or requests a stop once, until it is killed or stopped."""

import sys
import time

import rclpy
from std_msgs.msg import Bool

from rkhs_interfaces.msg import Command
from rkhs_ros.nodes.core.messages import LATCHED_QOS, LOCKSTEP_QOS

if __name__ == "__main__":
    rclpy.init()
    if sys.argv[1] == "stop":
        node = rclpy.create_node("stopper")
        node.create_publisher(Bool, "stop", LATCHED_QOS).publish(Bool(data=True))
        rclpy.spin(node)
    _, value, instance = sys.argv
    node = rclpy.create_node("sender")
    publisher = node.create_publisher(Command, "command", LOCKSTEP_QOS)
    for number in range(10**6):
        stamp = node.get_clock().now().to_msg()
        publisher.publish(Command(instance=int(instance), number=number, stamp=stamp, values=[float(value)]))
        time.sleep(0.02)
