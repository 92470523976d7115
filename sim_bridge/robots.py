"""
The robots: a file of config/robots becomes an arm, and parameters of its plants and controller.

The one place that knows where URDFs come from.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
import hashlib
from importlib.util import find_spec
import os
from pathlib import Path
import sys
import tempfile
from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.compiled import find_cache_folder
from multicontact_control.config import merge, read_parameters, read_yaml, validate
from multicontact_control.errors import ConfigError
from multicontact_control.paths import find_config_folder, find_named_file
import numpy as np
from sim_bridge.arm import Arm, OPERATIONAL_FRAME, SENSOR_FRAME
from sim_bridge.config import SurfaceConfig
from sim_bridge.posture import frame_jacobian, frame_pose, joint_limits
from sim_bridge.robot_file import RobotFile, WideContactConfig
from sim_bridge.urdf_arm import read_robot_arm

FOLDER = 'robots'
DEFAULT = 'puma'
SCHEME = 'package://'
# Python wheels with URDFs, by package.
WHEELS = {
    'example-robot-data': 'example-robot-data',
    'franky_sim': 'franky-sim',
    'pybullet_data': 'pybullet',
}
SHARED = Path('share') / 'example-robot-data' / 'robots'
# Of the controller's file, what belongs to another arm.
OF_THE_ARM = ('robot', 'tool', 'contacts', 'contact_names', 'torque_limit', 'friction')
# Where the tips of edges and faces are on them, in half lengths and half widths.
EDGE = ((-1.0, 0.0), (1.0, 0.0))
FACE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
RANGE_OF_CONTINUOUS = 1e3  # rad, which no run gets to
WIDE_FRICTION = 3.0  # N, that the controller allows for at an edge or face
TORQUE_RATE_SHARE = 0.4  # of the torque limit in one period
WORKSPACE = (
    (-0.6, -0.45, -0.4),
    (0.6, 0.4, 0.6),
)  # m, around the operational point at home


@dataclass(frozen=True)
class Robot:
    """A robot of config/robots, or of a file."""

    name: str  # or path of the file
    file: RobotFile
    folder: Path  # that its paths are relative to

    @cached_property
    def arm(self) -> Arm:
        """Return the arm with its tool."""
        file = self.file
        arm = read_robot_arm(urdf_path(file.urdf, self.folder), file)
        none = (0.0,) * len(arm.links)
        given = zip(
            arm.links,
            file.armature or none,
            file.viscous or none,
            file.coulomb or none,
            file.coulomb_negative or file.coulomb or none,
            file.torque_limit or arm.torque_limit,
            file.speed_limit or [link.speed_limit for link in arm.links],
        )
        links = tuple(
            replace(
                link,
                armature=armature,
                viscous=viscous,
                coulomb_positive=positive,
                coulomb_negative=negative,
                torque_limit=torque,
                speed_limit=speed,
            )
            for link, armature, viscous, positive, negative, torque, speed in given
        )
        for name in ('torque_limit', 'speed_limit'):
            if lacking := [link.joint for link in links if getattr(link, name) <= 0.0]:
                raise ConfigError(
                    name,
                    'a value above 0, since the URDF has none, for '
                    f'{", ".join(lacking)}',
                    'nothing',
                    self.name,
                )
        return replace(arm, links=links)

    def elbow(self) -> tuple[str, Vector]:
        """
        Return the link of an obstacle before the wrist sensor, and the normal into its surface.

        The elbow of most arms, link (n + 1) // 2, and of the two horizontal axes that along which
        a force there takes the largest share of a joint's torque limit, shape (3,); the obstacle
        is on the side of the base on which the elbow is.
        """
        link = f'link{(len(self.arm.links) + 1) // 2}'
        model, home = self.arm.model(), np.array(self.plant_values('')['home'])
        torques = frame_jacobian(model, home, link)[:3] / self.arm.torque_limit
        axis = int(np.argmax(np.abs(torques[:2]).max(axis=1)))
        normal = np.zeros(3)
        normal[axis] = np.sign(frame_pose(model, home, link).translation[axis]) or 1.0
        return link, normal

    def plant_name(self, name: str) -> str:
        """Return the name of a plant, the default one for none, aliases resolved, '' if none."""
        name = self.file.plant_aliases.get(name, name) or self.file.default_plant
        return name if name in self.file.plants else ''

    def plant_values(self, name: str, contacts: Collection[str] = ()) -> dict[str, Any]:
        """Return the parameters of a plant, with some of `wide_contacts`."""
        variant = self.file.plants[self.plant_name(name)]
        base = self._parameters(variant.file) if variant.file else self._derived_plant()
        values = merge(base, {**variant.plant, 'robot': self.name})
        for wide in contacts:
            if wide in self.file.wide_contacts:
                values = merge(values, {'surfaces': self._wide_surfaces(wide, values)})
        return values

    def controller_base(self, contacts: Collection[str] = ()) -> dict[str, Any]:
        """Return the controller's parameters, whatever the plant, with some `wide_contacts`."""
        file = self.file
        base = (
            self._parameters(file.controller_file)
            if file.controller_file
            else (self._derived_controller())
        )
        values = merge(base, file.controller)
        for wide in contacts:
            if wide in file.wide_contacts:
                values = merge(
                    values, {'contacts': {wide: self._wide_contact(wide, values)}}
                )
        return values

    def _wide_surfaces(self, name: str, plant: Mapping[str, Any]) -> dict[str, Any]:
        """Return the surface of each tip of an edge or face, which share its stiffness."""
        wide = self._wide(name, plant['surfaces'])
        like = plant['surfaces'][wide.like]
        shared = {
            key: like.get(key, SurfaceConfig.model_fields[key].default) / len(wide.tips)
            for key in ('stiffness', 'damping')
        }
        return {
            tip: {
                **like,
                **shared,
                'tip_link': tip,
                'contact': name,
                'offset': list(offset),
            }
            for tip, offset in zip(wide.tips, EDGE if len(wide.tips) == 2 else FACE)
        }

    def _wide_contact(self, name: str, controller: Mapping[str, Any]) -> dict[str, Any]:
        """Return an edge or face as the controller has it, from where its tips are."""
        wide = self._wide(name, controller['contacts'])
        like = controller['contacts'][wide.like]
        to_operational = (
            self.arm.operational.transform.inverse() * self.arm.sensor.transform
        )
        tips = np.array(
            [to_operational.act(np.array(self.arm.tips[tip])) for tip in wide.tips]
        )
        length = np.linalg.norm(tips[1] - tips[0])
        size = (
            {}
            if len(tips) == 2
            else {'half_width': float(0.5 * np.linalg.norm(tips[2] - tips[1]))}
        )
        return {
            **like,
            'type': 'edge' if len(tips) == 2 else 'plane',
            'point_operational': tips.mean(axis=0).tolist(),
            'direction_operational': ((tips[1] - tips[0]) / length).tolist(),
            'half_length': float(0.5 * length),
            **size,
            # It touches at its ends alone, unlike an edge that is stiff everywhere.
            'couple_stiffness': like.get('stiffness', 6000.0),
            'friction_std': WIDE_FRICTION,
        }

    def _wide(self, name: str, contacts: Mapping[str, Any]) -> WideContactConfig:
        wide = self.file.wide_contacts[name]
        for field, names, known in (
            ('tips', wide.tips, self.arm.tips),
            ('like', (wide.like,), contacts),
        ):
            if unknown := set(names).difference(known):
                raise ConfigError(
                    f'wide_contacts.{name}.{field}',
                    f'of {", ".join(known)}',
                    f"'{min(unknown)}'",
                    self.name,
                )
        return wide

    def controller_special(self, plant: str) -> dict[str, Any]:
        """Return what the controller knows of a plant; laid over a preset."""
        variant = self.file.plants[self.plant_name(plant)]
        given = (
            self._parameters(variant.controller_file) if variant.controller_file else {}
        )
        return merge(given, variant.controller)

    def urdf_dir(self) -> Path:
        """Return the folder that the controller's `robot.urdf` is relative to."""
        file = self.file.controller_file
        return (self._path(file) if file else _urdf_file(self.arm)).parent

    def _path(self, name: str) -> Path:
        """Return a file that the robot's names: beside it, or in config/."""
        beside = self.folder / name
        return beside if beside.is_file() else find_config_folder() / name

    def _parameters(self, name: str) -> dict[str, Any]:
        return read_parameters(self._path(name))

    def _derived_plant(self) -> dict[str, Any]:
        """Return a rigid plant, its surfaces before the tips at home."""
        model, home = self.arm.model(), np.array(self.file.home)
        surfaces = {}
        for name, contact in self.file.contacts.items():
            tip, normal = (
                frame_pose(model, home, contact.tip).translation,
                contact.normal_world,
            )
            surfaces[name] = {
                'tip_link': contact.tip,
                'normal_world': list(normal),
                'point_world': (tip + contact.gap * np.array(normal)).tolist(),
                'stiffness': contact.stiffness,
                'slip_speed': 0.01,
            }
        tips = list(
            dict.fromkeys(contact.tip for contact in self.file.contacts.values())
        )
        return {
            'home': list(self.file.home),
            'drives': 'rigid',
            'joint_sensing': 'joint',
            'substep': 1e-3,
            'joint_friction_scale': 0.0,
            'contact_names': list(surfaces),
            'surfaces': surfaces,
            'tool_push_link': tips[-1],
        }

    def _derived_controller(self) -> dict[str, Any]:
        """Return controller.yaml with this arm in the place of its own."""
        arm, file = self.arm, self.file
        base = read_parameters(find_config_folder() / 'controller.yaml')
        rate, limits = float(base.get('rate', 500.0)), base.get('limits', {})
        model = arm.model()
        home = frame_pose(model, np.array(file.home)).translation
        operational, sensor = arm.operational.transform, arm.sensor.transform
        points = {
            name: operational.actInv(
                sensor.act(np.array(arm.tips[contact.tip]))
            ).tolist()
            for name, contact in file.contacts.items()
        }
        lower, upper = (
            np.clip(limit, -RANGE_OF_CONTINUOUS, RANGE_OF_CONTINUOUS).tolist()
            for limit in joint_limits(model)
        )
        derived = {
            'robot': {
                'urdf': _urdf_file(arm).name,
                'joint_names': list(arm.joint_names),
                'armature': list(arm.armature),
                'operational_frame': OPERATIONAL_FRAME,
                'sensor_frame': SENSOR_FRAME,
            },
            'tool': {'mass': arm.carried_mass, 'com_sensor': list(arm.carried_com)},
            'contact_names': list(file.contacts),
            'contacts': {
                name: {
                    'normal_world': list(contact.normal_world),
                    'point_operational': points[name],
                    'stiffness': contact.stiffness,
                }
                for name, contact in file.contacts.items()
            },
            'torque_limit': list(arm.torque_limit),
            'limits': {
                **limits,
                'joint_lower': lower,
                'joint_upper': upper,
                'joint_speed': [link.speed_limit for link in arm.links],
                'torque_rate': [
                    TORQUE_RATE_SHARE * rate * limit for limit in arm.torque_limit
                ],
                'workspace_lower': list(file.workspace_lower)
                or (home + WORKSPACE[0]).tolist(),
                'workspace_upper': list(file.workspace_upper)
                or (home + WORKSPACE[1]).tolist(),
            },
        }
        kept = {key: value for key, value in base.items() if key not in OF_THE_ARM}
        return {**kept, **derived}


def robot_names() -> tuple[str, ...]:
    """Return the names of the robots that come with the package, the default one first."""
    names = sorted(path.stem for path in (find_config_folder() / FOLDER).glob('*.yaml'))
    return tuple(sorted(names, key=lambda name: name != DEFAULT))


def find_robot(name: str = DEFAULT) -> Robot:
    """Return a robot of config/robots, or of the file at a path; ConfigError."""
    path = find_named_file('robot', FOLDER, name)
    known = path.parent == find_config_folder() / FOLDER
    return _robot(
        path.stem if known else str(path.resolve()), path, path.stat().st_mtime_ns
    )


@lru_cache(maxsize=32)
def _robot(name: str, path: Path, _changed: int) -> Robot:
    return Robot(
        name, validate(RobotFile, read_yaml(path), str(path)), path.resolve().parent
    )


def urdf_path(name: str, folder: Path) -> Path:
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
        path = (_package_folder(package) or Path()) / inside
        if not path.is_file():
            raise ConfigError(
                'urdf', f'the package {package}: pip install {WHEELS[package]}', name
            )
    if not path.is_file():
        raise ConfigError('urdf', 'a readable URDF file', path)
    return path


def _package_folder(package: str) -> Path | None:
    """Return where the URDFs of a package are, None if it is not installed."""
    if package == 'example-robot-data':  # its wheel has no module
        prefixes = [
            *(f'{path}/cmeel.prefix' for path in sys.path),
            sys.prefix,
            *filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)),
        ]
        folders = [Path(prefix) / SHARED for prefix in prefixes]
    else:
        spec = find_spec(package)
        places = None if spec is None else spec.submodule_search_locations
        folders = [Path(place) for place in places or ()]
    return next((folder for folder in folders if folder.is_dir()), None)


def _urdf_file(arm: Arm) -> Path:
    """Write the URDF of an arm where the same text is found again, and return its path."""
    stamp = hashlib.sha256(arm.urdf.encode()).hexdigest()[:16]
    folder = (find_cache_folder() or Path(tempfile.gettempdir())) / f'urdf-{stamp}'
    path = folder / f'{arm.name}.urdf'
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(f'.{os.getpid()}')  # others may write it, too
        unfinished.write_text(arm.urdf, encoding='utf-8')
        unfinished.replace(path)
    return path
