"""The PD motion law of the operational point (P04 sec. 3.1)."""

from __future__ import annotations

from multicontact_control.arrays import Vector
from multicontact_control.config import MotionConfig
from multicontact_control.control.reference import Reference
from multicontact_control.dynamics.pose import Pose, rotation_error
import numpy as np


def motion_acceleration(
    config: MotionConfig, reference: Reference, pose: Pose, twist_world: Vector,
) -> Vector:
    """
    Return f_t*, the acceleration that leads the operational point to its reference.

    f_t* = a_des + k_v (theta_des - theta) + k_p (x_des - x), k_p = omega_n^2 and
    k_v = 2 zeta omega_n (P04 sec. 5.2: critically damped, 30 rad/s).

    Parameters
    ----------
    config
        Natural frequency and damping ratio.
    reference
        Desired pose, twist and acceleration.
    pose, twist_world
        Present pose, and twist of shape (6,) [m/s, rad/s].

    Returns
    -------
    Vector
        f_t*, world axes, shape (6,) [m/s^2, rad/s^2].

    """
    k_p = config.natural_frequency ** 2
    k_v = 2.0 * config.damping_ratio * config.natural_frequency
    error = np.empty(6)
    error[:3] = reference.pose_des.position_world - pose.position_world
    error[3:] = rotation_error(reference.pose_des.rotation_world, pose.rotation_world)
    acceleration: Vector = (
        reference.acceleration_des + k_v * (reference.twist_des - twist_world) + k_p * error)
    return acceleration
