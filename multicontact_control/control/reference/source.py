"""What the controller is asked to do at each tick, and who may ask."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from multicontact_control.arrays import Mask, Vector
from multicontact_control.config import ContactStateConfig
from multicontact_control.dynamics.pose import Pose


class Reference(NamedTuple):
    """
    The task of one tick; a named tuple, which is made faster than a dataclass.

    It never changes once it is handed out; the same object again says that nothing has changed.

    Attributes
    ----------
    pose_des
        Desired pose of the operational frame.
    twist_des, acceleration_des
        World axes, linear first, shape (6,) [m/s, rad/s; m/s^2, rad/s^2].
    active
        Which contacts are force controlled, shape (r,).
    alpha_des
        Desired contact forces, shape (r,) [N]; 0 where not active.

    """

    pose_des: Pose
    twist_des: Vector
    acceleration_des: Vector
    active: Mask
    alpha_des: Vector


class ReferenceSource(Protocol):
    """Where references come from: a scenario, or a user's commands."""

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """
        Begin from a pose at rest.

        Parameters
        ----------
        pose
            Pose of the operational frame now.
        normals_world
            Contact normals INTO the surfaces, shape (r, 3).

        """
        ...

    def update(self, time: float, alpha_meas: Vector) -> Reference:
        """
        Return the reference of one tick.

        Parameters
        ----------
        time
            Time since the start [s].
        alpha_meas
            Measured contact forces, shape (r,) [N].

        """
        ...


class TaskSource(Protocol):
    """What is to be done, without regard to whether the contacts are there."""

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """Begin from a pose at rest; see `ReferenceSource.start`."""
        ...

    def task(self, time: float) -> Reference:
        """Return the motion, and the contacts that are wanted with the forces they are to have."""
        ...

    def contact_state(self, default: ContactStateConfig) -> ContactStateConfig:
        """Return how contacts are to be made for this task."""
        ...
