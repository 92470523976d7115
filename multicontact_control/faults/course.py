"""A motion there and back: what a situation asks of an arm, setpoint by setpoint."""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.control.tasks import MotionReading
from multicontact_control.dynamics.rotations import Pose
import numpy as np
from scipy.spatial.transform import Rotation

RAMP_TIME = 0.3  # s, of the speed of a motion
REST_TIME = 1.0  # s, at each end of a motion


class Course(NamedTuple):
    """A motion from a pose: along a direction and about an axis, world axes, unit vectors or 0."""

    start: Pose
    direction: Vector
    axis: Vector
    distance: float  # [m or rad]
    speed: float  # [m/s or rad/s]
    legs: int  # 0 for no motion

    @property
    def leg_time(self) -> float:
        """How long it takes in one direction, and to rest there [s]."""
        return self.distance / self.speed + RAMP_TIME + REST_TIME

    @property
    def duration(self) -> float:
        """How long it takes in all [s]."""
        return self.legs * self.leg_time

    @property
    def period(self) -> float:
        """Return the period of a sinusoid of this amplitude and largest speed [s]."""
        return 2.0 * np.pi * self.distance / self.speed

    def way(self, time: float) -> Vector:
        """Return way [m or rad], rate and its rate at a time since its beginning [s], (3,)."""
        if not 0.0 <= time < self.duration:
            return np.array([self.distance * (self.legs % 2) * (time > 0.0), 0.0, 0.0])
        leg, elapsed = divmod(time, self.leg_time)
        way = _run(elapsed, self.distance, self.speed)
        return np.array([self.distance, 0.0, 0.0]) - way if leg % 2 else way

    def readings(self, ways: Matrix) -> list[MotionReading]:
        """Return the setpoints of some ways [m or rad] with their rates, shape (k, 3)."""
        turns = Rotation.from_rotvec(ways[:, :1] * self.axis)
        quaternions = (turns * Rotation.from_quat(self.start.quaternion_xyzw)).as_quat()
        both = np.concatenate([self.direction, self.axis])
        return [
            MotionReading(
                self.start.position_world + way * self.direction,
                quaternion,
                rate * both,
                acceleration * both,
            )
            for (way, rate, acceleration), quaternion in zip(ways.tolist(), quaternions)
        ]


def _run(elapsed: float, distance: float, speed: float) -> Vector:
    """Return way, rate and its rate of a motion of constant speed with smooth ramps, (3,)."""
    way = np.zeros(3)
    for begin, sign in ((0.0, 1.0), (distance / speed, -1.0)):
        share = min(max((elapsed - begin) / RAMP_TIME, 0.0), 1.0)
        after = max(elapsed - begin - RAMP_TIME, 0.0)
        way += (
            sign
            * speed
            * np.array(
                [
                    RAMP_TIME * (share**3 - 0.5 * share**4) + after,
                    share**2 * (3.0 - 2.0 * share),
                    6.0 * share * (1.0 - share) / RAMP_TIME,
                ]
            )
        )
    return way
