"""The terms of the arm's model at one sample, as compiled code takes them."""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector


class ModelTerms(NamedTuple):
    """
    What compiled code needs of the arm at its joint positions and velocities, in world axes.

    It is a tuple of arrays and no record, as the arrays are pinocchio's memory: nothing is copied.
    """

    mass_matrix: Matrix  # M with armature, its upper triangle, shape (n, n) [kg m^2]
    bias_torque: Vector  # C(q, v) v + g(q), shape (n,) [N m]
    gravity: Vector  # g(q), shape (n,) [N m]
    jacobian: Matrix  # J of the operational point, linear rows first, shape (6, n)
    jacobian_rate: Matrix  # dJ/dt, shape (6, n)

    # Origin, shape (3,) [m], and axes as columns, shape (3, 3), of the operational frame.
    position: Vector
    rotation: Matrix

    # The same of the sensor's frame.
    sensor_position: Vector
    sensor_rotation: Matrix


# Its fields in a plain tuple, which numba takes from Python in half the time.
TermTuple = tuple[
    Matrix, Vector, Vector, Matrix, Matrix, Vector, Matrix, Vector, Matrix
]
