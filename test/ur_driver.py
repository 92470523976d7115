"""What the driver of a UR does in torque control, by its topics (docs/ur.md), with another arm."""

from pathlib import Path
import sys

from external_arm import Arm
from geometry_msgs.msg import Vector3, WrenchStamped
import numpy as np
import rclpy
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
import yaml

TORQUE_CONSTANT = 0.1  # N m/A, over the gear


def reaction(vector):
    """Return what the surface does to the arm that does this to it."""
    x, y, z = -vector
    return Vector3(x=x, y=y, z=z)


home = yaml.safe_load(Path(sys.argv[1]).read_text())['home']
settings = yaml.safe_load(Path(sys.argv[2]).read_text())['/**']['ros__parameters']
robot = settings['robot']
point = settings['contacts']['table']['point_operational']
arm = Arm(robot['urdf'], robot['armature'], home)
rclpy.init()
node = rclpy.create_node('ur_driver')
commands = []
joints = node.create_publisher(JointState, 'joint_states', 10)
wrench = node.create_publisher(
    WrenchStamped, '/force_torque_sensor_broadcaster/wrench', 10
)
node.create_subscription(
    Float64MultiArray, '/forward_effort_controller/commands', commands.append, 10
)
sample = JointState(name=robot['joint_names'])
reading = WrenchStamped()
reading.header.frame_id = 'tool0_controller'
torque = arm.weight
command = np.zeros(len(arm.q))
tick = 1
while True:
    stamp = Time(nanoseconds=tick * 2_000_000).to_msg()
    sample.header.stamp = stamp
    reading.header.stamp = stamp
    sample.position = arm.q.tolist()
    sample.velocity = arm.v.tolist()
    sample.effort = (torque / TORQUE_CONSTANT).tolist()  # a current
    force, noise = arm.wrench_sensor().reshape(2, 3)
    moment = noise + np.cross(point, force)
    reading.wrench.force = reaction(force)
    reading.wrench.torque = reaction(moment)
    commands.clear()
    joints.publish(sample)
    wrench.publish(reading)
    rclpy.spin_once(node, timeout_sec=0.5)
    if commands:  # without, it stands in position control
        torque = command + arm.weight  # a command acts a period after its sample
        command = np.array(commands[-1].data)
        tick += 1
        arm.step(torque, 0.002)
