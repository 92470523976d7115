"""
A force command of your own over the topics, with rclpy alone: a sine, and how far it is followed.

In one terminal ``multicontact run --commanded --domain-id 5`` starts a simulated arm; in another
``ROS_DOMAIN_ID=5 python examples/sine_of_force.py`` presses on the table with 10 N + 3 N sin(w t).
A whole simulator behind the topics is docs/minimal_simulator.py.
"""

import math
import os

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState

CONTACT = 'table'
MEAN, AMPLITUDE = 10.0, 3.0  # N
FREQUENCY = 0.5  # Hz
PERIOD = 0.02  # s, between two commands
# s since the first sample; a whole number of periods between them.
SETTLED, END = 8.0, 14.0


class SineOfForce(Node):
    """Commands the force by the stamps of the samples, and keeps what is measured."""

    def __init__(self) -> None:
        super().__init__('sine_of_force')
        self.begin: float | None = None  # stamp of the first sample [s]
        self.next_command = 0.0  # since then, as all times that follow [s]
        self.ended = False
        self.samples: list[tuple[float, float]] = []  # time [s], force [N]
        self.commands = self.create_publisher(JointState, 'contact_forces/command', 10)
        self.create_subscription(
            JointState, 'contact_forces/measured', self.take_forces, 100
        )

    def take_forces(self, measured: JointState) -> None:
        """Keep the force of a sample, and command the next value when it is due."""
        stamp = measured.header.stamp.sec + 1e-9 * measured.header.stamp.nanosec
        if self.begin is None:
            self.begin = stamp
        time = stamp - self.begin
        force = dict(zip(measured.name, measured.effort))[CONTACT]
        if SETTLED <= time < END:
            self.samples.append((time, force))
        self.ended = time >= END
        if time >= self.next_command:
            self.next_command = time + PERIOD
            sine = math.sin(2.0 * math.pi * FREQUENCY * time)
            command = JointState(name=[CONTACT], effort=[MEAN + AMPLITUDE * sine])
            self.commands.publish(command)


def main() -> None:
    """Command the sine until its end, and print mean, amplitude and delay of what is measured."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init()
    node = SineOfForce()
    while not node.ended:
        rclpy.spin_once(node)
    time, force = np.array(node.samples).T
    angle = 2.0 * np.pi * FREQUENCY * time
    parts = np.column_stack([np.ones(len(angle)), np.sin(angle), np.cos(angle)])
    mean, in_phase, ahead = np.linalg.lstsq(parts, force, rcond=None)[0]
    delay = math.atan2(-ahead, in_phase) / (2.0 * math.pi * FREQUENCY)
    print(
        f'mean {mean:.2f} N, amplitude {math.hypot(in_phase, ahead):.2f} N of {AMPLITUDE} N'
    )
    print(f'delay {1e3 * delay:.0f} ms, of {len(time)} samples')
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main()
