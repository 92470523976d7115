"""Bringing together joint state and wrench of the same instant."""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.arrays import Vector
from multicontact_control.nodes.messages import JointReading, WrenchReading


@dataclass(frozen=True, slots=True)
class PairedSample:
    """Joint state and wrist wrench with one stamp [ns]; the effort if it was read."""

    stamp: int
    q: Vector
    qd: Vector
    wrench_sensor: Vector
    effort: Vector | None = None


class SamplePairing:
    """
    Pairs readings by equal stamp and hands out the newest pair once.

    One message of a kind is kept: the two topics are filled together, so what waits is at most
    the half of the newest sample, and halves that never met are counted.

    Attributes
    ----------
    unpaired
        Readings that were overtaken before their other half came.

    """

    def __init__(self) -> None:
        self._joints: JointReading | None = None
        self._wrench: WrenchReading | None = None
        self.unpaired = 0

    def add_joints(self, reading: JointReading) -> PairedSample | None:
        """Take in a joint state; return the pair if it completes one."""
        self.unpaired += self._joints is not None
        self._joints = reading
        return self._pair()

    def add_wrench(self, reading: WrenchReading) -> PairedSample | None:
        """Take in a wrench; return the pair if it completes one."""
        self.unpaired += self._wrench is not None
        self._wrench = reading
        return self._pair()

    def take_half(self, after: int) -> JointReading | WrenchReading | None:
        """Return the newest half that waits, if it is newer than a stamp [ns]."""
        halves = [reading for reading in (self._joints, self._wrench) if reading is not None]
        newest = max(halves, key=lambda reading: reading.stamp, default=None)
        if newest is None or newest.stamp <= after:
            return None
        self.unpaired += 1
        if newest is self._joints:
            self._joints = None
        else:
            self._wrench = None
        return newest

    def _pair(self) -> PairedSample | None:
        joints, wrench = self._joints, self._wrench
        if joints is None or wrench is None or joints.stamp != wrench.stamp:
            return None
        self._joints = self._wrench = None
        return PairedSample(joints.stamp, joints.q, joints.qd, wrench.wrench_sensor, joints.effort)
