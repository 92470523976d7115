"""What touches the arm anywhere: a generalised-momentum observer on its joint torques."""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import cross, multiply, multiply_transposed, solve_lower
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.control.wrench import operational_wrench
from multicontact_control.dynamics.operational_space import mobility_and_inertia
import numpy as np

RELEASE = 0.5  # share of its threshold that a residual must fall below to count no more


@compiled
def tool_velocity(control: Any, lever: Vector, velocity: Vector) -> None:
    """Fill in the lever to the tool's centre of mass, world axes, and its velocity."""
    frame, tool = control.frame, control.tool
    for i in range(3):
        lever[i] = frame.sensor_position[i] - frame.position[i]
        for j in range(3):
            lever[i] += frame.sensor_rotation[i, j] * tool.com_sensor[j]
    cross(frame.twist[3:], lever, velocity)
    for i in range(3):
        velocity[i] += frame.twist[i]


@compiled
def felt_wrench(control: Any, wrench: Vector) -> None:
    """
    Fill in the `operational_wrench` without the tool's inertia m a, which the arm's model has.

    The elapsed time of the momentum must be above 0.
    """
    momentum = control.momentum
    lever, velocity = np.empty(3), np.empty(3)
    inertia, moment = np.empty(3), np.empty(3)
    operational_wrench(control, wrench)
    tool_velocity(control, lever, velocity)
    for i in range(3):
        inertia[i] = control.tool.mass * (
            velocity[i] - momentum.com_velocity[i]) / momentum.elapsed
    cross(lever, inertia, moment)
    for i in range(3):
        wrench[i] -= inertia[i]
        wrench[3 + i] -= moment[i]


@compiled
def observe_momentum(control: Any, joints: Any, mass_matrix: Matrix, jacobian: Matrix) -> bool:
    """
    Update the residual of every joint.

    dr/dt = K (Gamma - M dv/dt - C v - g - F_c tanh(v / v_0) - F_v v - J^T f - r). This is
    r = K (p_0 - p + int (Gamma + C^T v - g - ... - r) dt) with the momentum p = M v and
    dM/dt = C + C^T, over one sample at a time: what one sample says is forgotten with time
    constant 1 / K. f is what the wrist sensor feels, so that r is J_i^T f_i of what the arm does
    to whatever touches it before the sensor, and with an input that is no sensor of all it does.

    Parameters
    ----------
    control
        Record of `CONTROL`; the momentum in it is changed.
    joints
        Records of `JOINT`, shape (n,), changed.
    mass_matrix, jacobian
        M (upper triangle), shape (n, n), and J, shape (6, n).

    Returns
    -------
    bool
        Whether something touches the arm: a residual is beyond its threshold, or, until it falls
        below half of it, was.

    """
    momentum, law, n = control.momentum, control.law, joints.shape[0]
    if momentum.elapsed > 0.0:
        wrench, taken, inertial = np.zeros(6), np.empty(n), np.empty(n)
        if not momentum.is_input:
            felt_wrench(control, wrench)
        finite = True
        for i in range(n):
            joint = joints[i]
            inertial[i] = 0.0
            for j in range(n):
                inertial[i] += mass_matrix[min(i, j), max(i, j)] * (
                    joints[j].velocity - joints[j].last_velocity)
            inertial[i] /= momentum.elapsed
            taken[i] = joint.effort - inertial[i] - 0.5 * (joint.bias_torque + joint.last_bias)
            taken[i] -= joint.coulomb * np.tanh(joint.velocity / law.friction_speed)
            taken[i] -= joint.viscous * joint.velocity
            for k in range(6):
                taken[i] -= jacobian[k, i] * wrench[k]
            finite = finite and np.isfinite(taken[i])
        share = 1.0 - np.exp(-momentum.bandwidth * momentum.elapsed)
        touched, factor = False, RELEASE if momentum.collided else 1.0
        for i in range(n):
            joint = joints[i]
            if finite:
                joint.residual += share * (taken[i] - joint.residual)
                joint.slack += share * (
                    momentum.dynamic_share * abs(inertial[i]) + joint.doubt - joint.slack)
            limit = joint.threshold + joint.slack
            touched = touched or abs(joint.residual) > factor * limit
        momentum.collided = touched
    tool_velocity(control, np.empty(3), momentum.com_velocity)
    return bool(momentum.collided)


@compiled
def wrench_of_residual(
    control: Any, joints: Any, mass_matrix: Matrix, jacobian: Matrix,
) -> None:
    """
    Fill in the wrench that explains the residual, as a sensor at the operational point reads it.

    f = J_bar^T r, J_bar = M^-1 J^T Lambda: of all that J^T f = r leaves open, what the null
    space of the arm takes does not count.

    Parameters
    ----------
    control
        Record of `CONTROL`; its wrench is filled in.
    joints, mass_matrix, jacobian
        As for `observe_momentum`; in a singular posture the wrench stays what it was.

    """
    n = joints.shape[0]
    L, Y = np.empty((n, n)), np.empty((n, 6))
    mobility, Lambda = np.empty((6, 6)), np.empty((6, 6))
    law, rotation = control.law, control.frame.sensor_rotation
    if mobility_and_inertia(mass_matrix, jacobian, law.max_condition, law.singular_mobility, L, Y,
                            mobility, Lambda) < 0.0:
        return
    reduced, acceleration, wrench = np.empty(n), np.empty(6), np.empty(6)
    for j in range(n):
        reduced[j] = joints[j].residual
    solve_lower(L, reduced)
    multiply_transposed(Y, reduced, acceleration)
    multiply(Lambda, acceleration, wrench)
    for i in range(3):
        control.wrench[i], control.wrench[3 + i] = 0.0, 0.0
        for j in range(3):
            control.wrench[i] += rotation[j, i] * wrench[j]
            control.wrench[3 + i] += rotation[j, i] * wrench[3 + j]
