"""The answer of a tick."""

from __future__ import annotations

from typing import Any, NamedTuple

from multicontact_control.arrays import Mask, Vector
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.records import Records


class ControlOutput(NamedTuple):
    """
    The answer to one sample; a named tuple is made in a third of the time of a dataclass.

    Estimates and desired forces are 0 where no force is controlled; `innovation`,
    `prior_variance` and `variance_used` also for the sample with which control starts.

    Attributes
    ----------
    torque
        Gamma, shape (n,) [N m].
    contacts, controls
        All that there is to say of every contact, and of the arm and what it is asked for:
        records of `CONTACT`, shape (r,), and one of `CONTROL`, which cannot be written to.

    """

    torque: Vector
    contacts: Records
    controls: Records

    @property
    def pose(self) -> Pose:
        """Return the pose of the operational frame."""
        frame: Any = self.controls['frame'][0]
        return Pose(frame['position'], frame['rotation'])

    @property
    def pose_des(self) -> Pose:
        """Return the desired pose of the operational frame."""
        task: Any = self.controls['task'][0]
        return Pose(task['position'], task['rotation'])

    @property
    def active(self) -> Mask:
        """Which contacts are force controlled, shape (r,)."""
        return self.contacts['answer']['active']

    @property
    def alpha_meas(self) -> Vector:
        """Measured contact forces, shape (r,) [N]."""
        return self.contacts['alpha_meas']

    @property
    def alpha_des(self) -> Vector:
        """Desired contact forces, shape (r,) [N]."""
        return self.contacts['answer']['alpha_des']

    @property
    def alpha_est(self) -> Vector:
        """Estimated contact forces, shape (r,) [N]."""
        return self.contacts['answer']['alpha_est']

    @property
    def alpha_rate_est(self) -> Vector:
        """Their estimated rates, shape (r,) [N/s]."""
        return self.contacts['answer']['alpha_rate_est']

    @property
    def innovation(self) -> Vector:
        """Return alpha_meas minus each observer's prediction, shape (r,) [N]."""
        return self.contacts['answer']['innovation']

    @property
    def prior_variance(self) -> Vector:
        """Return the variance C P_1 C^T of that prediction, shape (r,) [N^2]."""
        return self.contacts['answer']['prior_variance']

    @property
    def variance_used(self) -> Vector:
        """Return the R each observer worked with, shape (r,) [N^2]."""
        return self.contacts['answer']['variance_used']
