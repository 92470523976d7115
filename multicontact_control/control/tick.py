"""What goes into a tick of the controller and what comes out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.dynamics.pose import Pose
from multicontact_control.force.kernels import (
    DESIRED,
    ESTIMATED,
    INNOVATION,
    MEASURED,
    PRIOR_VARIANCE,
    RATE,
    VARIANCE_USED,
)


@dataclass(frozen=True, slots=True)
class Measurement:
    """
    One sample of the sensors.

    Attributes
    ----------
    time
        Time since the first sample [s].
    q, qd
        Joint positions [rad] and velocities [rad/s], shape (n,).
    wrench_sensor
        Reading of the wrist sensor in its frame, force first, shape (6,) [N, N m].

    """

    time: float
    q: Vector
    qd: Vector
    wrench_sensor: Vector


class ControlOutput(NamedTuple):
    """
    The answer to one sample.

    A named tuple, which is made in a third of the time of a frozen dataclass.

    Attributes
    ----------
    torque
        Gamma, shape (n,) [N m].
    contacts
        All that there is to say of every contact: the rows are the properties of this class,
        shape (7, r).
    active
        Which contacts are force controlled, shape (r,).
    pose, pose_des
        Present and desired pose of the operational frame.

    """

    torque: Vector
    contacts: Matrix
    active: Mask
    pose: Pose
    pose_des: Pose

    @property
    def alpha_meas(self) -> Vector:
        """Measured contact forces, shape (r,) [N]."""
        return self.contacts[MEASURED]

    @property
    def alpha_des(self) -> Vector:
        """Desired contact forces, 0 where no force is controlled, shape (r,) [N]."""
        return self.contacts[DESIRED]

    @property
    def alpha_est(self) -> Vector:
        """Estimated contact forces, 0 where no force is controlled, shape (r,) [N]."""
        return self.contacts[ESTIMATED]

    @property
    def alpha_rate_est(self) -> Vector:
        """Their estimated rates, 0 where no force is controlled, shape (r,) [N/s]."""
        return self.contacts[RATE]

    @property
    def innovation(self) -> Vector:
        """
        Return what each observer found: alpha_meas minus its prediction, shape (r,) [N].

        This, `prior_variance` and `variance_used` are 0 where no force is controlled, and for
        the sample with which control starts.
        """
        return self.contacts[INNOVATION]

    @property
    def prior_variance(self) -> Vector:
        """Return the variance C P_1 C^T of that prediction, shape (r,) [N^2]."""
        return self.contacts[PRIOR_VARIANCE]

    @property
    def variance_used(self) -> Vector:
        """Return the R each observer worked with, shape (r,) [N^2]."""
        return self.contacts[VARIANCE_USED]
