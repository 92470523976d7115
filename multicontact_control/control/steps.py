"""Ways that are commanded in one step, walked with bounded speeds and accelerations."""

from __future__ import annotations

import math

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import LimitsConfig
from multicontact_control.dynamics.rotations import Pose
import numpy as np
from scipy.spatial.transform import Rotation

SETTLING = 5.0  # times the rate at which a way shrinks: that of its speed, without overshoot
SHRINKING = 10.0  # 1/s, at which the rest of a step does
ARRIVED = 1e-5  # m, rad and m/s, rad/s
LONGEST_STEP = 0.01  # s, in which a way is worked out
LONGEST_PAUSE = 0.1  # s between two ticks that are walked
# Of the largest speeds: a pose that is so far from the last one is a step (a stream of 100 Hz
# is none), and so is a twist that is so much faster.
STEP_TIME, STEP_SHARE = 0.01, 0.15
WAY_SHARE = 0.4  # of the largest speeds and accelerations, with which a step is walked


def approach(
    way: Vector, velocity: Vector, rate: float, speed: float, acceleration: float,
) -> Vector:
    """
    Return how to accelerate on a way that is left so as to come to rest at its end, shape (3,).

    The end of the way shrinks at a rate [1/s]. The speed never jumps, and is so low that half of
    the largest `acceleration` can brake it.
    """
    fastest = min(speed, math.sqrt(acceleration * float(np.linalg.norm(way))))
    wanted = bounded(rate * way, fastest)
    return bounded(SETTLING * rate * (wanted - velocity), acceleration)


def bounded(vector: Vector, largest: float) -> Vector:
    """Return a vector, shortened to a largest length."""
    size = float(np.sqrt(vector @ vector))
    return vector if size <= largest else vector * (largest / size)


class Remainder:
    """
    What is left of a way that was commanded in one step: the arm walks it within its limits.

    A step d of the pose would accelerate the arm at k_p d, and a tool would read its own inertia
    as a touch. Steps as small as those of a stream of set points are none.

    Attributes
    ----------
    way, rate, acceleration
        Of the pose that is followed from the one commanded, position and rotation vector, world
        axes, shape (6,) [m, rad], and its derivatives.

    """

    def __init__(self, limits: LimitsConfig) -> None:
        speeds = np.array([limits.operational_speed, limits.operational_turn])
        self._steps, self._changes = STEP_TIME * speeds, STEP_SHARE * speeds
        self._speeds = WAY_SHARE * speeds
        self._accelerations = WAY_SHARE * np.array(
            [limits.operational_acceleration, limits.operational_turn_acceleration])
        self.forget()

    def forget(self) -> None:
        """Let nothing be left."""
        self.way, self.rate, self.acceleration = np.zeros((3, 6))

    @property
    def left(self) -> bool:
        """Whether there is any way left."""
        return bool(self.way.any() or self.rate.any())

    def of(self, pose: Pose) -> Pose:
        """Return the pose that is followed where this one is commanded."""
        turn = Rotation.from_rotvec(self.way[3:]).as_matrix()
        return Pose(pose.position_world + self.way[:3], turn @ pose.rotation_world)

    def take(self, before: Pose, after: Pose, twist_before: Vector, twist: Vector) -> None:
        """Go on from where the arm is led if the next pose, or its twist, is a step away."""
        turn = Rotation.from_matrix(after.rotation_world @ before.rotation_world.T).as_rotvec()
        followed = self.of(before) if self.left else before
        for i, (half, step) in enumerate((
                (slice(0, 3), after.position_world - before.position_world),
                (slice(3, 6), turn))):
            change = twist[half] - twist_before[half]
            faster = np.linalg.norm(twist[half]) > np.linalg.norm(twist_before[half])
            jumps = np.linalg.norm(step) > self._steps[i]
            if not (jumps or faster and np.linalg.norm(change) > self._changes[i]):
                continue
            self.rate[half] -= change
            if i == 0:
                self.way[half] = followed.position_world - after.position_world
            else:
                self.way[half] = Rotation.from_matrix(
                    followed.rotation_world @ after.rotation_world.T).as_rotvec()

    def leave(self, N: Matrix) -> Vector:
        """Give up the way along normals, the columns of N, shape (3, k); return it, (3,) [m]."""
        along = N @ np.linalg.pinv(N)
        given_up: Vector = along @ self.way[:3]
        self.way[:3] -= given_up
        self.rate[:3] -= along @ self.rate[:3]
        return given_up

    def advance(self, period: float) -> None:
        """Walk on for a time [s]."""
        steps = max(1, math.ceil(min(period, LONGEST_PAUSE) / LONGEST_STEP))
        h = min(period, LONGEST_PAUSE) / steps
        for i, half in enumerate((slice(0, 3), slice(3, 6))):
            way, rate = self.way[half], self.rate[half]
            for _ in range(steps):
                change = approach(
                    -way, rate, SHRINKING, self._speeds[i], self._accelerations[i])
                way += h * rate + 0.5 * h * h * change
                rate += h * change
            if np.abs(way).max() < ARRIVED and np.abs(rate).max() < ARRIVED:
                way[:], rate[:], change = 0.0, 0.0, np.zeros(3)
            self.acceleration[half] = change
