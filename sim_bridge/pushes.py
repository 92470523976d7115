"""Pushes that come and go at set times, by a hand that the simulation does not otherwise know."""

from __future__ import annotations

from collections.abc import Sequence

from multicontact_control.arrays import Vector
from multicontact_control.errors import ConfigError
import numpy as np
import pinocchio as pin
from sim_bridge.config import PlantConfig
from sim_bridge.kinematics import add_joint_torque, chain_of, forward_kinematics


def push_at(
    tick: int, rate: float, start: Sequence[float], duration: Sequence[float],
    force_world: Sequence[float],
) -> Vector:
    """
    Return the sum of the pushes in the control period that begins with a tick.

    Parameters
    ----------
    tick
        The tick.
    rate
        Control rate [Hz].
    start, duration
        Of each push [s].
    force_world
        x y z of each in turn [N].

    Returns
    -------
    Vector
        World axes, shape (3,) [N].

    """
    total = np.zeros(3)
    for i, (begin, length) in enumerate(zip(start, duration, strict=True)):
        if round(begin * rate) <= tick < round((begin + length) * rate):
            total += force_world[3 * i:3 * i + 3]
    return total


class ToolPush:
    """
    Forces at one point of the tool, beyond the wrist sensor, which reads their opposite.

    Parameters
    ----------
    config
        The plant, with the pushes.
    model
        The arm, for its geometry.
    rate
        Control rate [Hz].

    Attributes
    ----------
    force_world
        Force on the tool now, shape (3,) [N].
    point_world
        Where, shape (3,) [m]; only up to date while something pushes.

    Raises
    ------
    ConfigError
        If the arm has no such link.

    """

    def __init__(self, config: PlantConfig, model: pin.Model, rate: float) -> None:
        name = config.tool_push_link
        if not model.existFrame(name):
            raise ConfigError('tool_push_link', 'a link of the tool', f"'{name}'")
        self._local: Vector = np.array(model.frames[model.getFrameId(name)].placement.translation)
        self._links = chain_of(model)
        self._schedule = (
            config.tool_push_start, config.tool_push_duration, config.tool_push_force_world)
        self._rate = rate
        self.force_world, self.point_world = np.zeros(3), np.zeros(3)

    def start_period(self, tick: int) -> None:
        """Take the force of the control period that begins."""
        self.force_world = push_at(tick, self._rate, *self._schedule)

    def add_load(self, q: Vector, load: Vector) -> bool:
        """
        Add what the push does to the joints.

        Parameters
        ----------
        q
            Link side of the joints, shape (n,) [rad].
        load
            Added to, shape (n,) [N m].

        Returns
        -------
        bool
            Whether anything pushes.

        """
        if not self.force_world.any():
            return False
        rotation = np.empty((3, 3))
        forward_kinematics(q, self._links, rotation)
        self.point_world = self._links['origin'][-1] + rotation @ self._local
        add_joint_torque(self.point_world, self.force_world, 1.0, self._links, load)
        return True
