"""The arm as supervision sees it, what speaks against an answer, and the last gate, compiled."""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import copy_vector, multiply
from multicontact_control.arrays import Codes, Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.force.kernels import MEASURED
from multicontact_control.supervision.contact_kernels import LOST
import numpy as np

# Rows of an arm's joints: position, velocity, diagonal of M, C v + g.
Q, VELOCITY, INERTIA, BIAS_TORQUE = JOINT_ROWS = range(4)
# Pose and twist of the operational frame, axes of the wrist sensor.
POSTURE = np.dtype([
    ('position', np.float64, 3), ('rotation', np.float64, (3, 3)), ('twist', np.float64, 6),
    ('sensor_rotation', np.float64, (3, 3))])
# What `see_arm` returns, added up.
NO_NUMBERS, OPERATIONAL_SPEED, JOINT_SPEED = 1, 2, 4

# Fields of `WatchdogConfig`; pull that a lost contact may read as well, the tool's inertia [N];
# weight of the tool and what the sensor reads under no load [N]; corners of the box, and what is
# allowed.
PLAUSIBILITY = np.dtype([
    ('pull_threshold', np.float64), ('inertia', np.float64), ('friction_bound', np.float64),
    ('friction_offset', np.float64), ('weight', np.float64, 3), ('bias', np.float64, 3),
    ('box', np.float64, (2, 3))])
# What `check_plausibility` returns, added up.
NOT_FINITE, PULL, SIDEWAYS, OUTSIDE = 1, 2, 4, 8

# Rows of a gate's limits: torque, its step per period, stops, speed.
TORQUE, STEP, LOWER, UPPER, SPEED = LIMIT_ROWS = range(5)
# What `gate_torque` returns, added up.
GATE_NUMBERS, GATE_JOINT, GATE_TORQUE, GATE_RATE = 1, 2, 4, 8
SPEED_GAIN = 50.0  # 1/s, how fast a joint is brought back to the speed it may have
BRAKING_SHARE = 0.7  # of the speed a joint may have, from where on that is looked after


@compiled
def all_numbers(values: Vector) -> bool:
    """Return whether all values are finite."""
    for i in range(values.shape[0]):
        if not np.isfinite(values[i]):
            return False
    return True


@compiled
def see_arm(
    q: Vector, velocity: Vector, mass_matrix: Matrix, bias_torque: Vector, jacobian: Matrix,
    position: Vector, rotation: Matrix, sensor_rotation: Matrix, speed_limit: Vector,
    operational_speed: float, operational_turn: float, joints: Matrix, posture: Any,
) -> int:
    """
    Note what supervision needs to know of the arm, and whether it is too fast.

    Parameters
    ----------
    q, velocity, mass_matrix, bias_torque, jacobian, position, rotation, sensor_rotation
        See `LiveTerms`.
    speed_limit, operational_speed, operational_turn
        Speeds beyond which it is too fast, shape (n,) [rad/s]; [m/s]; [rad/s].
    joints, posture
        Filled: rows as the constants of this module name them, shape (4, n), and one record of
        `POSTURE`.

    Returns
    -------
    int
        NO_NUMBERS if the model gives none here; nothing is changed then. Otherwise the sum of
        what is too fast.

    """
    if not all_numbers(bias_torque):
        return NO_NUMBERS
    seen = posture[0]
    multiply(jacobian, velocity, seen.twist)
    excess = 0
    for j in range(q.shape[0]):
        joints[Q, j] = q[j]
        joints[VELOCITY, j] = velocity[j]
        joints[INERTIA, j] = mass_matrix[j, j]
        joints[BIAS_TORQUE, j] = bias_torque[j]
        if abs(velocity[j]) > speed_limit[j]:
            excess = JOINT_SPEED
    speed, turn = 0.0, 0.0
    for k in range(3):
        seen.position[k] = position[k]
        speed += seen.twist[k] ** 2
        turn += seen.twist[3 + k] ** 2
        for i in range(3):
            seen.rotation[k, i] = rotation[k, i]
            seen.sensor_rotation[k, i] = sensor_rotation[k, i]
    if speed > operational_speed ** 2 or turn > operational_turn ** 2:
        excess += OPERATIONAL_SPEED
    return excess


@compiled
def check_plausibility(
    torque: Vector, contacts: Matrix, states: Codes, wrench: Vector, posture: Any,
    normals: Matrix, suspicion: Any,
) -> int:
    """
    Find out what speaks against an answer of the control law.

    Parameters
    ----------
    torque, contacts
        The answer: Gamma and its report, shapes (n,) and (7, r).
    states
        Of the contacts, shape (r,). A tool that is braked after its surface has gone reads its
        own inertia, as a pull: for a lost contact there is an allowance.
    wrench
        Reading of the wrist sensor, shape (6,) [N, N m].
    posture, suspicion
        One record each of `POSTURE` and `PLAUSIBILITY`.
    normals
        Contact normals, world axes, shape (r, 3).

    Returns
    -------
    int
        Sum of NOT_FINITE, PULL (a surface that pulls), SIDEWAYS (more than friction can explain)
        and OUTSIDE (the operational point is out of its box).

    """
    doubts = 0
    if not all_numbers(torque):
        doubts = NOT_FINITE
    for row in range(contacts.shape[0]):
        if not all_numbers(contacts[row]):
            doubts = NOT_FINITE
    seen, bounds = posture[0], suspicion[0]
    alpha = contacts[MEASURED]
    pressed = 0.0
    for i in range(alpha.shape[0]):
        pressed += abs(alpha[i])
        allowed = bounds.pull_threshold
        if states[i] == LOST:
            allowed += bounds.inertia
        if alpha[i] < -allowed:
            doubts |= PULL
    sideways = 0.0
    for k in range(3):
        force = bounds.weight[k]
        for j in range(3):
            force += seen.sensor_rotation[k, j] * (wrench[j] - bounds.bias[j])
        for i in range(alpha.shape[0]):
            force -= alpha[i] * normals[i, k]
        sideways += force * force
        if seen.position[k] < bounds.box[0, k] or seen.position[k] > bounds.box[1, k]:
            doubts |= OUTSIDE
    bound = bounds.friction_offset + bounds.friction_bound * pressed
    if sideways > bound * bound:
        doubts |= SIDEWAYS
    return doubts


@compiled
def brake_joints(joints: Matrix, limits: Matrix, braking: float, torque: Vector) -> bool:
    """
    Bound a torque such that no joint passes a stop or its speed limit.

    A joint may have the speed v_max = sqrt(2 a d) at a distance d from its stop.

    Parameters
    ----------
    joints, limits
        See the constants of this module, shapes (4, n) and (5, n).
    braking
        a [rad/s^2].
    torque
        Changed if need be, shape (n,) [N m].

    Returns
    -------
    bool
        Whether it was.

    """
    n = torque.shape[0]
    fastest, slowest = np.empty(n), np.empty(n)
    slow = True
    for j in range(n):
        q, speed = joints[Q, j], joints[VELOCITY, j]
        ahead = np.sqrt(2.0 * braking * np.maximum(limits[UPPER, j] - q, 0.0))
        behind = np.sqrt(2.0 * braking * np.maximum(q - limits[LOWER, j], 0.0))
        fastest[j] = np.minimum(ahead, limits[SPEED, j])
        slowest[j] = -np.minimum(behind, limits[SPEED, j])
        slow = slow and speed < BRAKING_SHARE * fastest[j] and speed > BRAKING_SHARE * slowest[j]
    if slow:
        return False
    braked = False
    for j in range(n):
        speed, gain = joints[VELOCITY, j], SPEED_GAIN * joints[INERTIA, j]
        highest = joints[BIAS_TORQUE, j] + gain * (fastest[j] - speed)
        lowest = joints[BIAS_TORQUE, j] + gain * (slowest[j] - speed)
        bounded = np.minimum(np.maximum(torque[j], lowest), highest)
        if bounded != torque[j]:  # also if it is not a number
            torque[j] = bounded if np.isfinite(bounded) else 0.0
            braked = True
    return braked


@compiled
def gate_torque(
    torque: Vector, fallback: Vector, joints: Matrix, known: bool, limits: Matrix,
    braking: float, last: Vector, started: bool, gated: Vector,
) -> int:
    """
    Let a torque through as far as the limits allow; see `TorqueGate.apply`.

    Parameters
    ----------
    torque, fallback
        What is wanted, and what to do if that is not finite, shape (n,) [N m].
    joints, known
        The arm as far as it is known, see `brake_joints`, and whether it is.
    limits, braking
        See `brake_joints`.
    last, started
        The last command, overwritten, and whether there was one.
    gated
        Filled: finite and within limits, whatever came in, shape (n,) [N m].

    Returns
    -------
    int
        Sum of the limits that were enforced.

    """
    enforced = 0
    n = gated.shape[0]
    if torque.shape[0] == n and all_numbers(torque):
        copy_vector(torque, gated)
    else:
        enforced = GATE_NUMBERS
        for j in range(n):
            gated[j] = fallback[j] if np.isfinite(fallback[j]) else 0.0
    if known and brake_joints(joints, limits, braking, gated):
        enforced |= GATE_JOINT
    for j in range(n):
        clipped = min(max(gated[j], -limits[TORQUE, j]), limits[TORQUE, j])
        if clipped != gated[j]:
            enforced |= GATE_TORQUE
        if started:
            slowed = min(max(clipped, last[j] - limits[STEP, j]), last[j] + limits[STEP, j])
            if slowed != clipped:
                enforced |= GATE_RATE
            clipped = slowed
        gated[j] = last[j] = clipped
    return enforced
