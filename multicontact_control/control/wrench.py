"""
From what the wrist sensor reads to the contact wrench at the operational point.

The one sign convention of this package: wrenches are what the ROBOT DOES TO THE ENVIRONMENT, and
contact normals point INTO the surfaces, so that pressing is alpha > 0. The sensor reads the
wrench that the arm exerts on the tool, which has the same sign.
"""

from __future__ import annotations

from multicontact_control.arrays import require_shape, Vector
from multicontact_control.config import ToolConfig
from multicontact_control.dynamics.pose import Pose
import numpy as np


def contact_wrench(
    wrench_sensor: Vector, sensor_pose: Pose, position_world: Vector, tool: ToolConfig,
    gravity_world: Vector,
) -> Vector:
    """
    Return the wrench the robot exerts on the environment, at the operational point.

    The sensor reads m (a - g) + f_c + bias: the bias is taken off, the tool's weight m g added
    back, the result rotated to world axes and moved along the lever from the sensor to the
    operational point. The inertia m a is left in (0.05 N for the paper's tool and motion).

    Parameters
    ----------
    wrench_sensor
        Reading in the sensor's axes at its origin, force first, shape (6,) [N, N m].
    sensor_pose
        Pose of the sensor frame.
    position_world
        Operational point, shape (3,) [m].
    tool
        Mass beyond the sensor and its centre of mass, and the sensor's bias.
    gravity_world
        g, shape (3,) [m/s^2].

    Returns
    -------
    Vector
        f_c in world axes at `position_world`, shape (6,) [N, N m].

    Raises
    ------
    ShapeError
        If `wrench_sensor` is not of shape (6,).

    """
    require_shape('wrench_sensor', wrench_sensor, (6,))
    R = sensor_pose.rotation_world
    weight = tool.mass * gravity_world
    unbiased = wrench_sensor - tool.bias_sensor
    force = R @ unbiased[:3] + weight
    moment = R @ unbiased[3:] + _cross(R @ np.asarray(tool.com_sensor), weight)
    wrench = np.empty(6)
    wrench[:3] = force
    wrench[3:] = moment + _cross(sensor_pose.position_world - position_world, force)
    return wrench


def _cross(a: Vector, b: Vector) -> Vector:
    """Cross product of two 3-vectors; np.cross takes ten times as long."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                     a[0] * b[1] - a[1] * b[0]])
