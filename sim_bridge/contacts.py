"""What acts on the arm: surfaces it touches, hands that push it, and its drives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, NamedTuple, Protocol

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

    # The point in the world, kept up to date while it pushes [m].
    point: Annotated[Vector, 3]


HAND = record_dtype(Hand)


class ScheduledPush(NamedTuple):
    """A force on the arm from one tick until before another."""

    first_tick: int
    end_tick: int
    force_world: Vector  # shape (3,) [N]


class PushSchedule:
    """Forces on one point of the arm over some control periods, summed in a record of `HAND`."""

    def __init__(self, hand: Hand) -> None:
        self.force_world: Vector = hand['force']
        self._pushes: list[ScheduledPush] = []

    def schedule_push(
        self, first_tick: int, end_tick: int, force_world: Sequence[float] | Vector
    ) -> None:
        """Push from one tick until before another with a force, world axes, shape (3,) [N]."""
        force = np.array(force_world, dtype=float)
        self._pushes.append(ScheduledPush(first_tick, end_tick, force))

    def begin_period(self, tick: int) -> None:
        """Set the force of the control period that begins with a tick: the sum of its pushes."""
        if not self._pushes:
            return
        self.force_world[:] = 0.0
        for push in self._pushes:
            if push.first_tick <= tick < push.end_tick:
                self.force_world += push.force_world
        self._pushes = [push for push in self._pushes if push.end_tick > tick]


class Contacts:
    """
    The bar tips, and other points of the arm, and the surfaces they may touch.

    Parameters
    ----------
    config
        The plant's surfaces and contacts.
    arm, model
        The arm that carries the tips, and its rigid-body model.
    generators
        Random numbers of the roughness of each surface, in the order of `config.met`.

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
            record['joint'] = frame.parentJoint - 1
            record['body'] = frame.parentJoint - 1
            record['tip'] = frame.placement.translation
            # The wrist sensor feels what touches the tool, not what touches a link.
            if surface.tip_link in (TOOL_LINK, *arm.tips):
                record['body'] = model.nv
        self._native = config.contact == 'native'
        if self._native:
            # The engine makes the forces: these surfaces only say where the tips are.
            for name in ('stiffness', 'damping', 'friction'):
                self.surfaces[name] = 0.0
        self.pressed: Vector = self.surfaces['alpha']
        self.points_world: Matrix = self.surfaces['point']
        self.places_world: Matrix = self.surfaces['place']
        self._shares = np.zeros((len(config.columns), len(met)))
        for row, shares in zip(self._shares, config.columns.values()):
            for name, share in shares.items():
                row[config.met.index(name)] = share
        self._touched = len(config.touched)

    @property
    def alpha(self) -> Vector:
        """Return true forces and couples, as `PlantConfig.columns`, shape (r,) [N]."""
        forces: Vector = self._shares @ self.pressed
        return forces

    @property
    def obstacles(self) -> Vector:
        """Return normal forces on the obstacles, shape (k,) [N]."""
        return self.pressed[self._touched :].copy()

    def changeable_surface(self, number: int) -> Surface:
        """Return the record of a surface, to be changed; ConfigError if it is the engine's own."""
        if self._native:
            raise ConfigError(
                'contact', 'compliant, for surfaces that change', 'native'
            )
        return self.surfaces[number]

    def shift_surface(self, number: int, distance: float) -> None:
        """Move a surface along its normal by `distance` [m], away from the robot if positive."""
        surface = self.changeable_surface(number)
        surface['place'] += distance * surface['normal']

    def put_before_tip(self, number: int, distance: float) -> None:
        """Put a surface `distance` [m] before its tip, where the tip is now, as a wall."""
        surface = self.changeable_surface(number)
        surface['place'] = surface['point'] + distance * surface['normal']

    def scale_stiffness(self, number: int, factor: float) -> None:
        """Multiply a surface's stiffness, and move it such that it presses as before."""
        surface = self.changeable_surface(number)
        depth = surface['alpha'] / surface['stiffness']
        surface['stiffness'] *= factor
        self.shift_surface(number, depth * (1.0 - 1.0 / factor))

    def scale_friction(self, number: int, factor: float) -> None:
        """Multiply a surface's coefficient of friction by a factor, from now on."""
        self.changeable_surface(number)['friction'] *= factor


@compiled
def write_push(
    push: Vector, force: Vector, sign: float, point: Vector, body: int
) -> None:
    """
    Fill a row of pushes, as `EngineArm.apply_pushes` takes them, shape (7,).

    It has sign * force and the point where that acts, world axes, shape (3,) each [N], [m], and
    the number of the body it acts on.
    """
    for k in range(3):
        push[k] = sign * force[k]
        push[3 + k] = point[k]
    push[6] = body


class Surroundings(NamedTuple):
    """What acts on the arm besides its drives, and where its forces are listed."""

    surfaces: Records[Surface]  # shape (no,)
    profiles: Matrix  # of the roughness of each surface, see `build_surfaces`
    hands: Records[Hand]  # the one at the wrist, then the one at the tool
    pushes: Matrix  # forces as `EngineArm.apply_pushes` takes them, shape (no + 2, 7)


@compiled
def act_on_arm(
    motion: Matrix,
    torques: Matrix,
    links: Records[Link],
    drives: Records[Drive],
    surroundings: Surroundings,
    step: float,
) -> int:
    """
    Work out all forces and torques on the arm in one integration step, before the engine's.

    Places the links, lets surfaces and hands act, and advances the rotors of the drives.

    Parameters
    ----------
    motion
        Joint angles and speeds, link side, at the start of the step, shape (2, n) [rad, rad/s].
    torques
        Of the joints, shape (5, n) [N m]: the largest of the motors, and theirs, clipped here to
        these; filled in are what surfaces and hands do, the sum of both, and what the drives do
        to the links.
    links, drives
        Records of `LINK`, and of `DRIVE` (none for motors that act on the links as they are).
    surroundings
        Surfaces, which move by one step, and hands; the first of the pushes are filled in.
    step
        Of the integration [s].

    Returns
    -------
    int
        How many forces there are, or -1 for motor torques that are not finite.

    """
    q = motion[0]
    qd = motion[1]
    limit = torques[0]
    motor = torques[1]
    load = torques[2]
    both = torques[3]
    link_side = torques[4]
    hands = surroundings.hands
    surfaces = surroundings.surfaces
    pushes = surroundings.pushes
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
        press_surface(surface, velocity, surroundings.profiles[i])
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
