"""All contacts of the arm with what surrounds it."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.errors import ConfigError
import numpy as np
import pinocchio as pin
from sim_bridge.arm import OPERATIONAL_FRAME
from sim_bridge.config import PlantConfig
from sim_bridge.kinematics import (
    add_joint_torque,
    chain_of,
    forward_kinematics,
    point_velocity,
)
from sim_bridge.surface import build_surfaces, press


class Contacts:
    """
    The bar tips, and other points of the arm, and the surfaces they may touch.

    Parameters
    ----------
    config
        The plant.
    model
        The arm, for its geometry.
    generators
        A source of roughness for each contact and each obstacle.

    Attributes
    ----------
    pressed
        Normal forces of robot on surface, those on obstacles last, shape (no,) [N].
    forces_world, points_world
        Forces of robot on surface or obstacle, friction included, and where, shape (no, 3) [N],
        [m].
    places_world
        A point of each mean surface now, shape (no, 3) [m].
    carriers
        Number of the joint that carries each of these points.
    wrist_world
        The operational point, shape (3,) [m].
    load
        What the surfaces, and pushes at the wrist and the tool, do to the joints, shape (n,)
        [N m].

    """

    def __init__(
        self, config: PlantConfig, model: pin.Model, generators: list[np.random.Generator],
    ) -> None:
        names = config.met
        self._links = chain_of(model)
        self._surfaces: Any
        self._surfaces, self._heights, self._slopes = build_surfaces(
            [config.surfaces[name] for name in names], generators)
        self._surfaces['joint'], self._surfaces['tip'] = _carried_tips(model, config)
        self.carriers: list[int] = self._surfaces['joint'].tolist()
        self._native = config.contact == 'native'
        if self._native:
            for name in ('stiffness', 'damping', 'friction'):
                self._surfaces[name] = 0.0  # only where the tips are is asked of them
        self._moving = [(i, config.surfaces[name]) for i, name in enumerate(names)
                        if config.surfaces[name].moves]
        self._time = 0.0
        self._given_way = np.zeros(len(names))  # m, along the normals
        frame = model.frames[model.getFrameId(OPERATIONAL_FRAME)]
        self._operational: Vector = np.array(frame.placement.translation)
        self.pressed: Vector = self._surfaces['alpha']
        self._columns: Matrix | None = None
        if config.column_names != names[:len(config.column_names)]:
            self._columns = np.array([
                [shares.get(name, 0.0) for name in names] for shares in config.columns.values()])
        self._count = len(config.column_names)
        self._touched = len(config.touched)
        self.forces_world: Matrix = self._surfaces['force']
        self.points_world: Matrix = self._surfaces['point']
        self.places_world: Matrix = self._surfaces['place']
        self.wrist_world: Vector = np.zeros(3)
        self.load = np.zeros(model.nv)

    @property
    def alpha(self) -> Vector:
        """Return the true forces and couples of the contacts, shape (nc,) [N]."""
        forces: Vector = self.pressed[:self._count].copy() if self._columns is None else (
            self._columns @ self.pressed)
        return forces

    @property
    def obstacles(self) -> Vector:
        """Return the normal forces on what is in the way and no contact, shape (no,) [N]."""
        return self.pressed[self._touched:].copy()

    def move(self, step: float) -> None:
        """Let the surfaces that move or give way do so for a step [s], before it is taken."""
        if not self._moving:
            return
        self._time += step
        for i, config in self._moving:
            if config.mass > 0.0:  # a body on a spring, by semi-implicit Euler
                speed = float(self._surfaces[i]['speed'])
                force = (self.pressed[i] - config.mount_stiffness * self._given_way[i]
                         - config.mount_damping * speed)
                speed += step * float(force) / config.mass
                self._given_way[i] += step * speed
            else:
                time = self._time - config.motion_start
                speed = 0.0 if time <= 0.0 else config.velocity
                if config.motion_period > 0.0:
                    speed *= float(np.sin(2.0 * np.pi * time / config.motion_period))
            self._surfaces[i]['speed'] = speed
            self.shift(i, speed * step)

    def _changing(self, surface: int) -> Any:
        """Return a surface that is to be changed; ConfigError if it is the engine's own."""
        if self._native:
            raise ConfigError('contact', 'compliant, for surfaces that change', 'native')
        return self._surfaces[surface]

    def shift(self, contact: int, distance: float) -> None:
        """Move a surface along its normal by `distance` [m], away from the robot if positive."""
        surface = self._changing(contact)
        surface['place'] += distance * surface['normal']

    def put_before_tip(self, surface: int, distance: float) -> None:
        """Put a surface, or an obstacle after them, so far [m] before the tip as it is now."""
        record = self._changing(surface)
        record['place'] = record['point'] + distance * record['normal']

    def scale_stiffness(self, contact: int, factor: float) -> None:
        """
        Make a surface stiffer by a factor without a step of the force.

        A surface that is pressed on is moved such that it presses as before.
        """
        surface = self._changing(contact)
        depth = surface['alpha'] / surface['stiffness']
        surface['stiffness'] *= factor
        self.shift(contact, depth * (1.0 - 1.0 / factor))

    def scale_friction(self, contact: int, factor: float) -> None:
        """Multiply a surface's coefficient of friction."""
        self._changing(contact)['friction'] *= factor

    def set_friction(self, contact: int, friction: float) -> None:
        """Give a surface another coefficient of friction."""
        self._changing(contact)['friction'] = friction

    def update(self, q: Vector, qd: Vector, push_world: Vector) -> bool:
        """
        Work out the contacts for a state of the arm and a push at the wrist point.

        Parameters
        ----------
        q, qd
            Link side of the joints, shape (n,) [rad], [rad/s].
        push_world
            Force on the wrist, shape (3,) [N].

        Returns
        -------
        bool
            Whether any surface is pressed on.

        """
        return advance_contacts(q, qd, push_world, self._operational, self._links,
                                self._surfaces, self._heights, self._slopes, self.load,
                                self.wrist_world)


def _carried_tips(model: pin.Model, config: PlantConfig) -> tuple[list[int], Matrix]:
    """Return the joint that carries each tip, and the tip in its frame, shape (no, 3) [m]."""
    surfaces = [config.surfaces[name] for name in config.met]
    frames = [model.frames[model.getFrameId(surface.tip_link)] for surface in surfaces]
    tips = [frame.placement.act(np.array(surface.tip_point))
            for frame, surface in zip(frames, surfaces)]
    return [frame.parentJoint - 1 for frame in frames], np.array(tips).reshape(-1, 3)


@compiled
def advance_contacts(
    q: Vector, qd: Vector, push: Vector, push_point: Vector, links: Any, surfaces: Any,
    heights: Matrix, slopes: Matrix, load: Vector, pushed_at: Vector,
) -> bool:
    """
    Work out every contact for a state of the arm.

    Parameters
    ----------
    q, qd
        Joint angles and speeds, link side, shape (n,) [rad], [rad/s].
    push
        Force on a point of the last link, world axes, shape (3,) [N].
    push_point
        That point in the last link's frame, shape (3,) [m].
    links, surfaces
        Records of `LINK`, shape (n,), and `SURFACE`, shape (nc,), changed.
    heights, slopes
        See `Surfaces`.
    load
        Filled with what surfaces and push do to the joints, shape (n,) [N m].
    pushed_at
        Filled with the point that is pushed, world axes, shape (3,) [m].

    Returns
    -------
    bool
        Whether any surface is pressed on.

    """
    joints = q.shape[0]
    last_rotation = np.empty((3, 3))
    velocity = np.empty(3)
    forward_kinematics(q, links, last_rotation)
    for joint in range(joints):
        load[joint] = 0.0
    last = links[joints - 1]
    for row in range(3):
        pushed_at[row] = last.origin[row]
        for column in range(3):
            pushed_at[row] += last_rotation[row, column] * push_point[column]
    add_joint_torque(pushed_at, push, 1.0, links, joints - 1, load)
    pressed = False
    for i in range(surfaces.shape[0]):
        surface = surfaces[i]
        carrier = links[surface.joint]
        for row in range(3):
            surface.point[row] = carrier.origin[row]
            for column in range(3):
                surface.point[row] += carrier.axes[row, column] * surface.tip[column]
        point_velocity(surface.point, qd, links, surface.joint, velocity)
        press(surface, velocity, heights[i], slopes[i])
        if surface.alpha > 0.0:
            pressed = True
            add_joint_torque(surface.point, surface.force, -1.0, links, surface.joint, load)
    return pressed
