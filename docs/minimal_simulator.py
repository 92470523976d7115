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

PERIOD, STEPS = 0.002, 4  # s, of a sample; steps of the engine in it
RESEND = 0.2  # s, until a sample that has no answer is published again
GAP, DAMPING = 0.007, 30.0  # m, from the tip at home to the table; N s/m, of the table
NOISE = np.repeat(
    [0.05, 0.005], 3
)  # N, N m; a reading that repeats itself counts as frozen

home = yaml.safe_load(Path(sys.argv[1]).read_text())['home']
parameters = yaml.safe_load(Path(sys.argv[2]).read_text())['/**']['ros__parameters']
robot, contact = parameters['robot'], parameters['contacts']['table']
point, normal = (
    np.array(contact['point_operational']),
    np.array(contact['normal_world']),
)

spec = mujoco.MjSpec.from_file(str(Path(sys.argv[2]).parent / robot['urdf']))
spec.compiler.fusestatic, spec.compiler.balanceinertia = False, True
spec.option.timestep = PERIOD / STEPS
spec.body(robot['sensor_frame']).add_site(name='sensor')
for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
    spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname='sensor')
model = spec.compile()
data = mujoco.MjData(model)
joints = [model.joint(name).id for name in robot['joint_names']]
model.dof_armature[joints], data.qpos[joints] = robot['armature'], home
frame, tool = data.body(robot['operational_frame']), data.body(robot['sensor_frame'])


mujoco.mj_forward(model, data)
data.qfrc_applied = data.qfrc_bias  # the arm is held
mujoco.mj_forward(model, data)


def tip():
    """Return where the tip is in the world, shape (3,) [m]."""
    return frame.xpos + frame.xmat.reshape(3, 3) @ point


table = normal @ tip() + GAP


def advance(torque):
    """Apply joint torques for a period [N m]; the table pushes what is beyond the sensor."""
    data.qfrc_applied[joints] = torque
    for _ in range(STEPS):
        before = tip()
        mujoco.mj_kinematics(model, data)
        depth, speed = (
            normal @ tip() - table,
            normal @ (tip() - before) * STEPS / PERIOD,
        )
        press = (
            max(0.0, contact['stiffness'] * depth + DAMPING * speed)
            if depth > 0.0
            else 0.0
        )
        lever, force = tip() - tool.xipos, -press * normal
        data.xfrc_applied[tool.id] = [*force, *np.cross(lever, force)]
        mujoco.mj_step(model, data)


class Simulator(Node):
    """Publishes a sample, waits for the command that answers it, and advances by a period."""

    def __init__(self):
        super().__init__('my_simulator')
        self.joint_states = self.create_publisher(JointState, 'joint_states', 10)
        self.wrench = self.create_publisher(WrenchStamped, 'ft_sensor/wrench', 10)
        self.create_subscription(JointState, 'joint_effort_command', self.obey, 10)
        self.timer = self.create_timer(RESEND, self.publish)
        self.tick, self.due = 1, time.monotonic()
        self.publish()

    def publish(self):
        """Publish the sensors' readings, both with the same stamp."""
        sample, reading = JointState(name=robot['joint_names']), WrenchStamped()
        self.stamp = Time(nanoseconds=round(self.tick * PERIOD * 1e9)).to_msg()
        sample.header.stamp = reading.header.stamp = self.stamp
        reading.header.frame_id = robot['sensor_frame']
        sample.position, sample.velocity = (
            data.qpos[joints].tolist(),
            data.qvel[joints].tolist(),
        )
        wrench = data.sensordata + NOISE * np.random.normal(
            size=6
        )  # of the arm on the tool
        reading.wrench.force, reading.wrench.torque = (
            Vector3(x=x, y=y, z=z) for x, y, z in wrench.reshape(2, 3).tolist()
        )
        self.wrench.publish(reading)
        self.joint_states.publish(sample)

    def obey(self, command):
        """Advance by a period, in real time at most, if a command answers the newest sample."""
        if command.header.stamp == self.stamp:
            effort = dict(zip(command.name, command.effort))
            advance([effort[name] for name in robot['joint_names']])
            self.tick, self.due = (
                self.tick + 1,
                max(self.due + PERIOD, time.monotonic()),
            )
            time.sleep(max(0.0, self.due - time.monotonic()))
            self.publish()
            self.timer.reset()


rclpy.init()
with suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(Simulator())
