"""Rotation vectors that change: the rotation, angular speed and acceleration that they make."""

from __future__ import annotations

import math

from multicontact_control.arrays import Vector
import numpy as np

# rad, below which the factors of a rotation vector come from their series.
SMALL_ANGLE = 0.03


def turn_by_rotation_vector(
    theta: list[float], rate: list[float], change: list[float]
) -> tuple[tuple[float, ...], ...]:
    """
    Return rotation, angular speed and acceleration of a rotation vector, as rows of (3, 5).

    With phi = |theta|, K the cross product with theta, A = (1 - cos phi) / phi^2 and
    B = (phi - sin phi) / phi^3: R = I + sin phi / phi K + A K^2, omega = J d theta with
    J = I + A K + B K^2, alpha = J dd theta + dJ d theta.
    """
    x, y, z = theta
    dx, dy, dz = rate
    ex, ey, ez = change
    square = x * x + y * y + z * z
    phi = math.sqrt(square)
    if phi < SMALL_ANGLE:
        S = 1.0 - square / 6.0 * (1.0 - square / 20.0)
        A = 0.5 - square / 24.0 * (1.0 - square / 30.0)
        B = 1.0 / 6.0 - square / 120.0 * (1.0 - square / 42.0)
        dA = -1.0 / 12.0 + square / 180.0  # A' / phi
        dB = -1.0 / 60.0 + square / 1260.0  # B' / phi
    else:
        sine = math.sin(phi)
        cosine = math.cos(phi)
        S = sine / phi
        A = (1.0 - cosine) / square
        B = (phi - sine) / (square * phi)
        dA = (phi * sine - 2.0 * (1.0 - cosine)) / (square * square)
        dB = (3.0 * sine - phi * (2.0 + cosine)) / (square * square * phi)
    # theta x d theta, and theta x that; the same of dd theta
    ux, uy, uz = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
    vx, vy, vz = y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
    px, py, pz = y * ez - z * ey, z * ex - x * ez, x * ey - y * ex
    qx, qy, qz = y * pz - z * py, z * px - x * pz, x * py - y * px
    along = x * dx + y * dy + z * dz
    a = dA * along
    b = dB * along
    alpha_x = ex + A * px + B * (qx + dy * uz - dz * uy) + a * ux + b * vx
    alpha_y = ey + A * py + B * (qy + dz * ux - dx * uz) + a * uy + b * vy
    alpha_z = ez + A * pz + B * (qz + dx * uy - dy * ux) + a * uz + b * vz
    return (
        (
            1.0 - A * (y * y + z * z),
            A * x * y - S * z,
            A * x * z + S * y,
            dx + A * ux + B * vx,
            alpha_x,
        ),
        (
            A * x * y + S * z,
            1.0 - A * (x * x + z * z),
            A * y * z - S * x,
            dy + A * uy + B * vy,
            alpha_y,
        ),
        (
            A * x * z - S * y,
            A * y * z + S * x,
            1.0 - A * (x * x + y * y),
            dz + A * uz + B * vz,
            alpha_z,
        ),
    )


def find_rotation_vector_rates(
    theta: Vector, omega: Vector, alpha: Vector
) -> tuple[Vector, Vector]:
    """Return d theta and dd theta of a turn with an angular speed and acceleration."""
    rest = [0.0, 0.0, 0.0]
    axes = np.eye(3).tolist()
    turning = [turn_by_rotation_vector(theta.tolist(), axis, rest) for axis in axes]
    jacobian = np.array(turning)[:, :, 3].T  # omega = jacobian d theta
    rate = np.linalg.solve(jacobian, omega)
    without_change = np.array(
        turn_by_rotation_vector(theta.tolist(), rate.tolist(), rest)
    )
    return rate, np.linalg.solve(jacobian, alpha - without_change[:, 4])
