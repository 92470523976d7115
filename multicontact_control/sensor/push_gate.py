"""What stands between an unproved wrist sensor and force control: a push test."""

from __future__ import annotations

from multicontact_control.arrays import Vector
from multicontact_control.config import ToolConfig
from multicontact_control.control.wrench import contact_wrench
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.sensor.push_config import PushTestConfig
from multicontact_control.sensor.push_test import PushTest
from multicontact_control.sensor.push_verdict import PushTestResult

NEEDED = 'force control is disabled until ~/push_test has passed'


class PushGate:
    """
    Leads a user through a push test, sample by sample.

    A test that is failed closes a gate that was open: what it found is true now.

    Parameters
    ----------
    required
        Whether the gate is closed until a test is passed.
    robot
        The arm.
    gravity_world
        g, shape (3,) [m/s^2].
    rate
        Rate of the samples [Hz].

    Attributes
    ----------
    open
        Whether force control is allowed.
    result
        The last verdict, None without any.

    """

    def __init__(
        self, *, required: bool, robot: RobotModel, gravity_world: Vector, rate: float,
    ) -> None:
        self.open = not required
        self.result: PushTestResult | None = None
        self._robot, self._gravity, self._rate = robot, gravity_world, rate
        self._config: PushTestConfig | None = None
        self._point: tuple[float, ...] = ()
        self._test: PushTest | None = None

    @property
    def running(self) -> bool:
        """Whether a test is under way, or begins with the next sample."""
        return self._config is not None

    @property
    def instruction(self) -> str:
        """Say what the user should do now; empty if there is nothing to be done."""
        if self._test is not None:
            return self._test.instruction
        if self.running:
            return 'keep off the tool'
        if self.result is not None:
            return self.result.message
        return '' if self.open else NEEDED

    def start(self, config: PushTestConfig, point_sensor: tuple[float, ...]) -> None:
        """
        Begin a test with the next sample.

        `point_sensor` is where the tool is pushed, sensor frame [m], to check the torque channels
        too; empty not to.
        """
        self._config, self._point, self._test = config, point_sensor, None
        self.result = None

    def restart(self) -> None:
        """Begin a test that is under way anew, with the next sample."""
        self._test = None

    def update(self, q: Vector, qd: Vector, wrench_sensor: Vector, tool: ToolConfig) -> bool:
        """
        Take the next sample of a test that is running.

        Parameters
        ----------
        q, qd
            Joint positions [rad] and velocities [rad/s], shape (n,).
        wrench_sensor
            Reading in sensor axes, force first, shape (6,) [N, N m].
        tool
            What hangs on the sensor.

        Returns
        -------
        bool
            Whether the test has come to its end.

        """
        if self._config is None:
            return False
        state = self._robot.update(q, qd)
        sensor, position = state.sensor_pose, state.pose.position_world
        if self._test is None:
            rotation = sensor.rotation_world
            lever = sensor.position_world + rotation @ self._point - position if (
                self._point) else None
            self._test = PushTest(
                self._config, self._rate, sensor_rotation_world=rotation, lever_world=lever)
        self._test.update(contact_wrench(wrench_sensor, sensor, position, tool, self._gravity))
        if self._test.result is None:
            return False
        self.result = self._test.result
        self.open = self.result.passed
        self._config = self._test = None
        return True
