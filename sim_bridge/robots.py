"""
The robots: a file of config/robots becomes an arm, and parameters of its plants and controller.

The one place that knows where URDFs come from.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
import hashlib
from importlib import metadata
import os
from pathlib import Path
import tempfile
from typing import Any, NamedTuple

from multicontact_control.arrays import Vector
from multicontact_control.compiled import find_cache_folder
from multicontact_control.config import merge, read_parameters, read_yaml, validate
from multicontact_control.errors import ConfigError
from multicontact_control.paths import (
    find_config_folder,
    find_named_file,
    list_named_files,
)
import numpy as np
from sim_bridge.arm import Arm, OPERATIONAL_FRAME, SENSOR_FRAME
from sim_bridge.config import SurfaceConfig
from sim_bridge.posture import frame_jacobian, frame_pose, joint_limits
from sim_bridge.robot_file import RobotFile, WideContactConfig
from sim_bridge.urdf_arm import read_robot_arm

FOLDER = 'robots'
DEFAULT = 'puma'
SCHEME = 'package://'


class UrdfWheel(NamedTuple):
    """A Python wheel that brings URDFs."""

    distribution: str  # as pip calls it
    folder: str  # of the URDFs, where the wheel is installed


# By the name of the package in URDFs' addresses.
WHEELS = {
    'example-robot-data': UrdfWheel(
        'example-robot-data', 'cmeel.prefix/share/example-robot-data/robots'
    ),
    'franky_sim': UrdfWheel('franky-sim', 'franky_sim'),
    'pybullet_data': UrdfWheel('pybullet', 'pybullet_data'),
}
# Parts of the controller's file that belong to another arm.
PARTS_OF_ITS_ARM = (
    'robot',
    'tool',
    'contacts',
    'contact_names',
    'torque_limit',
    'friction',
)
# Where the tips of edges and faces are on them, in half lengths and half widths.
EDGE_OFFSETS = ((-1.0, 0.0), (1.0, 0.0))
FACE_OFFSETS = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
ENDLESS_RANGE = 1e3  # rad, which no run gets to
MODEL_STIFFNESS = 6000.0  # N/m, of a contact that says none
WIDE_FRICTION = 3.0  # N, that the controller allows for at an edge or face
TORQUE_RATE_SHARE = 0.4  # of the torque limit in one period
# Box around the operational point at home, of a robot whose file has none [m].
WORKSPACE_LOWER = (-0.6, -0.45, -0.4)
WORKSPACE_UPPER = (0.6, 0.4, 0.6)


@dataclass(frozen=True)
class Robot:
    """
    A robot of config/robots, or of a file: its arm, and the parameters that follow from it.

    Parameters of plants and controller are nested dictionaries, as the files in ``config/`` have
    them, which scenarios and a user's own files are then laid over.
    """

    name: str  # or path of the file
    file: RobotFile
    folder: Path  # that its paths are relative to

    @cached_property
    def arm(self) -> Arm:
        """Return the arm with its tool; ConfigError: the URDF does not fit, or lacks a limit."""
        file = self.file
        arm = read_robot_arm(find_urdf(file.urdf, self.folder), file)
        links = list(arm.links)
        for field, values in (
            ('armature', file.armature),
            ('viscous', file.viscous),
            ('coulomb_positive', file.coulomb),
            ('coulomb_negative', file.coulomb_negative or file.coulomb),
            ('torque_limit', file.torque_limit),
            ('speed_limit', file.speed_limit),
        ):
            for number, value in enumerate(values):
                given: dict[str, Any] = {field: value}
                links[number] = replace(links[number], **given)
        for field in ('torque_limit', 'speed_limit'):
            lacking = [link.joint for link in links if getattr(link, field) <= 0.0]
            if lacking:
                raise ConfigError(
                    field,
                    f'a value above 0, since the URDF has none, for {", ".join(lacking)}',
                    'nothing',
                    self.name,
                )
        return replace(arm, links=tuple(links))

    def find_elbow(self) -> tuple[str, Vector]:
        """
        Return where an obstacle meets the arm before the wrist sensor.

        It meets the elbow of most arms, link (n + 1) // 2. Of the two horizontal axes it is along
        that on which a force takes the largest share of a joint's torque limit, on the side of
        the base on which the elbow is.

        Returns
        -------
        link
            Name of the link.
        normal
            Unit normal into the obstacle's surface, world axes, shape (3,).

        """
        link = f'link{(len(self.arm.links) + 1) // 2}'
        model = self.arm.model()
        home = np.array(self.plant_values('')['home'])
        shares = frame_jacobian(model, home, link)[:3] / self.arm.torque_limit
        axis = int(np.argmax(np.abs(shares[:2]).max(axis=1)))
        normal = np.zeros(3)
        normal[axis] = 1.0
        if frame_pose(model, home, link).translation[axis] < 0.0:
            normal[axis] = -1.0
        return link, normal

    def plant_name(self, name: str) -> str:
        """Return a plant's own name: of an alias, or of the default one for ''; '' if unknown."""
        name = self.file.plant_aliases.get(name, name) or self.file.default_plant
        if name in self.file.plants:
            return name
        return ''

    def plant_values(self, name: str, contacts: Collection[str] = ()) -> dict[str, Any]:
        """
        Return the parameters of a plant.

        Parameters
        ----------
        name
            Of the plant, or an alias; '' for the default one.
        contacts
            Names of a scenario's contacts, among which those in `wide_contacts` get surfaces.

        """
        variant = self.file.plants[self.plant_name(name)]
        if variant.file:
            values = self._read_parameters(variant.file)
        else:
            values = self._derive_plant()
        values = merge(values, {**variant.plant, 'robot': self.name})
        for wide in contacts:
            if wide in self.file.wide_contacts:
                surfaces = self._derive_wide_surfaces(wide, values['surfaces'])
                values = merge(values, {'surfaces': surfaces})
        return values

    def controller_base(self, contacts: Collection[str] = ()) -> dict[str, Any]:
        """
        Return the controller's parameters, whatever the plant.

        `contacts` are names of a scenario's contacts, among which those in `wide_contacts` get
        parameters of their own.
        """
        file = self.file
        if file.controller_file:
            values = self._read_parameters(file.controller_file)
        else:
            values = self._derive_controller()
        values = merge(values, file.controller)
        for wide in contacts:
            if wide in file.wide_contacts:
                contact = self._derive_wide_contact(wide, values['contacts'])
                values = merge(values, {'contacts': {wide: contact}})
        return values

    def controller_special(self, plant: str) -> dict[str, Any]:
        """Return what the controller knows of a plant, to be laid over a preset."""
        variant = self.file.plants[self.plant_name(plant)]
        if not variant.controller_file:
            return merge({}, variant.controller)
        values = self._read_parameters(variant.controller_file)
        return merge(values, variant.controller)

    def urdf_dir(self) -> Path:
        """Return the folder that the controller's `robot.urdf` is relative to."""
        if self.file.controller_file:
            return self._find_file(self.file.controller_file).parent
        return _write_urdf(self.arm).parent

    def _find_file(self, name: str) -> Path:
        """Return a file that the robot's names: beside it, or in config/."""
        beside = self.folder / name
        if beside.is_file():
            return beside
        return find_config_folder() / name

    def _read_parameters(self, name: str) -> dict[str, Any]:
        return read_parameters(self._find_file(name))

    def _derive_wide_surfaces(
        self, name: str, surfaces: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Return the surface of each tip of an edge or face, which share its stiffness."""
        wide = self._require_wide_contact(name, surfaces)
        offsets = EDGE_OFFSETS if len(wide.tips) == 2 else FACE_OFFSETS
        shared = dict(surfaces[wide.like], contact=name)
        for key in ('stiffness', 'damping'):
            whole = shared.get(key, SurfaceConfig.model_fields[key].default)
            shared[key] = whole / len(wide.tips)
        return {
            tip: {**shared, 'tip_link': tip, 'offset': list(offset)}
            for tip, offset in zip(wide.tips, offsets)
        }

    def _derive_wide_contact(
        self, name: str, contacts: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Return an edge or face as the controller has it, from where its tips are."""
        wide = self._require_wide_contact(name, contacts)
        tips = np.array([self._tip_at_operational_point(tip) for tip in wide.tips])
        along = tips[1] - tips[0]
        length = np.linalg.norm(along)
        contact = dict(contacts[wide.like])
        # It touches at its ends alone, unlike an edge that is stiff everywhere.
        contact['couple_stiffness'] = contact.get('stiffness', MODEL_STIFFNESS)
        contact['type'] = 'edge'
        contact['point_operational'] = tips.mean(axis=0).tolist()
        contact['direction_operational'] = (along / length).tolist()
        contact['half_length'] = float(0.5 * length)
        contact['friction_std'] = WIDE_FRICTION
        if len(tips) == 4:
            contact['type'] = 'plane'
            contact['half_width'] = float(0.5 * np.linalg.norm(tips[2] - tips[1]))
        return contact

    def _require_wide_contact(
        self, name: str, contacts: Collection[str]
    ) -> WideContactConfig:
        """Return an edge or face; ConfigError if its tips, or a contact like it, are unknown."""
        wide = self.file.wide_contacts[name]
        for field, names, known in (
            ('tips', wide.tips, self.arm.tips),
            ('like', (wide.like,), contacts),
        ):
            unknown = set(names).difference(known)
            if unknown:
                raise ConfigError(
                    f'wide_contacts.{name}.{field}',
                    f'of {", ".join(known)}',
                    f"'{min(unknown)}'",
                    self.name,
                )
        return wide

    def _tip_at_operational_point(self, tip: str) -> Vector:
        """Return a tip in the operational frame, shape (3,) [m]."""
        arm = self.arm
        in_link = arm.sensor.transform.act(np.array(arm.tips[tip]))
        place: Vector = arm.operational.transform.actInv(in_link)
        return place

    def _derive_plant(self) -> dict[str, Any]:
        """Return a rigid plant, its surfaces before the tips at home."""
        model = self.arm.model()
        home = np.array(self.file.home)
        surfaces = {}
        for name, contact in self.file.contacts.items():
            tip = frame_pose(model, home, contact.tip).translation
            to_surface = contact.gap * np.array(contact.normal_world)
            surfaces[name] = {
                'tip_link': contact.tip,
                'normal_world': list(contact.normal_world),
                'point_world': (tip + to_surface).tolist(),
                'stiffness': contact.stiffness,
                'slip_speed': 0.01,
            }
        tips = [contact.tip for contact in self.file.contacts.values()]
        different_tips = list(dict.fromkeys(tips))
        return {
            'home': list(self.file.home),
            'drives': 'rigid',
            'joint_sensing': 'joint',
            'substep': 1e-3,
            'joint_friction_scale': 0.0,
            'contact_names': list(surfaces),
            'surfaces': surfaces,
            'tool_push_link': different_tips[-1],
        }

    def _derive_controller(self) -> dict[str, Any]:
        """Return controller.yaml with this arm in the place of its own."""
        arm = self.arm
        base = read_parameters(find_config_folder() / 'controller.yaml')
        contacts = {}
        for name, contact in self.file.contacts.items():
            point = self._tip_at_operational_point(contact.tip)
            contacts[name] = {
                'normal_world': list(contact.normal_world),
                'point_operational': point.tolist(),
                'stiffness': contact.stiffness,
            }
        derived_limits = self._derive_limits(float(base.get('rate', 500.0)))
        derived = {
            'robot': {
                'urdf': _write_urdf(arm).name,
                'joint_names': list(arm.joint_names),
                'armature': list(arm.armature),
                'operational_frame': OPERATIONAL_FRAME,
                'sensor_frame': SENSOR_FRAME,
            },
            'tool': {'mass': arm.carried_mass, 'com_sensor': list(arm.carried_com)},
            'contact_names': list(contacts),
            'contacts': contacts,
            'torque_limit': list(arm.torque_limit),
            'limits': {**base.get('limits', {}), **derived_limits},
        }
        kept = {
            key: value for key, value in base.items() if key not in PARTS_OF_ITS_ARM
        }
        return {**kept, **derived}

    def _derive_limits(self, rate: float) -> dict[str, list[float]]:
        """Return the limits of joints and workspace, for a control rate [Hz]."""
        arm = self.arm
        model = arm.model()
        lower, upper = joint_limits(model)
        home = frame_pose(model, np.array(self.file.home)).translation
        box_lower = home + WORKSPACE_LOWER
        box_upper = home + WORKSPACE_UPPER
        if self.file.workspace_lower:
            box_lower = np.array(self.file.workspace_lower)
        if self.file.workspace_upper:
            box_upper = np.array(self.file.workspace_upper)
        torque_rate = TORQUE_RATE_SHARE * rate
        finite_lower = np.maximum(lower, -ENDLESS_RANGE)
        finite_upper = np.minimum(upper, ENDLESS_RANGE)
        return {
            'joint_lower': finite_lower.tolist(),
            'joint_upper': finite_upper.tolist(),
            'joint_speed': [link.speed_limit for link in arm.links],
            'torque_rate': [torque_rate * limit for limit in arm.torque_limit],
            'workspace_lower': box_lower.tolist(),
            'workspace_upper': box_upper.tolist(),
        }


def robot_names() -> tuple[str, ...]:
    """Return the names of the robots, the default one first."""
    others = set(list_named_files(FOLDER)) - {DEFAULT}
    return (DEFAULT, *sorted(others))


def find_robot(name: str = DEFAULT) -> Robot:
    """
    Return a robot by its name, or of a user's own file by its path.

    ConfigError if there is none, or its file is not valid.
    """
    path = find_named_file('robot', FOLDER, name)
    names = {file: known for known, file in list_named_files(FOLDER).items()}
    robot_name = names.get(path, str(path.resolve()))
    return _read_robot(robot_name, path, path.stat().st_mtime_ns)


@lru_cache(maxsize=32)
def _read_robot(name: str, path: Path, _changed: int) -> Robot:
    """Read a robot, anew if its file has `_changed` [ns]."""
    file = validate(RobotFile, read_yaml(path), str(path))
    return Robot(name, file, path.resolve().parent)


def find_urdf(name: str, folder: Path) -> Path:
    """
    Return the file of a URDF; ConfigError if it is not there, with the wheel that brings it.

    Its name is ``package://NAME/...`` for one of a Python package, or a path relative to a folder.
    """
    path = folder / name
    if name.startswith(SCHEME):
        package, _, inside = name.removeprefix(SCHEME).partition('/')
        if package not in WHEELS:
            raise ConfigError(
                'urdf', f'a package among {", ".join(sorted(WHEELS))}', f"'{package}'"
            )
        wheel = WHEELS[package]
        try:
            installed = metadata.distribution(wheel.distribution)
            path = Path(str(installed.locate_file(wheel.folder)), inside)
        except metadata.PackageNotFoundError:
            path = Path()
        if not path.is_file():
            raise ConfigError(
                'urdf',
                f'the package {package}: pip install {wheel.distribution}',
                name,
            )
    if not path.is_file():
        raise ConfigError('urdf', 'a readable URDF file', path)
    return path


def _write_urdf(arm: Arm) -> Path:
    """Write the URDF of an arm where the same text is found again, and return its path."""
    stamp = hashlib.sha256(arm.urdf.encode()).hexdigest()[:16]
    cache = find_cache_folder() or Path(tempfile.gettempdir())
    path = cache / f'urdf-{stamp}' / f'{arm.name}.urdf'
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(f'.{os.getpid()}')  # others may write it, too
        unfinished.write_text(arm.urdf, encoding='utf-8')
        unfinished.replace(path)
    return path
