"""The arm in MuJoCo: the same chain of links, with or without contacts of the engine's own."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
from multicontact_control.arrays import Vector
from multicontact_control.errors import ConfigError
import numpy as np
import pinocchio as pin
from sim_bridge.arm import (
    Arm,
    Body,
    format_numbers,
    make_isotropic,
    Placement,
    SENSOR_FRAME,
    TOOL_LINK,
)
from sim_bridge.config import PlantConfig, SurfaceConfig
from sim_bridge.engine_arm import EngineArm
from sim_bridge.posture import frame_pose

# Impedance of the engine's contacts. Beside the spring it makes a contact as heavy as
# d / (1 - d) of what it meets, so it is small; spring and damper are then set by solref.
IMPEDANCE = 0.01
PLANE_SIZE = '1 1 0.1'
TIP_RADIUS = 0.005  # m, of the balls at the tips
SMALLEST_FRICTION = 1e-6  # coefficient; the engine takes no 0
# How much harder friction holds than the surface presses: with less, a contact creeps.
FRICTION_RATIO = 100.0


class MujocoArm(EngineArm):
    """
    The arm in a MuJoCo world of its own, for a plant; see `EngineArm`.

    With native contacts the world also has the planes of the plant's surfaces, and the engine
    works out how hard the tips press on them.

    Parameters
    ----------
    arm
        Links, sensor and tool.
    config
        Gravity, integration step, and surfaces of native contacts.

    Raises
    ------
    ConfigError
        If a native contact is met by another link than a tip of the tool.

    """

    def __init__(self, arm: Arm, config: PlantConfig) -> None:
        super().__init__(len(arm.links))
        native = config.contact == 'native'
        self._planes: list[SurfaceConfig] = []
        if native:
            self._planes = _native_planes(arm, config)
        model = mujoco.MjModel.from_xml_string(compose_mjcf(arm, config, self._planes))
        self._model = model
        links = [f'link{number}' for number in range(1, len(arm.links) + 1)]
        names = [*links, SENSOR_FRAME, TOOL_LINK]
        for name, body in zip(names, arm.bodies, strict=True):
            # The compiler refuses those that break the triangle inequality.
            model.body(name).inertia[:] = body.inertia
        mujoco.mj_setConst(model, mujoco.MjData(model))
        self._data = mujoco.MjData(model)
        self._pushed_bodies = [model.body(name).id for name in (*links, TOOL_LINK)]
        if native:
            if config.drives == 'rigid':
                # The engine carries the rotors that are not behind springs.
                model.dof_armature[:] = arm.armature
            mujoco.mj_setConst(model, self._data)
            self._set_contact_springs()
            self.native_forces = np.zeros(len(self._planes))
        self._contact_force = np.zeros(6)

    def reset(self, q: Vector) -> None:
        """Place the arm at rest; see `EngineArm`."""
        super().reset(q)
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = q

    def apply_pushes(self, pushes: list[list[float]]) -> None:
        """Apply forces at points for one step; see `EngineArm`."""
        data = self._data
        # Places the links where they are now, instead of a step ago.
        mujoco.mj_kinematics(self._model, data)
        for *values, number in pushes:
            body = self._pushed_bodies[int(number)]
            force = np.array(values[:3])
            point = values[3:]
            data.xfrc_applied[body, :3] += force
            data.xfrc_applied[body, 3:] += np.cross(point - data.xipos[body], force)

    def step(self, torque: Vector) -> tuple[float, ...]:
        """Advance by one step and return what the arm exerts on the tool; see `EngineArm`."""
        data = self._data
        data.qfrc_applied[:] = torque
        mujoco.mj_step(self._model, data)
        data.xfrc_applied[:] = 0.0
        self.q[:] = data.qpos
        self.qd[:] = data.qvel
        if self.native_forces is not None:
            self._sum_contact_forces(self.native_forces)
        wrench: tuple[float, ...] = tuple(data.sensordata.tolist())
        return wrench

    def set_tool_mass(self, mass: float) -> None:
        """Change the mass of the tool; see `EngineArm`."""
        self._model.body_mass[self._pushed_bodies[-1]] = mass
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))

    def _sum_contact_forces(self, forces: Vector) -> None:
        """Fill `forces` with the normal force on each plane, shape (no,) [N]."""
        forces[:] = 0.0
        for number in range(self._data.ncon):
            contact = self._data.contact[number]
            mujoco.mj_contactForce(self._model, self._data, number, self._contact_force)
            plane = self._model.geom(int(contact.geom[0])).name
            forces[int(plane.removeprefix('plane'))] += self._contact_force[0]

    def _set_contact_springs(self) -> None:
        """
        Make the engine's contacts as stiff and damped as the surfaces are configured.

        Its force is (-b v - k r - a) / R with R = A (1 - d) / d, A the inverse mass it takes the
        contact for and d its impedance; solref is (-k d, -b d).
        """
        # Planes do not move: of the two bodies of a contact, only the tool has an inverse mass.
        inverse_mass = self._model.body_invweight0[self._pushed_bodies[-1], 0]
        scale = inverse_mass * (1.0 - IMPEDANCE)
        for number, plane in enumerate(self._planes):
            stiffness = -plane.stiffness * scale
            self._model.pair_solref[number] = (stiffness, -plane.damping * scale)


def _native_planes(arm: Arm, config: PlantConfig) -> list[SurfaceConfig]:
    """Return the surfaces that a plant meets; ConfigError unless tips of the tool meet them."""
    for name in config.met:
        link = config.surfaces[name].tip_link
        if link not in arm.tips:
            raise ConfigError(
                f'surfaces.{name}.tip_link',
                f'one of the tips {", ".join(sorted(arm.tips))} with native contacts',
                f"'{link}'",
            )
    return [config.surfaces[name] for name in config.met]


def compose_mjcf(arm: Arm, config: PlantConfig, planes: Sequence[SurfaceConfig]) -> str:
    """
    Return the text of MuJoCo's model (MJCF) of an arm, alone or before planes.

    Inertias are isotropic, since the compiler refuses some published ones: `MujocoArm` sets the
    true ones afterwards. Each tip carries a ball that touches its own plane only, with the point
    that is the tip itself in the home posture.
    """
    *link_bodies, face, tool = arm.bodies
    chain = []
    for number, (link, body) in enumerate(zip(arm.links, link_bodies), start=1):
        chain += [
            _body_opening(f'link{number}', link.placement, body),
            f'<joint name="{link.joint}" type="hinge" axis="0 0 1" limited="false"/>',
        ]
    chain += [
        _body_opening(SENSOR_FRAME, arm.sensor, face),
        f'<site name="{SENSOR_FRAME}"/>',
        _body_opening(TOOL_LINK, Placement(), tool),
    ]
    plane_geoms = []
    pairs = []
    if planes:
        to_world = frame_pose(arm.model(), np.array(config.home), SENSOR_FRAME).rotation
    for number, plane in enumerate(planes):
        inward = np.array(plane.normal_world)
        centre = arm.tips[plane.tip_link] - TIP_RADIUS * (to_world.T @ inward)
        place = format_numbers(plane.point_world)
        outward = format_numbers(-inward)
        mu = max(plane.friction, SMALLEST_FRICTION)
        plane_geoms.append(
            f'<geom name="plane{number}" type="plane" size="{PLANE_SIZE}" '
            f'pos="{place}" zaxis="{outward}" contype="0" conaffinity="0"/>'
        )
        chain.append(
            f'<geom name="tip{number}" type="sphere" size="{TIP_RADIUS!r}" '
            f'pos="{format_numbers(centre)}" contype="0" conaffinity="0" mass="0"/>'
        )
        pairs.append(
            f'<pair geom1="plane{number}" geom2="tip{number}" condim="3" '
            f'friction="{mu!r} {mu!r} 0 0 0" solref="-1 -1" '
            f'solimp="{IMPEDANCE!r} {IMPEDANCE!r} 0.001 0.5 1"/>'
        )
    elements = [
        f'<mujoco model="{arm.name}"><compiler angle="radian" autolimits="false"/>',
        _option_element(config, contacts=bool(planes)),
        '<worldbody>',
        *plane_geoms,
        *chain,
        '</body>' * len(arm.bodies),
        '</worldbody>',
        '<contact>',
        *pairs,
        '</contact>',
        f'<sensor><force site="{SENSOR_FRAME}"/><torque site="{SENSOR_FRAME}"/></sensor>',
        '</mujoco>',
    ]
    return ''.join(elements)


def _option_element(config: PlantConfig, *, contacts: bool) -> str:
    """Return the element with step, gravity and solver, and whether there are contacts."""
    flag = '<flag contact="disable" constraint="disable"/>'
    if contacts:
        flag = ''
    gravity = format_numbers(config.gravity_world)
    return (
        f'<option timestep="{config.substep!r}" gravity="{gravity}" integrator="Euler" '
        f'cone="elliptic" impratio="{FRICTION_RATIO!r}" solver="Newton" iterations="100" '
        f'tolerance="1e-12">{flag}</option>'
    )


def _body_opening(name: str, placement: Placement, body: Body) -> str:
    """Return the element that opens a body, with its inertia, and that leaves it open."""
    inertia = format_numbers(make_isotropic(body).inertia)
    return (
        f'<body name="{name}" {_frame_attributes(placement)}>'
        f'<inertial {_frame_attributes(body.com)} mass="{body.mass!r}" diaginertia="{inertia}"/>'
    )


def _frame_attributes(placement: Placement) -> str:
    x, y, z, w = pin.Quaternion(placement.transform.rotation).coeffs()
    position = format_numbers(placement.position)
    quaternion = format_numbers((w, x, y, z))
    return f'pos="{position}" quat="{quaternion}"'
