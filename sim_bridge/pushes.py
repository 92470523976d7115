"""Pushes that come and go at set times, by a hand that the simulation does not otherwise know."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.errors import ConfigError
import numpy as np
import pinocchio as pin
from sim_bridge.arm import SENSOR_FRAME
from sim_bridge.config import PlantConfig

# What pushes the last link or the tool at one point; world axes.
HAND = np.dtype([
    ('force', np.float64, 3),  # [N]
    ('local', np.float64, 3),  # the point in the last joint's frame [m]
    ('point', np.float64, 3),  # where it is, of use while it pushes [m]
])


class Pushes:
    """
    Forces on one point of the arm that come and go at set times.

    Parameters
    ----------
    hand
        Record of `HAND` that pushes: its force is set.
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

    """

    def __init__(
        self, hand: Any, rate: float, start: Sequence[float], duration: Sequence[float],
        force_world: Sequence[float],
    ) -> None:
        self.force_world: Vector = hand['force']
        self._pushes = [
            (round(begin * rate), round((begin + length) * rate),
             np.array(force_world[3 * i:3 * i + 3]))
            for i, (begin, length) in enumerate(zip(start, duration, strict=True))]

    def add(self, first: int, ticks: int, force_world: Vector) -> None:
        """Push also with a force [N] over some control periods from a tick on."""
        self._pushes = [push for push in self._pushes if push[1] > first]
        self._pushes.append((first, first + ticks, np.array(force_world, dtype=float)))

    def start_period(self, tick: int) -> None:
        """Take the forces of the control period that begins with a tick."""
        if self._pushes:
            self.force_world[:] = sum((force for first, end, force in self._pushes
                                       if first <= tick < end), np.zeros(3))


def tool_push_point(config: PlantConfig, model: pin.Model) -> tuple[Vector, Vector]:
    """
    Return where the tool is pushed: in the last joint's frame and in the sensor's [m].

    Raises
    ------
    ConfigError
        If the tool has no such link.

    """
    name = config.tool_push_link
    sensor = model.frames[model.getFrameId(SENSOR_FRAME)]
    pushed = model.frames[model.getFrameId(name)] if model.existFrame(name) else None
    if pushed is None or pushed.parentJoint != sensor.parentJoint:
        raise ConfigError('tool_push_link', 'a link of the tool', f"'{name}'")
    point: Vector = np.array(pushed.placement.translation)
    return point, sensor.placement.actInv(point)
