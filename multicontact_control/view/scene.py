"""The arm, its surfaces and its contact forces, drawn in three dimensions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import Vector3
from multicontact_control.config.contact import ContactConfig
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.view.shapes import (
    make_rod,
    read_shapes,
    TOOL_RADIUS,
)
from multicontact_control.view.source import DrawnPush, DrawnSurface, Scene, Snapshot
import numpy as np
from scipy.spatial.transform import Rotation
from sim_bridge.arm import TOOL_LINK
from sim_bridge.surface_patch import COLOURS, shape_surface_patch
import trimesh

# Floor and axes of the world.
FLOOR_SIZE = 3.0  # m
CELL_COLOUR = (226, 228, 231)
SECTION_COLOUR = (205, 208, 213)
AXES_LENGTH = 0.15  # m
AXES_PLACE = (0.1, 0.2, 0.0)  # m
# The camera looks at a point between the surfaces, moved towards the arm and a little up.
# m, between surfaces whose places are not known.
USUAL_MIDDLE = np.array([0.0, 0.5, 0.5])
TOWARDS_ARM = (1.0, 0.62, 1.0)
ABOVE_MIDDLE = (0.0, 0.0, 0.09)  # m
CAMERA_OFFSET = (1.58, -0.58, 0.44)  # m, from the point that the camera looks at
# Contacts.
TIP_SIZE = 0.011  # m: radius of the dot of a point, thickness of an edge or a plane
LEVEL_COMPONENT = 0.8  # of a normal along z, from which its surface counts as level
LABEL_HEIGHT = 0.03  # m, of a label behind the surface
TOUCHING_FORCE = 1.5  # N, from which a contact shows where its surface is
STATE_COLOURS = {
    'free': (150, 155, 162),
    'approaching': (232, 176, 48),
    'impact': (120, 190, 90),
    'holding': (52, 150, 92),
    'lost': (208, 60, 50),
    'retracting': (208, 60, 50),
    'given up': (128, 40, 60),
    'force': (52, 150, 92),
}
# Arrows of forces.
METRES_PER_NEWTON = 0.012
SHORTEST_ARROW = 0.015  # m
HEAD_LENGTH = 0.022  # m
ARROW_SPACING = 0.022  # m, between the arrows of a contact
OUT_OF_SIGHT = 10.0  # m, along the normal
FORCE_COLOURS = {
    'measured': (205, 82, 0),
    'estimated': (10, 78, 165),
    'desired': (10, 122, 58),
}
PUSH_COLOUR = (138, 60, 176)
PUSH_DISTANCE = 0.08  # m, from the link on which a push acts to the tip of its arrow
SHORTEST_PUSH = 0.08  # m, to which the length for the force is added
ABOVE_PUSH = (0.0, 0.0, 0.015)  # m, of the label from the tail of the arrow
SMALLEST_MOVE = 5e-4  # m, for which the handle is drawn anew


class _DrawnContact(NamedTuple):
    """A contact with the elements of the page that show it."""

    name: str
    config: ContactConfig
    column: int  # of its force among all forces and couples
    tip: Any
    label: Any


class SceneView:
    """
    Draws one arm with its contacts and surfaces on the page of a viser server.

    The arm has the shapes of its URDF. Each contact has a tip in the colour of its state, a label
    and three arrows for the measured, estimated and desired force. All positions are in world
    axes [m].

    Parameters
    ----------
    server
        The viser server that serves the page.
    scene
        The arm, its contacts and its surfaces.

    """

    def __init__(self, server: Any, scene: Scene) -> None:
        self._api = server.scene
        self._scene = scene
        config = scene.config
        self._robot = RobotModel(config.robot, scene.urdf_dir)
        self._links: dict[str, Any] = {}
        self._arrows: list[Any] = []
        self._contacts: list[_DrawnContact] = []
        self._patches: dict[str, Any] = {}
        for name, column in zip(config.contact_names, config.force_columns):
            self._add_contact(name, column)
        self._contact_points = np.array(
            [contact.config.point_operational for contact in self._contacts]
        )
        self._add_floor()
        self._add_links()
        self._add_force_arrows()
        self._add_push_arrow()
        for surface in scene.surfaces:
            if surface.point_world is not None:
                self._add_surface(surface, surface.point_world)
        self._handle: Any = None
        self._dragged_by: int | None = None  # number of a browser
        server.on_client_disconnect(self._end_drag_of_browser)
        self._place_camera(server.initial_camera)

    def _add_floor(self) -> None:
        """Add the floor with a grid of decimetres, and the labelled axes of the world."""
        self._api.add_grid(
            '/floor',
            width=FLOOR_SIZE,
            height=FLOOR_SIZE,
            cell_size=0.1,
            section_size=0.5,
            cell_color=CELL_COLOUR,
            section_color=SECTION_COLOUR,
        )
        self._api.add_frame(
            '/world',
            axes_length=AXES_LENGTH,
            axes_radius=0.025 * AXES_LENGTH,
            position=AXES_PLACE,
        )
        ends = 1.15 * AXES_LENGTH * np.eye(3)
        for axis, end in zip('xyz', ends):
            self._api.add_label(
                f'/world/{axis}', axis, position=end, anchor='center-center'
            )

    def _add_links(self) -> None:
        robot = self._scene.config.robot
        shapes = read_shapes(self._scene.urdf_dir / robot.urdf)
        if TOOL_LINK not in shapes:
            self._add_tool_rods(shapes[robot.operational_frame])
        for link, shape in shapes.items():
            content = shape.export(file_type='glb', include_normals=True)
            self._links[link] = self._api.add_glb(f'/arm/{link}', content)

    def _add_tool_rods(self, shape: trimesh.Scene) -> None:
        """Let rods lead from the wrist sensor to the contacts where the URDF shows no tool."""
        robot = self._scene.config.robot
        sensor, operational = self._robot.compute_link_poses(
            np.zeros(len(robot.joint_names)),
            [robot.sensor_frame, robot.operational_frame],
        )
        offset_world = sensor.position_world - operational.position_world
        start = operational.rotation_world.T @ offset_world
        for point in self._contact_points:
            shape.add_geometry(make_rod(start, point, TOOL_RADIUS))

    def _add_force_arrows(self) -> None:
        ends = np.zeros((len(self._contact_points), 2, 3))
        for kind, colour in FORCE_COLOURS.items():
            arrows = self._api.add_arrows(
                f'/forces/{kind}',
                ends,
                colour,
                shaft_radius=0.0055,
                head_radius=0.012,
                head_length=HEAD_LENGTH,
            )
            self._arrows.append(arrows)

    def _add_contact(self, name: str, column: int) -> None:
        """Add the tip and the label of a contact; `column` is that of its force."""
        config = self._scene.config.contacts[name]
        colour = STATE_COLOURS['free']
        if config.type == 'point':
            tip = self._api.add_icosphere(
                f'/contacts/{name}', radius=TIP_SIZE, color=colour
            )
        else:
            width = TIP_SIZE
            if config.type == 'plane':
                width = 2.0 * config.half_width
            dimensions = (2.0 * config.half_length, width, TIP_SIZE)
            tip = self._api.add_box(f'/contacts/{name}', colour, dimensions=dimensions)
        # Beyond the tips of the arrows: below on a level surface, beside on one that stands.
        anchor = 'center-left'
        if _is_level(config.normal_world):
            anchor = 'top-center'
        label = self._api.add_label(f'/labels/{name}', name, anchor=anchor)
        self._contacts.append(_DrawnContact(name, config, column, tip, label))

    def _add_push_arrow(self) -> None:
        self._push_arrow = self._api.add_arrows(
            '/push',
            np.zeros((1, 2, 3)),
            PUSH_COLOUR,
            shaft_radius=0.008,
            head_radius=0.018,
            head_length=HEAD_LENGTH,
            visible=False,
        )
        self._push_label = self._api.add_label(
            '/push/force', '', anchor='bottom-center'
        )

    def _add_surface(
        self, surface: DrawnSurface, point_world: Vector | Vector3
    ) -> None:
        patch = surface.patch
        if patch is None:
            patch = shape_surface_patch(np.array(surface.normal_world))
        self._patches[surface.name] = self._api.add_mesh_simple(
            f'/surfaces/{surface.name}',
            patch.vertices,
            patch.faces,
            color=COLOURS[len(self._patches) % len(COLOURS)],
            position=point_world,
            flat_shading=True,
            side='double',
            cast_shadow=False,
        )

    def _place_camera(self, camera: Any) -> None:
        """Let browsers that open the page look from the side at arm and surfaces."""
        places = [surface.point_world for surface in self._scene.surfaces]
        known_places = [place for place in places if place is not None]
        middle = USUAL_MIDDLE
        if known_places:
            middle = np.mean(known_places, axis=0)
        target = middle * TOWARDS_ARM + ABOVE_MIDDLE
        camera.look_at = target
        camera.position = target + CAMERA_OFFSET
        camera.fov = np.radians(42.0)

    def add_drag_handle(self, on_drag: Callable[[Vector], None]) -> Any:
        """
        Add a handle by which a browser drags the operational point.

        The handle is hidden at first. While it is visible and no browser drags it, it follows the
        goal of the motion, or the desired position.

        Parameters
        ----------
        on_drag
            Takes the position to which the handle was dragged, world axes, shape (3,) [m].

        Returns
        -------
        Any
            The handle, an element of viser's scene that is shown by its `visible`.

        """
        self._handle = self._api.add_transform_controls(
            '/handle',
            scale=0.16,
            disable_rotations=True,
            disable_sliders=True,
            depth_test=False,
            opacity=0.9,
            visible=False,
        )

        def follow_drag(event: Any) -> None:
            """Note which browser drags, and tell where the handle is."""
            self._dragged_by = event.client_id
            if event.phase == 'end':
                self._dragged_by = None
            if event.phase != 'start':
                on_drag(np.array(event.target.position))

        self._handle.on_update(follow_drag)
        return self._handle

    def _end_drag_of_browser(self, client: Any) -> None:
        """End the drag of a browser that has left."""
        if client.client_id == self._dragged_by:
            self._dragged_by = None

    def draw_snapshot(self, snapshot: Snapshot, *, labels: bool) -> None:
        """
        Draw arm, contacts, forces, push and surfaces as they are in a snapshot.

        Where joint positions or pose are not finite, what they place stays where it is.

        Parameters
        ----------
        snapshot
            What to draw.
        labels
            Whether to write the forces [N] and states at the contacts; texts that change with
            each snapshot cannot be read.

        """
        if np.isfinite(snapshot.q).all():
            self._draw_links(snapshot.q)
        pose = np.concatenate([snapshot.position, snapshot.quaternion])
        if not np.isfinite(pose).all():
            return
        rotation = Rotation.from_quat(snapshot.quaternion)
        points = snapshot.position + rotation.apply(self._contact_points)
        self._draw_force_arrows(snapshot, points)
        self._draw_contact_tips(snapshot, points, rotation)
        if labels:
            self._draw_contact_labels(snapshot, points)
        self._draw_push(snapshot.q, snapshot.push)
        self._draw_surfaces(snapshot, points)
        self._move_handle(snapshot)

    def _draw_links(self, q: Vector) -> None:
        poses = self._robot.compute_link_poses(q, list(self._links))
        for link, pose in zip(self._links.values(), poses):
            link.position = pose.position_world
            link.wxyz = _order_scalar_first(Rotation.from_matrix(pose.rotation_world))

    def _draw_force_arrows(self, snapshot: Snapshot, points: Matrix) -> None:
        """Draw the forces at the contact points, world axes, shape (nc, 3) [m]."""
        forces = (snapshot.measured, snapshot.estimated, snapshot.desired)
        for i, (arrows, values) in enumerate(zip(self._arrows, forces)):
            ends = []
            for contact, point, normal in zip(
                self._contacts, points, snapshot.normals_world
            ):
                foot = point + (i + 1) * _find_arrow_step(point, normal)
                force = float(values[contact.column])
                ends.append(_compute_arrow_ends(foot, normal, force))
            arrows.points = np.array(ends)

    def _draw_contact_tips(
        self, snapshot: Snapshot, points: Matrix, rotation: Rotation
    ) -> None:
        """Draw the tips in the colours of their states; an edge or plane lies on its surface."""
        for contact, state, point, normal in zip(
            self._contacts, snapshot.states, points, snapshot.normals_world
        ):
            tip = contact.tip
            tip.position = point
            tip.color = STATE_COLOURS.get(state, STATE_COLOURS['free'])
            if contact.config.type != 'point':
                along = rotation.apply(contact.config.direction_operational)
                x_and_z = np.eye(3)[[0, 2]]
                turn, _ = Rotation.align_vectors([along, normal], x_and_z)
                tip.wxyz = _order_scalar_first(turn)

    def _draw_contact_labels(self, snapshot: Snapshot, points: Matrix) -> None:
        for contact, state, point, normal in zip(
            self._contacts, snapshot.states, points, snapshot.normals_world
        ):
            force = format_newtons(float(snapshot.measured[contact.column]))
            contact.label.text = f'{contact.name}  {force} N  {state}'
            middle_foot = point + 2.0 * _find_arrow_step(point, normal)
            contact.label.position = middle_foot + LABEL_HEIGHT * normal

    def _draw_push(self, q: Vector, push: DrawnPush | None) -> None:
        """Draw a push as an arrow towards its link, that ends outside of the arm."""
        if push is None:
            self._push_arrow.visible = False
            return
        force = np.array(push.force_world)
        magnitude = float(np.linalg.norm(force))
        self._push_arrow.visible = 0.0 < magnitude < np.inf
        if not self._push_arrow.visible:
            return
        (pose,) = self._robot.compute_link_poses(q, [push.link])
        direction = force / magnitude
        length = SHORTEST_PUSH + METRES_PER_NEWTON * magnitude
        tip = pose.position_world - PUSH_DISTANCE * direction
        tail = tip - length * direction
        self._push_arrow.points = np.array([[tail, tip]])
        self._push_label.text = f'push {magnitude:g} N'
        self._push_label.position = tail + ABOVE_PUSH

    def _draw_surfaces(self, snapshot: Snapshot, points: Matrix) -> None:
        """Draw the surfaces where they are, or where a contact force first shows them."""
        places: dict[str, Vector | Vector3] = dict(snapshot.places_world)
        # The surfaces of the contacts come first, in the order of the contacts.
        for surface, contact, point in zip(
            self._scene.surfaces, self._contacts, points
        ):
            is_touched = snapshot.measured[contact.column] > TOUCHING_FORCE
            if is_touched and surface.name not in self._patches:
                places.setdefault(surface.name, point)
        for surface in self._scene.surfaces:
            place = places.get(surface.name)
            if place is None:
                continue
            if surface.name in self._patches:
                self._patches[surface.name].position = place
            else:
                self._add_surface(surface, place)

    def _move_handle(self, snapshot: Snapshot) -> None:
        """Move the handle to where the operational point is to go, if no browser drags it."""
        if self._handle is None or self._dragged_by is not None:
            return
        place = snapshot.goal
        if place is None:
            place = snapshot.position_des
        distances = np.abs(self._handle.position - place)
        if self._handle.visible and distances.max() > SMALLEST_MOVE:
            self._handle.position = place


def format_newtons(force: float) -> str:
    """
    Return a force in newtons with one decimal.

    A force that is NaN or infinite, since it is not known, becomes a hyphen. Small negative forces
    become 0.0 without a sign, which noise would make flicker.
    """
    if not np.isfinite(force):
        return '-'
    text = f'{force:.1f}'
    if text == '-0.0':
        return '0.0'
    return text


def _order_scalar_first(rotation: Rotation) -> Vector:
    """Return a rotation as viser takes it: a quaternion, scalar first, shape (4,)."""
    return np.roll(rotation.as_quat(), 1)


def _is_level(normal_world: Vector | Vector3) -> bool:
    return abs(normal_world[2]) >= LEVEL_COMPONENT


def _find_arrow_step(point: Vector, normal: Vector) -> Vector:
    """
    Return the way from one arrow of a contact to the next [m].

    It lies in the surface and leads up, or towards the arm where the surface is level.
    """
    direction = np.array([0.0, 0.0, 1.0])
    if _is_level(normal):
        direction = point * (-1.0, -1.0, 0.0)
    along = direction - normal * (normal @ direction)
    length = max(float(np.linalg.norm(along)), 1e-9)
    return np.asarray(ARROW_SPACING / length * along)


def _compute_arrow_ends(foot: Vector, normal: Vector, force: float) -> Matrix:
    """
    Return tail and tip of an arrow whose end at the surface is its foot, shape (2, 3) [m].

    A force that presses, along the normal into the surface, points to the foot; one that pulls
    points away from it. An arrow too short to have a direction is put out of sight.
    """
    length = METRES_PER_NEWTON * abs(force)
    if not SHORTEST_ARROW <= length < np.inf:
        hidden = foot + OUT_OF_SIGHT * normal
        return np.array([hidden, hidden])
    other_end = foot - length * normal
    if force > 0.0:
        return np.array([other_end, foot])
    return np.array([foot, other_end])
