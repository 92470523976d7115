"""All contacts of the arm with what surrounds it."""

from __future__ import annotations

from multicontact_control.algebra import copy_vector
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np
import pinocchio as pin
from sim_bridge.config import PlantConfig
from sim_bridge.kinematics import add_joint_torque, forward_kinematics, point_velocity
from sim_bridge.surface import build_surfaces, contact_force, FRICTION, STIFFNESS


class Contacts:
    """
    The bar tips and the surfaces they may touch.

    Parameters
    ----------
    config
        The plant.
    model
        The arm, for its geometry.
    generators
        A source of roughness for each contact.

    Attributes
    ----------
    alpha
        Normal forces of robot on surface, shape (nc,) [N].
    forces_world, points_world
        Forces of robot on surface, friction included, and where, shape (nc, 3) [N], [m].
    wrist_world
        Origin of the last link, shape (3,) [m].
    load
        What the surfaces, and pushes at the wrist and the tool, do to the joints, shape (n,)
        [N m].

    """

    def __init__(
        self, config: PlantConfig, model: pin.Model, generators: list[np.random.Generator],
    ) -> None:
        names = config.contact_names
        self._chain = _chain_constants(model)
        self._tips = _tip_positions(model, config)
        surfaces = build_surfaces([config.surfaces[name] for name in names], generators)
        self._surfaces = (
            surfaces.points_world, surfaces.normals_world, surfaces.tracks_world,
            surfaces.parameters, surfaces.heights, surfaces.slopes)
        self.alpha = np.zeros(len(names))
        self.forces_world, self.points_world = np.zeros((len(names), 3)), np.zeros((len(names), 3))
        self.wrist_world, self.load = np.zeros(3), np.zeros(model.nv)

    def shift(self, contact: int, distance: float) -> None:
        """Move a surface along its normal by `distance` [m], away from the robot if positive."""
        points, normals = self._surfaces[0], self._surfaces[1]
        points[contact] += distance * normals[contact]

    def scale_stiffness(self, contact: int, factor: float) -> None:
        """
        Make a surface stiffer by a factor without a step of the force.

        A surface that is pressed on is moved such that it presses as before.
        """
        stiffness = self._surfaces[3][contact, STIFFNESS]
        depth = self.alpha[contact] / stiffness
        self._surfaces[3][contact, STIFFNESS] = factor * stiffness
        self.shift(contact, depth * (1.0 - 1.0 / factor))

    def scale_friction(self, contact: int, factor: float) -> None:
        """Multiply a surface's coefficient of friction."""
        self._surfaces[3][contact, FRICTION] *= factor

    def update(self, q: Vector, qd: Vector, push_world: Vector) -> None:
        """
        Work out the contacts for a state of the arm and a push at the wrist point.

        Parameters
        ----------
        q, qd
            Link side of the joints, shape (n,) [rad], [rad/s].
        push_world
            Force on the wrist, shape (3,) [N].

        """
        advance_contacts(
            q, qd, push_world, *self._chain, self._tips, *self._surfaces, self.alpha,
            self.forces_world, self.points_world, self.wrist_world, self.load)


def _chain_constants(model: pin.Model) -> tuple[Matrix, Matrix]:
    """Return the pose of each joint frame in the link before it, as compiled code wants it."""
    placements = list(model.jointPlacements)[1:]
    rotations = np.ascontiguousarray([placement.rotation for placement in placements])
    offsets = np.ascontiguousarray([placement.translation for placement in placements])
    return rotations, offsets


def _tip_positions(model: pin.Model, config: PlantConfig) -> Matrix:
    """Return each contact's tip in the last link's frame, shape (nc, 3) [m]."""
    links = [config.surfaces[name].tip_link for name in config.contact_names]
    frames = [model.frames[model.getFrameId(link)] for link in links]
    return np.array([frame.placement.translation for frame in frames]).reshape(-1, 3)


@compiled
def advance_contacts(
    q: Vector, qd: Vector, push: Vector, rotations: Matrix, offsets: Matrix, tips: Matrix,
    surface_points: Matrix, normals: Matrix, tracks: Matrix, parameters: Matrix,
    heights: Matrix, slopes: Matrix, alpha: Vector, forces: Matrix, points: Matrix,
    wrist: Vector, load: Vector,
) -> None:
    """
    Work out every contact for a state of the arm.

    Parameters
    ----------
    q, qd
        Joint angles and speeds, link side, shape (n,) [rad], [rad/s].
    push
        Force on the origin of the last link, world axes, shape (3,) [N].
    rotations, offsets
        See `forward_kinematics`.
    tips
        Tips in the last link's frame, shape (nc, 3) [m].
    surface_points, normals, tracks, parameters, heights, slopes
        See `Surfaces`.
    alpha
        Filled with the normal forces, shape (nc,) [N].
    forces, points
        Filled with the forces of robot on surface and where, world axes, shape (nc, 3) [N], [m].
    wrist
        Filled with the origin of the last link, world axes, shape (3,) [m].
    load
        Filled with what surfaces and push do to the joints, shape (n,) [N m].

    """
    joints = q.shape[0]
    axes = np.empty((joints, 3))
    origins = np.empty((joints, 3))
    rotation = np.empty((3, 3))
    velocity = np.empty(3)
    forward_kinematics(q, rotations, offsets, axes, origins, rotation)
    copy_vector(origins[joints - 1], wrist)
    for joint in range(joints):
        load[joint] = 0.0
    add_joint_torque(wrist, push, 1.0, axes, origins, load)
    for contact in range(tips.shape[0]):
        for row in range(3):
            points[contact, row] = wrist[row]
            for column in range(3):
                points[contact, row] += rotation[row, column] * tips[contact, column]
        point_velocity(points[contact], qd, axes, origins, velocity)
        alpha[contact] = contact_force(
            points[contact], velocity, surface_points[contact], normals[contact],
            tracks[contact], parameters[contact], heights[contact], slopes[contact],
            forces[contact])
        if alpha[contact] > 0.0:
            add_joint_torque(points[contact], forces[contact], -1.0, axes, origins, load)
