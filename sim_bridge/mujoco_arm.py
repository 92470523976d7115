"""The arm in MuJoCo: the same chain of links, with or without contacts of the engine's own."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
from multicontact_control.arrays import Vector
from multicontact_control.errors import ConfigError
import numpy as np
import pinocchio as pin
from sim_bridge.arm import Arm, Body, numbers, Placement, SENSOR_FRAME, TOOL_LINK
from sim_bridge.config import PlantConfig, SurfaceConfig
from sim_bridge.engine_arm import EngineArm
from sim_bridge.posture import frame_pose

# Impedance of the engine's contacts. Beside the spring it makes a contact as heavy as
# d / (1 - d) of what it meets, so it is small; spring and damper are then set by solref.
IMPEDANCE = 0.01
PLANE_SIZE = '1 1 0.1'
TIP_RADIUS = 0.005  # m, of the balls at the tips
FRICTION_RATIO = (
    100.0  # how much harder friction holds than the surface: else it creeps
)


class MujocoArm(EngineArm):
    """
    One arm alone in a MuJoCo world, or before planes of the engine's own; see `EngineArm`.

    Raises ConfigError if a native contact is met by another link than a tip.
    """

    def __init__(self, arm: Arm, config: PlantConfig) -> None:
        super().__init__(len(arm.links))
        native = config.contact == 'native'
        self._planes = _planes(arm, config) if native else []
        self._model = mujoco.MjModel.from_xml_string(
            mjcf_text(arm, config, self._planes)
        )
        names = [
            *(f'link{i + 1}' for i in range(len(arm.links))),
            SENSOR_FRAME,
            TOOL_LINK,
        ]
        for name, body in zip(names, arm.bodies, strict=True):
            # The compiler refuses those that break the triangle inequality.
            self._model.body(name).inertia[:] = body.inertia
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))
        self._data = mujoco.MjData(self._model)
        self._bodies = [
            self._model.body(name).id for name in names if name != SENSOR_FRAME
        ]
        if native:
            # Rotors that are not behind springs, which the engine then carries itself.
            self._model.dof_armature[:] = np.array(arm.armature) * (
                config.drives == 'rigid'
            )
            mujoco.mj_setConst(self._model, self._data)
            self._set_springs()
            self.native_forces = np.zeros(len(self._planes))
        self._touch = np.zeros(6)

    def reset(self, q: Vector) -> None:
        """Place the arm at rest; see `EngineArm`."""
        super().reset(q)
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = q

    def push(self, pushes: list[list[float]]) -> None:
        """Apply forces at points for one step; see `EngineArm`."""
        data = self._data
        mujoco.mj_kinematics(
            self._model, data
        )  # where the links are now, not a step ago
        for *values, number in pushes:
            link, force, point = (
                self._bodies[int(number)],
                np.array(values[:3]),
                values[3:],
            )
            data.xfrc_applied[link, :3] += force
            data.xfrc_applied[link, 3:] += np.cross(point - data.xipos[link], force)

    def step(self, torque: Vector) -> tuple[float, ...]:
        """Advance by one step and return what the arm exerts on the tool; see `EngineArm`."""
        model, data = self._model, self._data
        data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data)
        data.xfrc_applied[:] = 0.0
        self.q[:], self.qd[:] = data.qpos, data.qvel
        if self.native_forces is not None:
            self._read_contacts(self.native_forces)
        wrench: tuple[float, ...] = tuple(data.sensordata.tolist())
        return wrench

    def set_tool_mass(self, mass: float) -> None:
        """Change the mass of the tool; see `EngineArm`."""
        self._model.body_mass[self._bodies[-1]] = mass
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))

    def _read_contacts(self, forces: Vector) -> None:
        """Add up the normal forces on each plane."""
        forces[:] = 0.0
        for i in range(self._data.ncon):
            contact = self._data.contact[i]
            mujoco.mj_contactForce(self._model, self._data, i, self._touch)
            plane = self._model.geom(int(contact.geom[0])).name
            forces[int(plane.removeprefix('plane'))] += self._touch[0]

    def _set_springs(self) -> None:
        """
        Make the engine's contacts as stiff and damped as the surfaces are configured.

        Its force is (-b v - k r - a) / R with R = A (1 - d) / d, A the inverse mass it takes the
        contact for and d its impedance; solref is (-k d, -b d).
        """
        # Planes do not move: of the two bodies of a contact, only the tool has an inverse mass.
        scale = self._model.body_invweight0[self._bodies[-1], 0] * (1.0 - IMPEDANCE)
        for i, plane in enumerate(self._planes):
            self._model.pair_solref[i] = (
                -plane.stiffness * scale,
                -plane.damping * scale,
            )


def _planes(arm: Arm, config: PlantConfig) -> list[SurfaceConfig]:
    planes = []
    for name in config.met:
        surface = config.surfaces[name]
        if surface.tip_link not in arm.tips:
            raise ConfigError(
                f'surfaces.{name}.tip_link',
                f'one of the tips {", ".join(sorted(arm.tips))} with native contacts',
                f"'{surface.tip_link}'",
            )
        planes.append(surface)
    return planes


def mjcf_text(arm: Arm, config: PlantConfig, planes: Sequence[SurfaceConfig]) -> str:
    """Return the MJCF of an arm; with isotropic inertias, the true ones have to be set."""
    parts, end = [], []
    bodies = arm.bodies
    for number, (link, body) in enumerate(zip(arm.links, bodies), start=1):
        parts += [
            _body(f'link{number}', link.placement, body),
            f'<joint name="{link.joint}" type="hinge" axis="0 0 1" limited="false"/>',
        ]
        end.append('</body>')
    parts += [
        _body(SENSOR_FRAME, arm.sensor, bodies[-2]),
        f'<site name="{SENSOR_FRAME}"/>',
        _body(TOOL_LINK, Placement(), bodies[-1]),
    ]
    pairs = []
    if planes:
        # Each ball touches its plane with the tip itself at home.
        turn = frame_pose(arm.model(), np.array(config.home), SENSOR_FRAME).rotation
        for i, plane in enumerate(planes):
            centre = np.array(arm.tips[plane.tip_link]) - TIP_RADIUS * (
                turn.T @ np.array(plane.normal_world)
            )
            parts.append(
                f'<geom name="tip{i}" type="sphere" size="{TIP_RADIUS!r}" '
                f'pos="{numbers(centre)}" contype="0" conaffinity="0" mass="0"/>'
            )
            mu = max(plane.friction, 1e-6)
            pairs.append(
                f'<pair geom1="plane{i}" geom2="tip{i}" condim="3" '
                f'friction="{mu!r} {mu!r} 0 0 0" solref="-1 -1" '
                f'solimp="{IMPEDANCE!r} {IMPEDANCE!r} 0.001 0.5 1"/>'
            )
    end += ['</body>', '</body>']
    flag = '' if planes else '<flag contact="disable" constraint="disable"/>'
    geoms = [
        f'<geom name="plane{i}" type="plane" size="{PLANE_SIZE}" '
        f'pos="{numbers(plane.point_world)}" zaxis="{numbers(-x for x in plane.normal_world)}" '
        'contype="0" conaffinity="0"/>'
        for i, plane in enumerate(planes)
    ]
    return ''.join(
        [
            f'<mujoco model="{arm.name}"><compiler angle="radian" autolimits="false"/>',
            f'<option timestep="{config.substep!r}" gravity="{numbers(config.gravity_world)}" '
            f'integrator="Euler" '
            f'cone="elliptic" impratio="{FRICTION_RATIO!r}" solver="Newton" iterations="100" '
            f'tolerance="1e-12">{flag}</option>',
            '<worldbody>',
            *geoms,
            *parts,
            *end,
            '</worldbody>',
            '<contact>',
            *pairs,
            '</contact>',
            f'<sensor><force site="{SENSOR_FRAME}"/><torque site="{SENSOR_FRAME}"/></sensor>',
            '</mujoco>',
        ]
    )


def _body(name: str, placement: Placement, body: Body) -> str:
    """Return the beginning of a body."""
    inertia = numbers((max(body.inertia),) * 3)
    return (
        f'<body name="{name}" {_frame(placement)}>'
        f'<inertial {_frame(body.com)} mass="{body.mass!r}" diaginertia="{inertia}"/>'
    )


def _frame(placement: Placement) -> str:
    quaternion = pin.Quaternion(placement.se3.rotation)
    values = (quaternion.w, quaternion.x, quaternion.y, quaternion.z)
    return f'pos="{numbers(placement.position)}" quat="{numbers(values)}"'
