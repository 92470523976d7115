"""The arm, its surfaces and its contact forces, drawn in three dimensions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.view.shapes import (
    make_rod,
    read_shapes,
    TOOL,
    viser_quaternion,
)
from multicontact_control.view.source import DrawnPush, DrawnSurface, Scene, Snapshot
import numpy as np
from scipy.spatial.transform import Rotation
from sim_bridge.arm import TOOL_LINK
from sim_bridge.surface_patch import COLOURS, shape_surface_patch

METRES_PER_NEWTON = 0.012
SMALLEST_ARROW = 0.015  # m
HEAD = 0.022  # m
BESIDE = 0.022  # m, between the arrows of a contact
LEVEL = 0.8  # component of a normal along z, from which a surface is as good as level
LEAST_WAY = 5e-4  # m, that is drawn
TIP = 0.011  # m, radius of the dot of a contact, thickness of an edge or face
TOUCH = 1.5  # N, from which a surface is known to be there
PUSH = 0.08  # m, from where a push acts, inside the arm, to its arrow, and of that at least
AXES, AXES_PLACE = (
    0.15,
    (0.1, 0.2, 0.0),
)  # m, of those that show the directions of the world
MEASURED, ESTIMATED, DESIRED = (205, 82, 0), (10, 78, 165), (10, 122, 58)
PUSHED, ABOVE = (138, 60, 176), (0.0, 0.0, 0.015)
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
BACK = np.array([1.58, -0.58, 0.44])  # m, of the camera from what it looks at


class SceneView:
    """Draws one arm, and what a scene has besides, on the page of a viser server."""

    def __init__(self, server: Any, scene: Scene) -> None:
        self._scene = scene
        config = scene.config
        self._robot = RobotModel(config.robot, scene.urdf_dir)
        self._shapes = read_shapes(scene.urdf_dir / config.robot.urdf)
        self._leaders = list(config.force_columns)
        self._contacts = [config.contacts[name] for name in config.contact_names]
        self._points = np.array(
            [contact.point_operational for contact in self._contacts]
        )
        if TOOL_LINK not in self._shapes:
            self._add_tool()
        self._api = server.scene
        self._draw_arm()
        self._draw_contacts()
        self._patches: dict[str, Any] = {}
        for surface in scene.surfaces:
            self._draw_surface(surface)
        self._handle: Any = None
        self._dragged_by: int | None = None  # number of a browser
        server.on_client_disconnect(self._let_go)
        self._look(server)

    def _add_tool(self) -> None:
        """Let rods lead from the wrist sensor to the contacts, since the URDF shows no tool."""
        names = self._scene.config.robot
        sensor, own = self._robot.compute_link_poses(
            np.zeros(len(names.joint_names)),
            (names.sensor_frame, names.operational_frame),
        )
        start = own.rotation_world.T @ (sensor.position_world - own.position_world)
        for point in self._points:
            self._shapes[names.operational_frame].add_geometry(
                make_rod(start, point, TOOL)
            )

    def _look(self, server: Any) -> None:
        placed = [
            surface.point_world
            for surface in self._scene.surfaces
            if surface.point_world
        ]
        middle = np.mean(placed, axis=0) if placed else np.array([0.0, 0.5, 0.5])
        target = middle * np.array([1.0, 0.62, 1.0]) + np.array([0.0, 0.0, 0.09])
        server.initial_camera.look_at = target
        server.initial_camera.position = target + BACK
        server.initial_camera.fov = np.radians(42.0)
        axes = self._api.add_frame(
            '/world', axes_length=AXES, axes_radius=0.025 * AXES, position=AXES_PLACE
        )
        for name, end in zip('xyz', 1.15 * AXES * np.eye(3)):
            self._api.add_label(
                f'{axes.name}/{name}', name, position=end, anchor='center-center'
            )

    def _draw_arm(self) -> None:
        api = self._api
        api.add_grid(
            '/floor',
            width=3.0,
            height=3.0,
            cell_size=0.1,
            section_size=0.5,
            cell_color=(226, 228, 231),
            section_color=(205, 208, 213),
            position=(0.0, 0.0, 0.0),
            plane='xy',
        )
        self._links = {
            link: api.add_glb(
                f'/arm/{link}', shape.export(file_type='glb', include_normals=True)
            )
            for link, shape in self._shapes.items()
        }

    def _draw_surface(self, surface: DrawnSurface) -> None:
        if surface.point_world is None:
            return
        patch = surface.patch or shape_surface_patch(np.array(surface.normal_world))
        self._patches[surface.name] = self._api.add_mesh_simple(
            f'/surfaces/{surface.name}',
            patch.vertices,
            patch.faces,
            color=COLOURS[len(self._patches) % len(COLOURS)],
            position=np.array(surface.point_world),
            flat_shading=True,
            side='double',
            cast_shadow=False,
        )

    def _draw_contacts(self) -> None:
        api, config = self._api, self._scene.config
        names = config.contact_names
        nothing = np.zeros((len(names), 2, 3))
        # Beyond the tips of the arrows: below on a level surface, beside on one that stands.
        levels = [abs(config.contacts[name].normal_world[2]) >= LEVEL for name in names]
        self._arrows = [
            api.add_arrows(
                f'/forces/{kind}',
                nothing,
                colour,
                shaft_radius=0.0055,
                head_radius=0.012,
                head_length=HEAD,
            )
            for kind, colour in (
                ('measured', MEASURED),
                ('estimated', ESTIMATED),
                ('desired', DESIRED),
            )
        ]
        self._tips = [
            api.add_icosphere(
                f'/contacts/{name}', radius=TIP, color=STATE_COLOURS['free']
            )
            if contact.type == 'point'
            else api.add_box(
                f'/contacts/{name}',
                STATE_COLOURS['free'],
                dimensions=(
                    2.0 * contact.half_length,
                    TIP if contact.type == 'edge' else 2.0 * contact.half_width,
                    TIP,
                ),
            )
            for name, contact in zip(names, self._contacts)
        ]
        self._labels = [
            api.add_label(
                f'/labels/{name}', name, anchor='top-center' if level else 'center-left'
            )
            for name, level in zip(names, levels)
        ]
        self._colours: list[tuple[int, int, int] | None] = [None] * len(names)
        self._push = api.add_arrows(
            '/push',
            nothing[:1],
            PUSHED,
            shaft_radius=0.008,
            head_radius=0.018,
            head_length=HEAD,
            visible=False,
        )
        self._push_label = api.add_label('/push/force', '', anchor='bottom-center')

    def add_drag_handle(self, on_drag: Callable[[Vector], None]) -> Any:
        """Return a hidden handle of the operational point; `on_drag` takes where it goes [m]."""
        self._handle = self._api.add_transform_controls(
            '/handle',
            scale=0.16,
            disable_rotations=True,
            disable_sliders=True,
            depth_test=False,
            opacity=0.9,
            visible=False,
        )

        def moved(event: Any) -> None:
            self._dragged_by = None if event.phase == 'end' else event.client_id
            if event.phase != 'start':
                on_drag(np.array(event.target.position))

        self._handle.on_update(moved)
        return self._handle

    def _let_go(self, client: Any) -> None:
        """End the drag of a browser that has left."""
        if client.client_id == self._dragged_by:
            self._dragged_by = None

    def draw_snapshot(self, snapshot: Snapshot, *, labels: bool = True) -> None:
        """Draw a snapshot; the labels only now and then."""
        if np.isfinite(snapshot.q).all():
            for link, pose in zip(
                self._links.values(),
                self._robot.compute_link_poses(snapshot.q, [*self._links]),
            ):
                link.position = pose.position_world
                link.wxyz = viser_quaternion(Rotation.from_matrix(pose.rotation_world))
        if not (
            np.isfinite(snapshot.position).all()
            and np.isfinite(snapshot.quaternion).all()
        ):
            return
        rotation = Rotation.from_quat(snapshot.quaternion).as_matrix()
        points = snapshot.position + self._points @ rotation.T
        self._show_forces(snapshot, points, rotation, labels)
        self._show_push(snapshot.q, snapshot.push)
        self._show_surfaces(snapshot, points)
        if (
            self._handle is not None
            and self._handle.visible
            and self._dragged_by is None
        ):
            place = snapshot.position_des if snapshot.goal is None else snapshot.goal
            if np.abs(np.array(self._handle.position) - place).max() > LEAST_WAY:
                self._handle.position = place

    def _show_forces(
        self,
        snapshot: Snapshot,
        points: Matrix,
        rotation: Matrix,
        labels: bool,
    ) -> None:
        for number, (arrows, forces) in enumerate(
            zip(self._arrows, (snapshot.measured, snapshot.estimated, snapshot.desired))
        ):
            arrows.points = np.array(
                [
                    _arrow(point, normal, force, number - 1)
                    for point, normal, force in zip(
                        points, snapshot.normals_world, forces[self._leaders]
                    )
                ]
            ).astype(np.float32)
        for i, (tip, state, point) in enumerate(
            zip(self._tips, snapshot.states, points)
        ):
            tip.position, normal = point, snapshot.normals_world[i]
            if self._contacts[i].type != 'point':
                along = rotation @ self._contacts[i].direction_operational
                tip.wxyz = viser_quaternion(
                    Rotation.align_vectors([along, normal], np.eye(3)[[0, 2]])[0]
                )
            colour = STATE_COLOURS.get(state, STATE_COLOURS['free'])
            if colour != self._colours[i]:
                self._colours[i] = tip.color = colour
            if not labels:
                continue
            force = float(snapshot.measured[self._leaders[i]])
            label = self._labels[i]
            name = self._scene.config.contact_names[i]
            label.text = f'{name}  {format_newtons(force)} N  {state}'
            label.position = (
                point + 0.03 * normal + 2.0 * BESIDE * _sideways(point, normal)
            )

    def _show_push(self, q: Vector, push: DrawnPush | None) -> None:
        force = np.array(push.force_world if push else (0.0,) * 3)
        size = float(np.linalg.norm(force))
        shown = 0.0 < size < np.inf
        if self._push.visible != shown:
            self._push.visible = shown
        if push and shown:
            (pose,) = self._robot.compute_link_poses(q, [push.link])
            tip = pose.position_world - PUSH * force / size
            tail = tip - (METRES_PER_NEWTON + PUSH / size) * force
            self._push.points = np.array([[tail, tip]], dtype=np.float32)
            self._push_label.text = f'push {size:g} N'
            self._push_label.position = tail + ABOVE

    def _show_surfaces(self, snapshot: Snapshot, points: Matrix) -> None:
        """Draw the surfaces where they are; those whose place is not known where they are felt."""
        for i, surface in enumerate(self._scene.surfaces):
            place = snapshot.places_world.get(surface.name)
            patch = self._patches.get(surface.name)
            if (
                patch is None
                and place is None
                and snapshot.measured[self._leaders[i]] > TOUCH
            ):
                x, y, z = points[i].tolist()
                place = (x, y, z)
            if place is None:
                continue
            if patch is None:
                self._draw_surface(surface._replace(point_world=place))
            elif np.abs(patch.position - np.array(place)).max() > LEAST_WAY:
                patch.position = np.array(place)


def format_newtons(force: float) -> str:
    """Return a force as it is read."""
    text = f'{force:.1f}' if np.isfinite(force) else '-'
    return '0.0' if text == '-0.0' else text


def _sideways(point: Vector, normal: Vector) -> Vector:
    """Return a direction in a surface, up or towards the arm, to set out arrows along."""
    axis = (
        np.array([0.0, 0.0, 1.0])
        if abs(normal[2]) < LEVEL
        else point * (-1.0, -1.0, 0.0)
    )
    along = axis - normal * (normal @ axis)
    return np.asarray(along / max(float(np.linalg.norm(along)), 1e-9))


def _arrow(point: Vector, normal: Vector, force: float, place: int) -> Matrix:
    """Return an arrow that ends on the surface; nothing for next to no force."""
    length = METRES_PER_NEWTON * abs(force) if np.isfinite(force) else 0.0
    if length < SMALLEST_ARROW:
        return np.tile(
            point + normal * 10.0, (2, 1)
        )  # out of sight: a point has no direction
    foot = point + (place + 2.0) * BESIDE * _sideways(point, normal)
    ends = np.array([foot - normal * length, foot])
    return ends if force > 0.0 else ends[::-1]
