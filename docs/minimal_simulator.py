"""
A simulator behind the topics: an arm, a wrist sensor and a springy table, in MuJoCo.

``python minimal_simulator.py my_arm.yaml controller.yaml``, the files that `new-robot` writes. For
another engine, change what has ``model`` and ``data``.
"""

from contextlib import suppress
from pathlib import Path
import sys
import time

from geometry_msgs.msg import Vector3, WrenchStamped
import mujoco
import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import JointState
import yaml

PERIOD = 0.002  # s, of a sample
STEPS = 4  # of the engine in a period
RESEND_PERIOD = 0.2  # s, until a sample that has no answer is published again
GAP = 0.007  # m, from the tip at home to the table
DAMPING = 30.0  # N s/m, of the table
# Standard deviation of the sensor [N, N m]; a reading that repeats itself counts as frozen.
NOISE = np.repeat([0.05, 0.005], 3)

home = yaml.safe_load(Path(sys.argv[1]).read_text())['home']
parameters = yaml.safe_load(Path(sys.argv[2]).read_text())['/**']['ros__parameters']
robot = parameters['robot']
contact = parameters['contacts']['table']
point = np.array(contact['point_operational'])
normal = np.array(contact['normal_world'])

spec = mujoco.MjSpec.from_file(str(Path(sys.argv[2]).parent / robot['urdf']))
spec.compiler.fusestatic = False
spec.compiler.balanceinertia = True
spec.option.timestep = PERIOD / STEPS
spec.body(robot['sensor_frame']).add_site(name='sensor')
for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
    spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname='sensor')
model = spec.compile()
data = mujoco.MjData(model)
joints = [model.joint(name).id for name in robot['joint_names']]
model.dof_armature[joints] = robot['armature']
data.qpos[joints] = home
frame = data.body(robot['operational_frame'])
tool = data.body(robot['sensor_frame'])


mujoco.mj_forward(model, data)
data.qfrc_applied = data.qfrc_bias  # the arm is held
mujoco.mj_forward(model, data)


def find_tip():
    """
    Return where the tip is in the world, shape (3,) [m].

    MuJoCo moves the operational frame; the tip is fixed in it.
    """
    return frame.xpos + frame.xmat.reshape(3, 3) @ point


table = normal @ find_tip() + GAP


def advance(torque):
    """
    Apply joint torques [N m] for a period, in several steps of the engine.

    The table is a spring and a damper along its normal, and only pushes. Its force acts on the
    body beyond the sensor, so that the sensor reads it.
    """
    data.qfrc_applied[joints] = torque
    for _ in range(STEPS):
        before = find_tip()
        mujoco.mj_kinematics(model, data)
        tip = find_tip()
        depth = normal @ tip - table
        speed = normal @ (tip - before) * STEPS / PERIOD
        pressure = 0.0
        if depth > 0.0:
            pressure = max(0.0, contact['stiffness'] * depth + DAMPING * speed)
        force = -pressure * normal
        data.xfrc_applied[tool.id] = [*force, *np.cross(tip - tool.xipos, force)]
        mujoco.mj_step(model, data)


class Simulator(Node):
    """
    Publishes a sample, waits for the command that answers it, and advances by a period.

    So a slow controller slows the simulation down and loses no sample, and the run is the same
    each time but for the noise.
    """

    def __init__(self):
        super().__init__('my_simulator')
        self.joint_states = self.create_publisher(JointState, 'joint_states', 10)
        self.wrench = self.create_publisher(WrenchStamped, 'ft_sensor/wrench', 10)
        self.create_subscription(JointState, 'joint_effort_command', self.obey, 10)
        self.timer = self.create_timer(RESEND_PERIOD, self.publish)
        self.tick = 1
        self.due = time.monotonic()
        self.publish()

    def publish(self):
        """
        Publish the sensors' readings, both with the same stamp.

        The controller pairs joint state and wrench by the stamp. A timer repeats a sample that was
        lost on the way, with new noise.
        """
        self.stamp = Time(nanoseconds=round(self.tick * PERIOD * 1e9)).to_msg()
        sample = JointState(name=robot['joint_names'])
        sample.header.stamp = self.stamp
        sample.position = data.qpos[joints].tolist()
        sample.velocity = data.qvel[joints].tolist()
        reading = WrenchStamped()
        reading.header.stamp = self.stamp
        reading.header.frame_id = robot['sensor_frame']
        wrench = data.sensordata + NOISE * np.random.normal(size=6)
        force, torque = wrench.reshape(2, 3).tolist()  # of the arm on the tool
        reading.wrench.force = Vector3(x=force[0], y=force[1], z=force[2])
        reading.wrench.torque = Vector3(x=torque[0], y=torque[1], z=torque[2])
        self.wrench.publish(reading)
        self.joint_states.publish(sample)

    def obey(self, command):
        """
        Advance by a period, in real time at most, if a command answers the newest sample.

        A command with an older stamp answers a repetition that is no longer needed. Efforts are
        taken by the names of their joints.
        """
        if command.header.stamp == self.stamp:
            effort = dict(zip(command.name, command.effort))
            advance([effort[name] for name in robot['joint_names']])
            self.tick += 1
            self.due = max(self.due + PERIOD, time.monotonic())
            time.sleep(max(0.0, self.due - time.monotonic()))
            self.publish()
            self.timer.reset()


rclpy.init()
with suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(Simulator())
