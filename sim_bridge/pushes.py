"""Pushes that come and go at set times, by a hand that the simulation does not otherwise know."""

from __future__ import annotations

from collections.abc import Sequence

from multicontact_control.arrays import Vector
from multicontact_control.errors import ConfigError
import numpy as np
import pinocchio as pin
from sim_bridge.arm import SENSOR_FRAME
from sim_bridge.config import PlantConfig
from sim_bridge.kinematics import add_joint_torque, chain_of, forward_kinematics


class Pushes:
    """
    Forces on one point of the arm that come and go at set times.

    Parameters
    ----------
    rate
        Control rate [Hz].
    start, duration
        Of each push [s].
    force_world
        x y z of each in turn, world axes [N].

    Attributes
    ----------
    force_world
        Their sum in the present control period, shape (3,) [N].
    acting
        Whether there is any.

    """

    def __init__(
        self, rate: float, start: Sequence[float], duration: Sequence[float],
        force_world: Sequence[float],
    ) -> None:
        self._pushes = [
            (round(begin * rate), round((begin + length) * rate),
             np.array(force_world[3 * i:3 * i + 3]))
            for i, (begin, length) in enumerate(zip(start, duration, strict=True))]
        self.force_world: Vector = np.zeros(3)
        self.acting = False

    def add(self, first: int, ticks: int, force_world: Vector) -> None:
        """Push also with a force [N] over some control periods from a tick on."""
        self._pushes = [push for push in self._pushes if push[1] > first]
        self._pushes.append((first, first + ticks, np.array(force_world, dtype=float)))

    def start_period(self, tick: int) -> None:
        """Take the forces of the control period that begins with a tick."""
        forces = [force for first, end, force in self._pushes if first <= tick < end]
        self.force_world = sum(forces, np.zeros(3))
        self.acting = bool(forces)


class ToolPush(Pushes):
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
    point_world
        Where they push, shape (3,) [m]; only up to date while something does.
    point_sensor
        The same in the frame of the wrist sensor.

    Raises
    ------
    ConfigError
        If the tool has no such link.

    """

    def __init__(self, config: PlantConfig, model: pin.Model, rate: float) -> None:
        super().__init__(rate, config.tool_push_start, config.tool_push_duration,
                         config.tool_push_force_world)
        name = config.tool_push_link
        sensor = model.frames[model.getFrameId(SENSOR_FRAME)]
        pushed = model.frames[model.getFrameId(name)] if model.existFrame(name) else None
        if pushed is None or pushed.parentJoint != sensor.parentJoint:
            raise ConfigError('tool_push_link', 'a link of the tool', f"'{name}'")
        self._local: Vector = np.array(pushed.placement.translation)
        self.point_sensor: Vector = sensor.placement.actInv(self._local)
        self._links = chain_of(model)
        self.point_world = np.zeros(3)

    def add_load(self, q: Vector, load: Vector) -> bool:
        """Add what acts to the load of the joints at `q`, shape (n,) [N m]; return whether any."""
        if not self.acting:
            return False
        rotation = np.empty((3, 3))
        forward_kinematics(q, self._links, rotation)
        self.point_world = self._links['origin'][-1] + rotation @ self._local
        add_joint_torque(
            self.point_world, self.force_world, 1.0, self._links, len(load) - 1, load)
        return True
