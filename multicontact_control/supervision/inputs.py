"""What is known at a tick, as it came in; named tuples, which are made faster than dataclasses."""

from __future__ import annotations

from typing import Any, NamedTuple


class JointInput(NamedTuple):
    """
    A joint state as it came in, not validated.

    Attributes
    ----------
    stamp
        When it was sampled [s].
    q, qd
        Joint positions [rad] and velocities [rad/s], in the order of `robot.joint_names`.
    effort
        Measured joint torques over the period that ends here [N m]: to start from, and for what
        touches the arm; None where the robot measures none.

    """

    stamp: float
    q: Any
    qd: Any
    effort: Any = None


class WrenchInput(NamedTuple):
    """A wrench [N, N m] as it came in, sampled at `stamp` [s]."""

    stamp: float
    wrench: Any


class VarianceInput(NamedTuple):
    """An R per contact [N^2] as it came in; `stamp` is that of the newest sample in it [s]."""

    stamp: float
    variance: Any


class TickInputs(NamedTuple):
    """
    What is known at a tick: the newest of each input, however old, None if there is none.

    Attributes
    ----------
    time
        Now, on the clock of the stamps [s].
    joints, wrench, variance
        The newest readings.
    sensor_fault
        What the wrist sensor's own monitor says is wrong, e.g. ``saturated``; then the wrench
        counts as not received.

    """

    time: float
    joints: JointInput | None = None
    wrench: WrenchInput | None = None
    variance: VarianceInput | None = None
    sensor_fault: str = ''
