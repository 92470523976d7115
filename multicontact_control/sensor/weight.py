"""What the tool's weight makes the wrist sensor read."""

from __future__ import annotations

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ToolConfig
import numpy as np


def weight_reading(rotation_world: Matrix, tool: ToolConfig, gravity_world: Vector) -> Vector:
    """
    Return what an unbiased sensor reads at rest with nothing touching the tool.

    -m R^T g and its moment about the sensor: the arm holds the tool up. `contact_wrench` makes
    exactly 0 of it.

    Parameters
    ----------
    rotation_world
        Orientation of the sensor, shape (3, 3).
    tool
        Mass and centre of mass; its bias is not used.
    gravity_world
        g, shape (3,) [m/s^2].

    Returns
    -------
    Vector
        Sensor axes, force first, shape (6,) [N, N m].

    """
    force = -tool.mass * (rotation_world.T @ gravity_world)
    return np.concatenate((force, np.cross(tool.com_sensor, force)))
