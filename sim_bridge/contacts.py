"""What acts on the arm: surfaces it touches, hands that push it, and its drives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Protocol

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.errors import ConfigError
from multicontact_control.records import (
    Record,
    record_dtype,
    Records,
)
import numpy as np
import pinocchio as pin
from sim_bridge.arm import Arm, TOOL_LINK
from sim_bridge.config import PlantConfig
from sim_bridge.drives import advance_drives, Drive
from sim_bridge.kinematics import (
    add_joint_torque,
    forward_kinematics,
    Link,
    locate_point,
    point_velocity,
)
from sim_bridge.surface import build_surfaces, move_surface, press_surface, Surface


class Hand(Record, Protocol):
    """What pushes the last link or the tool at one point; world axes."""

    force: Annotated[Vector, 3]  # [N]
    local: Annotated[Vector, 3]  # the point in the last joint's frame [m]
    point: Annotated[Vector, 3]  # where it is, of use while it pushes [m]


HAND = record_dtype(Hand)


class Pushes:
    """Forces on one point of the arm over some control periods, summed in a record of `HAND`."""

    def __init__(self, hand: Hand) -> None:
        self.force_world: Vector = hand['force']
        self._pushes: list[tuple[int, int, Vector]] = []

    def add(self, first: int, end: int, force_world: Sequence[float] | Vector) -> None:
        """Push from a control period on until before another, with a force, shape (3,) [N]."""
        self._pushes.append((first, end, np.array(force_world, dtype=float)))

    def start_period(self, tick: int) -> None:
        """Take the forces of the control period that begins with a tick."""
        if self._pushes:
            self.force_world[:] = sum(
                (force for first, end, force in self._pushes if first <= tick < end),
                np.zeros(3),
            )
            self._pushes = [push for push in self._pushes if push[1] > tick]


class Contacts:
    """
    The bar tips, and other points of the arm, and the surfaces they may touch.

    Each surface has its own generator of roughness.

    Attributes
    ----------
    surfaces, profiles
        See `build_surfaces`.
    pressed
        Normal forces of robot on surface, those on obstacles last, shape (no,) [N].
    points_world
        Where the tips are, shape (no, 3) [m].
    places_world
        A point of each mean surface now, shape (no, 3) [m].

    """

    def __init__(
        self,
        config: PlantConfig,
        arm: Arm,
        model: pin.Model,
        generators: list[np.random.Generator],
    ) -> None:
        met = [config.surfaces[name] for name in config.met]
        self.surfaces: Records[Surface]
        self.surfaces, self.profiles = build_surfaces(met, generators)
        for record, surface in zip(self.surfaces, met):
            frame = model.frames[model.getFrameId(surface.tip_link)]
            record['joint'] = record['body'] = frame.parentJoint - 1
            record['tip'] = frame.placement.translation
            # The wrist sensor feels what touches the tool, not what touches a link.
            if surface.tip_link in (TOOL_LINK, *arm.tips):
                record['body'] = model.nv
        self._native = config.contact == 'native'
        if self._native:
            for name in ('stiffness', 'damping', 'friction'):
                self.surfaces[name] = 0.0  # only where the tips are is asked of them
        self.pressed: Vector = self.surfaces['alpha']
        self.points_world: Matrix = self.surfaces['point']
        self.places_world: Matrix = self.surfaces['place']
        self._columns = np.array(
            [
                [shares.get(name, 0.0) for name in config.met]
                for shares in config.columns.values()
            ]
        ).reshape(len(config.columns), len(config.met))
        self._touched = len(config.touched)

    @property
    def alpha(self) -> Vector:
        """Return the true forces and couples of the contacts, shape (r,) [N]."""
        forces: Vector = self._columns @ self.pressed
        return forces

    @property
    def obstacles(self) -> Vector:
        """Return the normal forces on what is in the way and no contact, shape (k,) [N]."""
        return self.pressed[self._touched :].copy()

    def _changing(self, surface: int) -> Surface:
        """Return a surface to change; ConfigError if it is the engine's own."""
        if self._native:
            raise ConfigError(
                'contact', 'compliant, for surfaces that change', 'native'
            )
        return self.surfaces[surface]

    def shift_surface(self, contact: int, distance: float) -> None:
        """Move a surface along its normal by `distance` [m], away from the robot if positive."""
        surface = self._changing(contact)
        surface['place'] += distance * surface['normal']

    def put_before_tip(self, surface: int, distance: float) -> None:
        """Put a surface, or an obstacle after them, so far [m] before the tip as it is now."""
        record = self._changing(surface)
        record['place'] = record['point'] + distance * record['normal']

    def scale_stiffness(self, contact: int, factor: float) -> None:
        """Make a surface stiffer by a factor, moved such that it presses as before."""
        surface = self._changing(contact)
        depth = surface['alpha'] / surface['stiffness']
        surface['stiffness'] *= factor
        self.shift_surface(contact, depth * (1.0 - 1.0 / factor))

    def scale_friction(self, contact: int, factor: float) -> None:
        """Multiply a surface's coefficient of friction."""
        self._changing(contact)['friction'] *= factor

    def set_friction(self, contact: int, friction: float) -> None:
        """Give a surface another coefficient of friction."""
        self._changing(contact)['friction'] = friction


@compiled
def write_push(
    push: Vector, force: Vector, sign: float, point: Vector, body: int
) -> None:
    """Fill a row of pushes: sign * force [N], its point [m], and the body it acts on."""
    for k in range(3):
        push[k], push[3 + k] = sign * force[k], point[k]
    push[6] = body


@compiled
def act_on_arm(
    motion: Matrix,
    torques: Matrix,
    limit: Vector,
    links: Records[Link],
    drives: Records[Drive],
    surfaces: Records[Surface],
    profiles: Matrix,
    hands: Records[Hand],
    pushes: Matrix,
    step: float,
) -> int:
    """
    Work out all that acts on the arm in one integration step [s], but for the engine's own work.

    Records of links, drives and surfaces are changed.

    Parameters
    ----------
    motion
        Joint angles and speeds, link side, at the start of the step, shape (2, n) [rad, rad/s].
    torques
        Of the joints, shape (4, n) [N m]: of the motors, clipped here to the limit; filled in are
        what surfaces and hands do, the sum of both, and what the drives do to the links.
    limit
        Of the motors, shape (n,) [N m].
    links, drives, surfaces
        Records of `LINK`, `DRIVE` (none for motors that act on the links as they are) and
        `SURFACE`.
    profiles
        Of the roughness of each surface.
    hands
        Records of `HAND`, shape (2,): first the one at the wrist, then the one at the tool.
    pushes
        Filled with the forces on the arm, as `EngineArm.push` takes them, shape (m, 7) [N, m].
    step
        Of the integration [s].

    Returns
    -------
    int
        How many forces there are, or -1 for motor torques that are not finite.

    """
    q, qd = motion[0], motion[1]
    motor, load, both, link_side = torques[0], torques[1], torques[2], torques[3]
    last = q.shape[0] - 1
    for joint in range(last + 1):
        if not np.isfinite(motor[joint]):
            return -1
        motor[joint] = min(max(motor[joint], -limit[joint]), limit[joint])
        load[joint] = 0.0
    forward_kinematics(q, links)
    velocity = np.empty(3)
    count = 0
    for i in range(hands.shape[0]):
        hand = hands[i]
        if hand.force[0] != 0.0 or hand.force[1] != 0.0 or hand.force[2] != 0.0:
            locate_point(hand.local, links[last], hand.point)
            write_push(pushes[count], hand.force, 1.0, hand.point, last + i)
            count += 1
    add_joint_torque(hands[0].point, hands[0].force, 1.0, links, last, load)
    for i in range(surfaces.shape[0]):
        surface = surfaces[i]
        if surface.velocity != 0.0:
            move_surface(surface, step)
        locate_point(surface.tip, links[surface.joint], surface.point)
        point_velocity(surface.point, qd, links, surface.joint, velocity)
        press_surface(surface, velocity, profiles[i])
        if surface.alpha > 0.0:
            add_joint_torque(
                surface.point, surface.force, -1.0, links, surface.joint, load
            )
            write_push(pushes[count], surface.force, -1.0, surface.point, surface.body)
            count += 1
    add_joint_torque(hands[1].point, hands[1].force, 1.0, links, last, load)
    for joint in range(last + 1):
        both[joint] = motor[joint] + load[joint]
        link_side[joint] = motor[joint]
    advance_drives(motor, q, qd, drives, step, link_side)
    return count
