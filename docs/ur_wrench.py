"""
Turns the wrench of a UR's driver into the one that the controller reads.

``python ur_wrench.py TOPIC FRAME``: the driver's topic, and `robot.sensor_frame`. The driver tells
what acts on the tool, the controller reads what the arm does to it: the opposite.
"""

from contextlib import suppress
import sys

from geometry_msgs.msg import WrenchStamped
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data


def publish_opposite(message):
    """
    Publish the opposite of a wrench, with the stamp that it came with.

    The frame of its header becomes the one that the controller is configured for, which is the
    second argument of this script: drivers name the same frame differently.
    """
    message.header.frame_id = sys.argv[2]
    for vector in (message.wrench.force, message.wrench.torque):
        vector.x = -vector.x
        vector.y = -vector.y
        vector.z = -vector.z
    publisher.publish(message)


rclpy.init()
node = rclpy.create_node('ur_wrench')
publisher = node.create_publisher(WrenchStamped, 'ft_sensor/wrench', 10)
node.create_subscription(
    WrenchStamped, sys.argv[1], publish_opposite, qos_profile_sensor_data
)
with suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(node)
