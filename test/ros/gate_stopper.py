"""A process that requests a stop and keeps running."""

import rclpy
from std_msgs.msg import Bool

from rkhs_ros.nodes.core.messages import LATCHED_QOS

if __name__ == "__main__":
    rclpy.init()
    node = rclpy.create_node("stopper")
    node.create_publisher(Bool, "stop", LATCHED_QOS).publish(Bool(data=True))
    rclpy.spin(node)
