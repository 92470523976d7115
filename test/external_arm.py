"""
A user's own simulator, without this package: pinocchio, a wall, ROS topics.

As a program it is the node `my_arm`: an arm of seven joints with a wrist sensor that carries a
tool and has a bias. Its brakes are on until efforts come, and again when they stay away. It waits
for the efforts that answer a sample, as simulators do.
"""

import sys
import time

import numpy as np
import pinocchio as pin

PERIOD = 0.002  # s
ANSWER_TIMEOUT = 0.1  # s, for the efforts that answer a sample
BRAKE_TIME = 0.3  # s without efforts until the brakes are on
TOOL_MASS, TOOL_COM = 0.8, np.array([0.01, -0.02, 0.06])  # kg, m
BIAS = np.array([1.5, -0.7, 2.0, 0.05, -0.02, 0.03])  # N, N m


class Arm:
    """An arm whose wrist meets a springy wall; `pushes` are forces on frames [N], world axes."""

    def __init__(self, urdf, armature, normal, distance, stiffness):
        self._model = pin.buildModelFromUrdf(str(urdf))
        self._model.armature = np.array(armature)
        self._data = self._model.createData()
        self._wrist = self._model.getFrameId('wrist')
        self._random = np.random.default_rng(0)
        self._normal, self._stiffness = np.array(normal), stiffness
        self.q = np.array([0.3, 0.7, -0.4, 0.9, 0.5, -0.8, 0.6])
        self.v = np.zeros(7)
        self.pushes = {}
        self._wall = self._normal @ self.wrist.translation + distance

    @property
    def wrist(self):
        pin.framesForwardKinematics(self._model, self._data, self.q)
        return self._data.oMf[self._wrist]

    @property
    def force(self):
        """Return what the wrist presses with, 0 beside the wall [N]."""
        depth = self._normal @ self.wrist.translation - self._wall
        return self._stiffness * max(depth, 0.0)

    def weight_sensor(self):
        force = -TOOL_MASS * self.wrist.rotation.T @ self._model.gravity.linear
        return np.concatenate([force, np.cross(TOOL_COM, force)]) + BIAS

    def wrench_sensor(self):
        pressing = self.wrist.rotation.T @ (self.force * self._normal)
        noise = self._random.normal(size=6) * ([0.05] * 3 + [0.005] * 3)
        return np.concatenate([pressing, np.zeros(3)]) + noise

    def jacobian(self, frame):
        return pin.computeFrameJacobian(
            self._model, self._data, self.q, self._model.getFrameId(frame),
            pin.LOCAL_WORLD_ALIGNED)[:3]

    def step(self, torque, period, substeps=8):
        """Advance by a period."""
        for _ in range(substeps):
            load = self.jacobian('wrist').T @ (-self.force * self._normal)
            for frame, force in self.pushes.items():
                load = load + self.jacobian(frame).T @ force
            a = pin.aba(self._model, self._data, self.q, self.v, torque + load)
            self.v = self.v + a * period / substeps
            self.q = self.q + self.v * period / substeps

    def brake(self):
        self.v = np.zeros_like(self.v)


class Topics:
    def __init__(self, namespace):
        from geometry_msgs.msg import WrenchStamped
        import rclpy
        from sensor_msgs.msg import JointState

        rclpy.init()
        self.node = rclpy.create_node('my_arm', namespace=namespace)
        self._joint_state, self._wrench_stamped = JointState, WrenchStamped
        self._joints = self.node.create_publisher(JointState, 'joint_states', 10)
        self._wrench = self.node.create_publisher(WrenchStamped, 'ft_sensor/wrench', 10)
        self._efforts = self.node.create_subscription(
            JointState, 'joint_effort_command', lambda _: None, 10)

    def publish(self, k, q, v, wrench):
        message, reading = self._joint_state(), self._wrench_stamped()
        nanoseconds = 1_000_000_000 + round(k * PERIOD * 1e9)
        for header in (message.header, reading.header):
            header.stamp.sec, header.stamp.nanosec = divmod(nanoseconds, 1_000_000_000)
        message.name = [f'j{i}' for i in reversed(range(len(q)))]  # in an order of its own
        message.position, message.velocity = q[::-1].tolist(), v[::-1].tolist()
        force, torque = reading.wrench.force, reading.wrench.torque
        force.x, force.y, force.z, torque.x, torque.y, torque.z = wrench.tolist()
        self._wrench.publish(reading)
        self._joints.publish(message)
        return message.header.stamp

    def newest(self):
        """Return the newest efforts since the last call, None without any."""
        found = None
        handle = self._efforts.handle
        with handle:
            while (taken := handle.take_message(self._joint_state, False)) is not None:
                found = taken[0]
        return found


def main():
    arm = Arm(sys.argv[1], [0.1] * 7, [1.0, 0.0, 0.0], 0.005, 5000.0)
    topics = Topics(sys.argv[2] if len(sys.argv) > 2 else '')
    efforts, heard, k, due = None, -BRAKE_TIME, 0, time.monotonic()
    while True:
        stamp = topics.publish(k, arm.q, arm.v, arm.wrench_sensor() + arm.weight_sensor())
        give_up = time.monotonic() + ANSWER_TIMEOUT
        while True:
            taken = topics.newest()
            if taken is not None:
                efforts, heard = dict(zip(taken.name, taken.effort)), k * PERIOD
                if taken.header.stamp == stamp:
                    break
            commanded = heard > k * PERIOD - BRAKE_TIME
            if not commanded or time.monotonic() > give_up:
                break
            time.sleep(0.0002)
        if efforts is not None and heard > k * PERIOD - BRAKE_TIME:
            arm.step(np.array([efforts[f'j{i}'] for i in range(7)]), PERIOD)
        else:
            arm.brake()
        k += 1
        due = max(due + PERIOD, time.monotonic() - 0.1)
        time.sleep(max(0.0, due - time.monotonic()))


if __name__ == '__main__':
    main()
