"""What an arm adds to a command, if its drives hold it against gravity by themselves."""

from __future__ import annotations

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.dynamics.robot import RobotModel
import numpy as np


class OwnWeight:
    """
    The gravity torque that an arm adds itself: what acts is the command and this.

    The control law, the reactions and the gate reckon with the torque that acts. It is only when
    a torque leaves for the arm that this is taken off, and when a measured effort comes in that it
    is put on. Before the joints are known it is 0: then an arm that carries itself needs nothing.

    Parameters
    ----------
    config
        Whether `tool` is in it.
    robot
        The arm.

    Attributes
    ----------
    torque
        Where the arm was seen last, shape (n,) [N m].

    """

    def __init__(self, config: ControllerConfig, robot: RobotModel) -> None:
        self._robot, self._tool = robot, config.tool
        self._with_tool = config.robot.adds_tool_gravity
        self.reset()

    def reset(self) -> None:
        """Forget where the arm was."""
        self.torque: Vector = np.zeros(self._robot.joint_count)

    def update(self) -> Vector:
        """
        Work it out where the robot's model was computed last.

        Returns
        -------
        Vector
            By how much it has changed, shape (n,) [N m].

        """
        torque = self._robot.terms.gravity.copy()
        if not self._with_tool:
            torque -= self._robot.load_torque(self._tool.mass, np.array(self._tool.com_sensor))
        change: Vector = torque - self.torque
        self.torque = torque
        return change
