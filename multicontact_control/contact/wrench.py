"""
From what the wrist sensor reads to the contact forces.

The one sign convention of this package: wrenches are what the ROBOT DOES TO THE ENVIRONMENT, and
contact normals point INTO the surfaces, so that pressing is alpha > 0. The sensor reads the
wrench that the arm exerts on the tool, which has the same sign.
"""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.algebra import (
    add_scaled_vector,
    add_vector,
    cholesky,
    component_across,
    cross,
    dot,
    multiply_vector,
    rotate_vector,
    solve_cholesky,
    solve_lower,
    vector_between,
    velocity_at,
)
from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.compiled import compiled
from multicontact_control.config import ToolConfig
from multicontact_control.contact.geometry import fill_normal_space
from multicontact_control.contact.projections import factorise_contacts
from multicontact_control.records import (
    Contact,
    CONTROL,
    Control,
    Frame,
    Law,
    MAX_COLUMNS,
    Record,
    record_dtype,
    Records,
    TOOL,
    Tool,
)
import numpy as np


class ContactSpace(Record, Protocol):
    """What `measure_contacts` works in; one."""

    # f_c [N, N m], and of each contact [N].
    wrench: Annotated[Vector, 6]
    alpha: Annotated[Vector, MAX_COLUMNS]

    # Of N^T W^-1 N.
    rows: Annotated[Matrix, MAX_COLUMNS, 6]
    factor: Annotated[Matrix, MAX_COLUMNS, MAX_COLUMNS]

    friction: Annotated[Matrix, MAX_COLUMNS, 3]  # that 1 N along each normal comes with

    # W and W^(1/2); of friction.
    W: Annotated[Matrix, 6, 6]
    root: Annotated[Matrix, 6, 6]
    column: Annotated[Vector, 6]


CONTACT_SPACE = record_dtype(ContactSpace)


FRICTION_SPEED = 0.01  # m/s, v_s: of sliding, at which 71 % of the friction is expected


@compiled
def operational_wrench(control: Control, wrench: Vector) -> None:
    """
    Fill in the wrench the robot exerts on the environment, at the operational point.

    The sensor reads m (a - g) + f_c + bias. The bias is subtracted; the weight m g is added, since
    it is in the reading with the opposite sign. The tool's inertia m a is left in: 0.05 N with the
    paper's tool and motion on rigid drives, and up to 1 N where flexible ones let the tool swing.
    `control` is a record of `CONTROL` with the reading in it, `wrench` is filled with f_c, world
    axes, shape (6,) [N, N m].
    """
    frame, tool, reading = control.frame, control.tool, control.wrench
    rotation, weight, bias = frame.sensor_rotation, tool.weight, tool.bias
    wrench[:3] = weight
    wrench[3:] = 0.0
    for i in range(3):
        for j in range(3):
            wrench[i] += rotation[i, j] * (reading[j] - bias[j])
            wrench[3 + i] += rotation[i, j] * (reading[3 + j] - bias[3 + j])
    lever = vector_between(frame.position, frame.sensor_position)
    add_vector(wrench[3:], cross(rotate_vector(rotation, tool.com_sensor), weight))
    add_vector(wrench[3:], cross(lever, wrench))


@compiled
def measure_contacts(
    control: Control, contacts: Records[Contact], space: ContactSpace
) -> bool:
    """
    Work out the contact forces; return whether the columns of N are independent.

    alpha = (N^T N)^-1 N^T f_c (P04 eqs 2, 5, 7), or as `whiten_by_friction_covariance` says, of
    all contacts together. To the friction that is expected of each the likeliest other is added,
    s^2 T^T W^-1 (f_c - N alpha). Of the contacts, records of `CONTACT`, shape (r,), `N` is filled
    in, which follows from the posture alone; `alpha_meas`, without what is `untared`, and
    `friction` only if the columns are independent. `space` is a record of `CONTACT_SPACE`.
    """
    count, law, frame = contacts.shape[0], control.law, control.frame
    wrench, alpha, rows = space.wrench, space.alpha[:count], space.rows[:count]
    factor = space.factor[:count, :count]
    operational_wrench(control, wrench)
    fill_normal_space(contacts, frame.rotation)
    for i in range(count):
        rows[i] = contacts[i].N
    if law.separated:
        expect_friction(frame, contacts, space.friction, rows)
        whiten_by_friction_covariance(control, contacts, space)
    if not factorise_contacts(contacts, True, rows, rows, factor):
        return False
    multiply_vector(rows, wrench, alpha)
    solve_cholesky(factor, alpha)
    for i in range(count):
        contacts[i].alpha_meas = alpha[i] - contacts[i].untared
    if not law.separated:
        return True
    for i in range(count):
        add_scaled_vector(wrench, -alpha[i], rows[i])
    for i in range(count):
        contact, column = contacts[i], space.column
        for axis in range(3):
            contact.friction[axis] = space.friction[i, axis] * contact.alpha_meas
            if contact.config.friction_std > 0.0:
                fill_friction(law, frame, contact, axis, column)
                solve_lower(space.root, column)
                contact.friction[axis] += contact.config.friction_std**2 * dot(
                    column, wrench
                )
    return True


@compiled
def expect_friction(
    frame: Frame,
    contacts: Records[Contact],
    friction: Matrix,
    rows: Matrix,
) -> None:
    """
    Add the friction that 1 N along the normal is expected to come with.

    The robot drags a surface along its sliding velocity v by mu v / sqrt(v^2 + v_s^2): filled in
    in `friction`, per newton, shape (r, 3), and added to `rows`, N^T, shape (r, 6).
    """
    for i in range(contacts.shape[0]):
        contact = contacts[i]
        friction[i] = 0.0
        if contact.config.friction_coefficient <= 0.0:
            continue
        point = rotate_vector(frame.rotation, contact.config.point)
        velocity = component_across(velocity_at(frame.twist, point), contact.normal)
        share = contact.config.friction_coefficient / np.sqrt(
            dot(velocity, velocity) + FRICTION_SPEED**2
        )
        add_scaled_vector(friction[i], share, velocity)
        add_vector(rows[i, :3], friction[i])
        add_vector(rows[i, 3:], cross(point, friction[i]))


@compiled
def whiten_by_friction_covariance(
    control: Control, contacts: Records[Contact], space: ContactSpace
) -> None:
    """
    Weigh a wrench and the columns of N by what besides the normal forces may be in it.

    Least squares of the results are alpha = (N^T W^-1 N)^-1 N^T W^-1 f_c, W = S + sum T_i T_i^T:
    the sensor's noise, and friction of a standard deviation in every direction across the normal
    of each contact, and about it.

    N^T in `rows` and f_c in `wrench` of a record of `CONTACT_SPACE` are replaced by W^(-1/2) times
    themselves; `root` is filled with W^(1/2), lower triangular, in units of the noise at the
    sensor.
    """
    law, frame = control.law, control.frame
    W, friction = space.W, space.column
    W[:] = 0.0
    for i in range(6):
        W[i, i] = 1.0
    for i in range(contacts.shape[0]):
        contact = contacts[i]
        if contact.config.friction_std <= 0.0:
            continue
        for axis in range(4):  # three of the force, then the torque about the normal
            std = contact.config.friction_std
            if axis == 3:
                std = contact.config.torsion_std
            fill_friction(law, frame, contact, axis, friction)
            for j in range(6):
                for k in range(6):
                    W[j, k] += std * std * friction[j] * friction[k]
    cholesky(W, space.root, 0.0)  # positive definite, as it is 1 and more
    weigh_at_sensor(law, frame, space.wrench)
    solve_lower(space.root, space.wrench)
    for i in range(contacts.shape[0]):
        weigh_at_sensor(law, frame, space.rows[i])
        solve_lower(space.root, space.rows[i])


@compiled
def fill_friction(
    law: Law, frame: Frame, contact: Contact, axis: int, column: Vector
) -> None:
    """
    Fill in the wrench at the sensor, over its noise, of 1 N of friction along a world axis.

    Axis 3 stands for 1 N m about the normal.
    """
    normal = contact.normal
    column[:] = 0.0
    if axis < 3:
        add_scaled_vector(column[:3], -normal[axis], normal)
        column[axis] += 1.0
        column[3:] = cross(rotate_vector(frame.rotation, contact.config.point), column)
    else:
        column[3:] = normal
    weigh_at_sensor(law, frame, column)


@compiled
def weigh_at_sensor(law: Law, frame: Frame, wrench: Vector) -> None:
    """Move a wrench from the operational point to the sensor, in units of its noise."""
    moment = cross(vector_between(frame.position, frame.sensor_position), wrench)
    for i in range(3):
        wrench[i] /= law.force_noise
        wrench[3 + i] = (wrench[3 + i] - moment[i]) / law.torque_noise


def make_tool_record(tool: ToolConfig, gravity_world: Vector) -> Records[Tool]:
    """Return what hangs on the sensor as one record of `TOOL`; g in [m/s^2], shape (3,)."""
    record = np.zeros(1, dtype=TOOL)
    record['com_sensor'] = tool.com_sensor
    record['bias'] = tool.bias_sensor
    record['weight'] = tool.mass * gravity_world
    record['mass'] = tool.mass
    return record


def interpolate_tool(before: ToolConfig, after: ToolConfig, share: float) -> ToolConfig:
    """
    Return the tool at a share of the way from one to another.

    Mass, first moment and bias change linearly, as readings are linear in them.
    """
    if share >= 1.0:
        return after
    old = _linear_parameters(before)
    new = _linear_parameters(after)
    mass, *numbers = (old + share * (new - old)).tolist()
    com = np.zeros(3)
    if mass:
        com = np.array(numbers[:3]) / mass
    x, y, z = com.tolist()
    return ToolConfig(mass=mass, com_sensor=(x, y, z), bias_sensor=tuple(numbers[3:]))


def _linear_parameters(tool: ToolConfig) -> Vector:
    """Return mass [kg], first moment [kg m] and bias of a tool, shape (10,)."""
    moment = tool.mass * np.array(tool.com_sensor)
    return np.array((tool.mass, *moment, *tool.bias_sensor))


def contact_wrench(
    wrench_sensor: Vector,
    sensor_pose: tuple[Vector, Matrix],
    position_world: Vector,
    tool: ToolConfig,
    gravity_world: Vector,
) -> Vector:
    """
    Return the wrench the robot exerts on the environment; see `operational_wrench`.

    Parameters
    ----------
    wrench_sensor
        Reading in the sensor's axes at its origin, force first, shape (6,) [N, N m].
    sensor_pose
        Origin, shape (3,) [m], and axes of the sensor, shape (3, 3).
    position_world
        Operational point, at which the result is, world axes, shape (3,) [m].
    tool, gravity_world
        What hangs on the sensor, and g, shape (3,) [m/s^2].

    Raises
    ------
    ShapeError
        If `wrench_sensor` is not of shape (6,).

    """
    require_shape('wrench_sensor', wrench_sensor, (6,))
    control = np.zeros(1, dtype=CONTROL)
    wrench = np.empty(6)
    frame = control['frame']
    frame['position'] = position_world
    frame['sensor_position'], frame['sensor_rotation'] = sensor_pose
    control['tool'] = make_tool_record(tool, gravity_world)
    control['wrench'] = wrench_sensor
    operational_wrench(control[0], wrench)
    return wrench
