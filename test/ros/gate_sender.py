"""Sends numbered commands to a gate at 50 Hz until it is killed or stopped."""

import sys
import time

import rclpy

from rkhs_interfaces.msg import Command
from rkhs_ros.nodes.core.messages import LOCKSTEP_QOS

if __name__ == "__main__":
    _, value, instance = sys.argv
    rclpy.init()
    node = rclpy.create_node("sender")
    publisher = node.create_publisher(Command, "command", LOCKSTEP_QOS)
    for number in range(10**6):
        stamp = node.get_clock().now().to_msg()
        publisher.publish(Command(instance=int(instance), number=number, stamp=stamp, values=[float(value)]))
        time.sleep(0.02)
