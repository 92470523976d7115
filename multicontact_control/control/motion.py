"""The PD motion law of the operational point (P04 sec. 3.1)."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.dynamics.rotations import rotation_vector
import numpy as np


@compiled
def motion_law(law: Any, task: Any, frame: Any, f_t: Vector) -> None:
    """
    Fill in f_t*, the acceleration that leads the operational point to its reference.

    f_t* = a_des + k_v (theta_des - theta) + k_p (x_des - x), k_p = omega_n^2 and
    k_v = 2 zeta omega_n (P04 sec. 3.1; sec. 5.2: critically damped, 30 rad/s).

    Parameters
    ----------
    law, task, frame
        Records of `LAW`, `TASK` and `FRAME`.
    f_t
        Filled, world axes, shape (6,) [m/s^2, rad/s^2].

    """
    turn = np.empty(3)
    rotation_vector(task.rotation, frame.rotation, turn)
    for i in range(3):
        f_t[i] = law.k_p * (task.position[i] - frame.position[i])
        f_t[3 + i] = law.k_p * turn[i]
    for i in range(6):
        f_t[i] += task.acceleration[i] + law.k_v * (task.twist[i] - frame.twist[i])
