"""
From what the wrist sensor reads to the contact forces.

The one sign convention of this package: wrenches are what the ROBOT DOES TO THE ENVIRONMENT, and
contact normals point INTO the surfaces, so that pressing is alpha > 0. The sensor reads the
wrench that the arm exerts on the tool, which has the same sign.
"""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import cross
from multicontact_control.arrays import require_shape, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ToolConfig
from multicontact_control.contact.geometry import fill_normal_space
from multicontact_control.contact.projections import (
    active_rows,
    coordinates,
    factorise_contacts,
)
from multicontact_control.dynamics.pose import Pose
from multicontact_control.records import CONTROL, Records, TOOL
import numpy as np


@compiled
def operational_wrench(control: Any, wrench: Vector) -> None:
    """
    Fill in the wrench the robot exerts on the environment, at the operational point.

    The sensor reads m (a - g) + f_c + bias: the bias is taken off, the tool's weight m g added
    back, the result rotated to world axes and moved along the lever from the sensor to the
    operational point. The inertia m a is left in: 0.05 N with the paper's tool and motion on rigid
    drives, and up to 1 N where flexible ones let the tool swing.

    Parameters
    ----------
    control
        Record of `CONTROL`, with the reading in it.
    wrench
        Filled with f_c, world axes, shape (6,) [N, N m].

    """
    frame, tool, reading = control.frame, control.tool, control.wrench
    rotation, weight, bias = frame.sensor_rotation, tool.weight, tool.bias
    com = np.empty(3)
    lever = np.empty(3)
    moment = np.empty(3)
    for i in range(3):
        com[i] = 0.0
        wrench[i] = weight[i]
        wrench[3 + i] = 0.0
        lever[i] = frame.sensor_position[i] - frame.position[i]
        for j in range(3):
            com[i] += rotation[i, j] * tool.com_sensor[j]
            wrench[i] += rotation[i, j] * (reading[j] - bias[j])
            wrench[3 + i] += rotation[i, j] * (reading[3 + j] - bias[3 + j])
    cross(com, weight, moment)
    for i in range(3):
        wrench[3 + i] += moment[i]
    cross(lever, wrench, moment)
    for i in range(3):
        wrench[3 + i] += moment[i]


@compiled
def measure_contacts(control: Any, contacts: Any) -> bool:
    """
    Work out the contact forces that the wrist sensor feels.

    alpha = (N^T N)^-1 N^T f_c (P04 eqs 2, 5, 7). All contacts share the wrench among them, at
    most six.

    Parameters
    ----------
    control
        As for `operational_wrench`.
    contacts
        Records of `CONTACT`, shape (r,): `N` and `alpha_meas` are filled in.

    Returns
    -------
    bool
        Whether the columns of N are independent.

    """
    count = contacts.shape[0]
    wrench = np.empty(6)
    rows = np.empty((count, 6))
    factor = np.empty((count, count))
    alpha = np.empty(count)
    operational_wrench(control, wrench)
    fill_normal_space(contacts, control.frame.rotation)
    active_rows(contacts, True, rows)
    if not factorise_contacts(contacts, True, rows, rows, factor):
        return False
    coordinates(rows, factor, wrench, alpha)
    for i in range(count):
        contacts[i].alpha_meas = alpha[i]
    return True


def tool_record(tool: ToolConfig, gravity_world: Vector) -> Records:
    """Return what hangs on the sensor as one record of `TOOL`; g in [m/s^2], shape (3,)."""
    record = np.zeros(1, dtype=TOOL)
    record['com_sensor'], record['bias'] = tool.com_sensor, tool.bias_sensor
    record['weight'] = tool.mass * gravity_world
    return record


def contact_wrench(
    wrench_sensor: Vector, sensor_pose: Pose, position_world: Vector, tool: ToolConfig,
    gravity_world: Vector,
) -> Vector:
    """
    Return the wrench the robot exerts on the environment; see `operational_wrench`.

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
    control, wrench = np.zeros(1, dtype=CONTROL), np.empty(6)
    frame = control['frame']
    frame['position'] = position_world
    frame['sensor_position'], frame['sensor_rotation'] = sensor_pose
    control['tool'], control['wrench'] = tool_record(tool, gravity_world), wrench_sensor
    operational_wrench(control[0], wrench)
    return wrench
