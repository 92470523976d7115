"""A reference that a user sets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ContactStateConfig
from multicontact_control.control.reference.source import Reference
from multicontact_control.dynamics.pose import Pose
from multicontact_control.errors import ConfigError
import numpy as np


class CommandedReference:
    """
    A reference that a user sets, over topics or from a program.

    Until a motion is commanded the pose at the start is held. A contact with a commanded force
    above 0 is force controlled.

    Parameters
    ----------
    names
        Forces and couples in the order of every contact vector.
    leader_of
        For each of them which one is the normal force of its contact; itself if not given.

    """

    def __init__(self, names: tuple[str, ...], leader_of: Sequence[int] | None = None) -> None:
        self._names = names
        self._leader_of = np.array(
            range(len(names)) if leader_of is None else leader_of, dtype=int)
        self._alpha_des = np.zeros(len(names))
        self._shares = np.full(len(names), math.nan)
        self._pose: Pose | None = None
        self._twist = np.zeros(6)
        self._acceleration = np.zeros(6)
        self._lasting = self._until = math.inf  # s, of these two; until which time of the task
        self._made: Reference | None = None  # of all this, until something of it changes

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """Begin from a pose at rest; see `ReferenceSource.start`."""
        self._pose = pose
        self._twist = np.zeros(6)
        self._acceleration = np.zeros(6)
        self._lasting = self._until = math.inf
        self._alpha_des = np.zeros(len(self._names))
        self._shares = np.full(len(self._names), math.nan)
        self._made = None

    def set_forces(
        self, forces: Mapping[str, float], shares: Mapping[str, float] | None = None,
    ) -> bool:
        """
        Command contact forces; contacts that are not named keep theirs.

        Parameters
        ----------
        forces
            Desired force per contact [N]; 0 gives the contact back to motion control. Couples
            may have either sign, and act while their contact does.
        shares
            Couples relative to the force of their contact, which they go on following; that is
            where the centre of pressure is, in half lengths.

        Returns
        -------
        bool
            Whether that is another command than before.

        Raises
        ------
        ConfigError
            If a name is unknown or a force is negative or not finite; nothing is changed then.

        """
        desired, followed = self._alpha_des.copy(), self._shares.copy()
        for name, force in forces.items():
            index = self._index(name)
            couple = self._leader_of[index] != index
            if not (math.isfinite(force) and (couple or force >= 0.0)):
                raise ConfigError(f'contact_forces/command.{name}', 'a finite couple' if couple
                                  else 'a force >= 0 N', force)
            desired[index], followed[index] = force, math.nan
        for name, share in (shares or {}).items():
            index = self._index(name)
            if self._leader_of[index] == index or not math.isfinite(share):
                raise ConfigError(f'contact_forces/command.{name}',
                                  'a finite share of a couple', share)
            followed[index] = share
        known = ~np.isnan(followed)
        desired[known] = followed[known] * desired[self._leader_of][known]
        self._shares = followed
        changed = bool((desired != self._alpha_des).any())
        self._alpha_des, self._made = desired, None
        return changed

    def _index(self, name: str) -> int:
        if name not in self._names:
            raise ConfigError('contact_forces/command',
                              f'contacts among {", ".join(self._names)}', f"'{name}'")
        return self._names.index(name)

    @property
    def forces(self) -> dict[str, float]:
        """Return what is commanded, forces and couples by name [N]."""
        return dict(zip(self._names, self._alpha_des.tolist()))

    @property
    def shares(self) -> dict[str, float]:
        """Return which couples follow the force of their contact, relative to it, by name."""
        return {name: share for name, share in zip(self._names, self._shares.tolist())
                if not math.isnan(share)}

    def set_motion(
        self, position_world: Vector, quaternion_xyzw: Vector, twist_world: Vector,
        acceleration_world: Vector, taken_normals: Matrix | None = None,
        lasting: float = math.inf,
    ) -> None:
        """
        Command the motion of the operational point.

        Along the normal of a contact that is sought or held it is the contact that decides where
        the tip is: what is commanded along it has no effect, now or when it is given back.

        Parameters
        ----------
        position_world, quaternion_xyzw
            Desired pose, shapes (3,) [m] and (4,).
        twist_world, acceleration_world
            Shapes (6,), linear first.
        taken_normals
            Normals of such contacts, shape (k, 3); none if not given.
        lasting
            How long twist and acceleration count [s]: where no other command follows, only the
            pose does.

        Raises
        ------
        ConfigError
            If a number is not finite or the quaternion has no length; nothing is changed then.

        """
        numbers = np.concatenate(
            [position_world, quaternion_xyzw, twist_world, acceleration_world])
        if not np.isfinite(numbers).all():
            raise ConfigError('motion/command', 'finite numbers', numbers.tolist())
        if np.linalg.norm(quaternion_xyzw) < 1e-6:
            raise ConfigError('motion/command', 'a quaternion of unit length',
                              quaternion_xyzw.tolist())
        position, twist, acceleration = (
            np.array(x, dtype=float) for x in (position_world, twist_world, acceleration_world))
        if taken_normals is not None and len(taken_normals) and self._pose is not None:
            N = taken_normals.T
            across = np.eye(3) - N @ np.linalg.pinv(N)
            start = self._pose.position_world
            position = start + across @ (position - start)
            twist[:3], acceleration[:3] = across @ twist[:3], across @ acceleration[:3]
        self._pose = Pose.from_quaternion(position, quaternion_xyzw)
        self._twist, self._acceleration = twist, acceleration
        self._lasting, self._until = lasting, math.nan
        self._made = None

    @property
    def pose(self) -> Pose | None:
        """Return the commanded pose, None before the start."""
        return self._pose

    def contact_state(self, default: ContactStateConfig) -> ContactStateConfig:
        """Return the default: a command says nothing of how contacts are made."""
        return default

    def task(self, time: float) -> Reference:
        """Return what is commanded; see `TaskSource.task`."""
        return self.update(time, self._alpha_des)

    def update(self, time: float, alpha_meas: Vector) -> Reference:
        """Return the reference of one tick; see `ReferenceSource.update`."""
        if self._pose is None:
            raise ConfigError('reference', 'start() before update()', 'update()')
        if math.isnan(self._until):
            self._until = time + self._lasting
        if time > self._until:
            self._twist, self._acceleration = np.zeros(6), np.zeros(6)
            self._until, self._made = math.inf, None
        if self._made is None:
            self._made = Reference(
                pose_des=self._pose, twist_des=self._twist, acceleration_des=self._acceleration,
                active=(self._alpha_des > 0.0)[self._leader_of], alpha_des=self._alpha_des)
        return self._made
