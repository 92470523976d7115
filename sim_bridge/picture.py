"""
A picture of a plant as it stands, by the renderer of its engine.

It is drawn in a world of its own, of rods from joint to joint and plates for the surfaces, so that
the plant's is left as it is.
"""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.arrays import Vector
import numpy as np
from numpy.typing import NDArray
import pinocchio as pin
from sim_bridge.arm import format_numbers, SENSOR_FRAME
from sim_bridge.plant import Plant
from sim_bridge.posture import rotation_between

WIDTH, HEIGHT = 480, 360  # pixels
EYE = (1.0, -0.9, 0.6)  # from what is looked at, world axes [m]
FIELD_OF_VIEW = 50.0  # degrees, vertical
LINK_RADIUS, BAR_RADIUS = 0.04, 0.008  # m
PLATE = (0.2, 0.2, 0.005)  # half sizes, the last along the normal [m]
ARM_COLOUR = (0.85, 0.5, 0.2, 1.0)
BAR_COLOUR = (0.3, 0.3, 0.35, 1.0)
PLATE_COLOUR = (0.45, 0.6, 0.75, 1.0)
FAR = 10.0  # m

Image = NDArray[np.uint8]


class Rod(NamedTuple):
    """A round rod between two points of the world [m]."""

    start: Vector
    end: Vector
    radius: float
    colour: tuple[float, ...]


class Plate(NamedTuple):
    """A plate whose middle lies half its thickness behind a surface; axes as columns."""

    centre: Vector
    rotation: NDArray[np.float64]


class Scene(NamedTuple):
    """What is drawn, and the point that is looked at [m]."""

    rods: list[Rod]
    plates: list[Plate]
    focus: Vector


def take_picture(plant: Plant) -> Image:
    """Return a picture of a plant, shape (360, 480, 3), red, green and blue."""
    scene = compose_scene(plant)
    if plant.config.engine == 'pybullet':
        return _draw_in_bullet(scene)
    return _draw_in_mujoco(scene)


def compose_scene(plant: Plant) -> Scene:
    """Return the rods of an arm, from joint to joint and on to the tips, and its surfaces."""
    model = plant.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, plant.arm.q)
    face = data.oMf[model.getFrameId(SENSOR_FRAME)].translation.copy()
    joints = [place.translation.copy() for place in data.oMi]
    rods = []
    for start, end in zip(joints, [*joints[1:], face]):
        if np.linalg.norm(end - start) > LINK_RADIUS:
            rods.append(Rod(start, end, LINK_RADIUS, ARM_COLOUR))
    for tip in plant.contacts.points_world:
        rods.append(Rod(face, tip.copy(), BAR_RADIUS, BAR_COLOUR))
    plates = []
    for surface in plant.contacts.surfaces:
        across = surface['point'] - surface['place']
        depth = surface['normal'] @ across
        centre = surface['point'] + (PLATE[2] - depth) * surface['normal']
        rotation = rotation_between(np.array([0.0, 0.0, 1.0]), surface['normal'])
        plates.append(Plate(centre, rotation))
    return Scene(rods, plates, face)


def _draw_in_bullet(scene: Scene) -> Image:
    from sim_bridge.bullet_arm import bullet

    client = bullet.connect(bullet.DIRECT)
    try:
        for rod in scene.rods:
            way = rod.end - rod.start
            shape = bullet.createVisualShape(
                bullet.GEOM_CAPSULE,
                radius=rod.radius,
                length=float(np.linalg.norm(way)),
                rgbaColor=rod.colour,
                physicsClientId=client,
            )
            upright = np.array([0.0, 0.0, 1.0])
            rotation = rotation_between(upright, way / np.linalg.norm(way))
            _place_in_bullet(
                bullet, client, shape, 0.5 * (rod.start + rod.end), rotation
            )
        for plate in scene.plates:
            shape = bullet.createVisualShape(
                bullet.GEOM_BOX,
                halfExtents=PLATE,
                rgbaColor=PLATE_COLOUR,
                physicsClientId=client,
            )
            _place_in_bullet(bullet, client, shape, plate.centre, plate.rotation)
        eye = scene.focus + EYE
        view = bullet.computeViewMatrix(eye.tolist(), scene.focus.tolist(), (0, 0, 1))
        lens = bullet.computeProjectionMatrixFOV(
            FIELD_OF_VIEW, WIDTH / HEIGHT, 0.1, FAR
        )
        pixels = bullet.getCameraImage(
            WIDTH,
            HEIGHT,
            view,
            lens,
            renderer=bullet.ER_TINY_RENDERER,
            physicsClientId=client,
        )[2]
    finally:
        bullet.disconnect(client)
    image: Image = np.reshape(pixels, (HEIGHT, WIDTH, 4))[:, :, :3].astype(np.uint8)
    return image


def _place_in_bullet(
    bullet: object,
    client: int,
    shape: int,
    centre: Vector,
    rotation: NDArray[np.float64],
) -> None:
    bullet.createMultiBody(  # type: ignore[attr-defined]
        baseVisualShapeIndex=shape,
        basePosition=centre.tolist(),
        baseOrientation=pin.Quaternion(rotation).coeffs().tolist(),
        physicsClientId=client,
    )


def _draw_in_mujoco(scene: Scene) -> Image:
    import mujoco

    geoms = []
    for rod in scene.rods:
        ends = format_numbers([*rod.start.tolist(), *rod.end.tolist()])
        geoms.append(
            f'<geom type="capsule" fromto="{ends}" size="{rod.radius!r}" '
            f'rgba="{format_numbers(rod.colour)}"/>'
        )
    for plate in scene.plates:
        geoms.append(
            f'<geom type="box" size="{format_numbers(PLATE)}" '
            f'pos="{format_numbers(plate.centre.tolist())}" '
            f'zaxis="{format_numbers(plate.rotation[:, 2].tolist())}" '
            f'rgba="{format_numbers(PLATE_COLOUR)}"/>'
        )
    eye = scene.focus + EYE
    back = eye - scene.focus
    right = np.cross([0.0, 0.0, 1.0], back)
    up = np.cross(back, right)
    axes = format_numbers([*right.tolist(), *up.tolist()])
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><visual><global fovy="{FIELD_OF_VIEW!r}" '
        f'offwidth="{WIDTH}" offheight="{HEIGHT}"/></visual><worldbody>'
        f'<light pos="{format_numbers(eye.tolist())}" dir="{format_numbers((-back).tolist())}"/>'
        f'<camera name="eye" pos="{format_numbers(eye.tolist())}" xyaxes="{axes}"/>'
        f'{"".join(geoms)}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.update_scene(data, camera='eye')
        image: Image = renderer.render().copy()
    return image
