"""The entries of a file of config/robots: an arm, its tool, and how they are simulated."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from multicontact_control.config import Config, parameter, UnitVector3, Vector, Vector3
from multicontact_control.errors import ConfigError, format_count
from sim_bridge.arm import Body, Placement

# Entries with a value for each joint.
JOINT_VECTORS = (
    'home',
    'armature',
    'viscous',
    'coulomb',
    'coulomb_negative',
    'torque_limit',
    'speed_limit',
)


class RobotToolConfig(Config):
    """The tool beyond the wrist sensor, in the sensor's frame."""

    face_offset: float = parameter(
        ..., 'Operational point to sensor face, along its z.', unit='m'
    )
    face_mass: float = parameter(..., 'Mass of the face itself.', unit='kg', gt=0.0)
    mass: float = parameter(..., 'Mass of the tool.', unit='kg', gt=0.0)
    com: Vector3 = parameter(..., 'Centre of mass of the tool.', unit='m')
    inertia: Vector3 = parameter(..., 'Ixx, Iyy, Izz about the com.', unit='kg m^2')
    tips: dict[str, Vector3] = parameter(..., 'Bar tips by URDF link name.', unit='m')

    @property
    def body(self) -> Body:
        """Return its mass properties, in the sensor's frame."""
        return Body(self.mass, Placement(self.com), self.inertia)


class RobotContactConfig(Config):
    """A contact, and the simulated surface it meets from the home posture."""

    tip: str = parameter(..., 'Tip of the tool that touches.')
    normal_world: UnitVector3 = parameter(..., 'Unit surface normal INTO the surface.')
    gap: float = parameter(
        0.007, 'From the tip at home to the simulated surface.', unit='m', gt=0.0
    )
    stiffness: float = parameter(
        6000.0,
        'Contact stiffness, of the surface and of its model.',
        unit='N/m',
        gt=0.0,
    )


class WideContactConfig(Config):
    """
    An edge or a face of the tool, for scenarios that press with it.

    All else follows from where its tips are: the middle, direction and size of the contact.
    """

    like: str = parameter(
        ..., 'Contact whose surface it meets, in the place of its tip.'
    )
    tips: tuple[str, ...] = parameter(
        ...,
        'Tips of the tool at both ends of the edge, or at the corners of the face, one after '
        'another in the sense of a screw that goes into the surface.',
    )


class PlantVariant(Config):
    """One way to simulate a robot, and what the controller then knows of it."""

    file: str = parameter(
        '', 'Parameter file of the whole plant; empty for what follows from the robot.'
    )
    plant: dict[str, Any] = parameter({}, 'Values laid over that.')
    controller_file: str = parameter(
        '', "Parameter file laid over the controller's; or none."
    )
    controller: dict[str, Any] = parameter({}, "Values laid over the controller's.")


class RobotFile(Config):
    """
    An arm with a wrist sensor and a tool, and how it is simulated and controlled.

    What can be derived from arm and home is: the limits, the contacts' points, the simulated
    surfaces, what the sensor weighs.
    """

    urdf: str = parameter(
        ...,
        'URDF: package://NAME/... for one that comes with a Python package, or a path, '
        'relative to this file.',
    )
    joint_names: tuple[str, ...] = parameter(..., 'Joints of the arm, base to wrist.')
    locked_joints: tuple[str, ...] = parameter((), 'All other joints of the URDF.')
    locked_positions: Vector = parameter(
        (), 'Where each of them is; empty for 0.', unit='rad or m'
    )
    mount_link: str = parameter(
        '',
        'URDF link that carries the wrist sensor; empty for a URDF that has the links ft_face '
        '(sensor), tool, wrist_point (operational point) and tips, as `new-robot` writes it.',
    )
    mount_rpy: Vector3 = parameter(
        (0.0, 0.0, 0.0),
        'Axes of operational point and sensor in that link.',
        unit='rad',
    )
    tool: RobotToolConfig | None = parameter(
        None,
        'Our tool, instead of all that the URDF has beyond mount_link; none for that.',
    )
    tip_links: dict[str, str] = parameter(
        {},
        'Of a tool in the URDF, the links that may touch, each under the name of its tip.',
    )
    home: Vector = parameter(
        (), 'Joint angles at the start, the tool at the surfaces.', unit='rad'
    )
    armature: Vector = parameter(
        (), 'Rotor inertia at each joint; empty for none.', unit='kg m^2'
    )
    viscous: Vector = parameter(
        (), 'Viscous friction of each joint; empty for none.', unit='N m s/rad'
    )
    coulomb: Vector = parameter(
        (), 'Coulomb friction of each joint; empty for none.', unit='N m'
    )
    coulomb_negative: Vector = parameter(
        (), 'That at negative speed; empty for the same.', unit='N m'
    )
    torque_limit: Vector = parameter(
        (), "Largest joint torque; empty for the URDF's.", unit='N m'
    )
    speed_limit: Vector = parameter(
        (), "Largest joint speed; empty for the URDF's.", unit='rad/s'
    )
    workspace_lower: Vector = parameter(
        (),
        'Lower corner of the box that the operational point reaches with the tool as at home, '
        'as `new-robot` finds it; empty for a box around home.',
        unit='m',
    )
    workspace_upper: Vector = parameter((), 'Upper corner of that box.', unit='m')
    contacts: dict[str, RobotContactConfig] = parameter({}, 'Contacts, in their order.')
    wide_contacts: dict[str, WideContactConfig] = parameter(
        {},
        'Edges and faces of the tool, which scenarios may name among their contacts.',
    )
    controller_file: str = parameter(
        '', "The controller's parameter file; empty for what follows from the robot."
    )
    controller: dict[str, Any] = parameter({}, 'Values laid over that, on every plant.')
    plants: dict[str, PlantVariant] = parameter(
        {'rigid': PlantVariant()}, 'Ways to simulate it.', min_length=1
    )
    plant_aliases: dict[str, str] = parameter({}, 'Other names of these.')
    default_plant: str = parameter('rigid', 'Which of them is taken if none is named.')

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        if not self.controller_file:
            for name in ('home', 'contacts'):
                if not getattr(self, name):
                    yield ConfigError(
                        name, 'a value, without a controller_file', 'nothing'
                    )
        counts = dict.fromkeys(JOINT_VECTORS, len(self.joint_names))
        counts['locked_positions'] = len(self.locked_joints)
        for name, count in counts.items():
            given = len(getattr(self, name))
            if given not in (0, count):
                expected = f'{format_count(count, "values")}, one per joint'
                yield ConfigError(name, expected, given)
        tips = tuple(self.tip_links)
        if self.tool is not None:
            tips = tuple(self.tool.tips)
            if self.tip_links:
                yield ConfigError('tip_links', hint='leave it out with `tool`')
        for name, contact in self.contacts.items():
            if contact.tip not in tips:
                yield ConfigError(
                    f'contacts.{name}.tip',
                    f'one of {", ".join(tips)}',
                    f"'{contact.tip}'",
                )
        for name, wide in self.wide_contacts.items():
            if len(wide.tips) not in (2, 4):
                yield ConfigError(
                    f'wide_contacts.{name}.tips', '2 ends or 4 corners', len(wide.tips)
                )
        for name in (self.default_plant, *self.plant_aliases.values()):
            if name not in self.plants:
                yield ConfigError('plants', f"'{name}' among them", list(self.plants))

    @property
    def locked(self) -> dict[str, float]:
        """Positions of the locked joints by name, 0 where the file has none [rad or m]."""
        locked = dict.fromkeys(self.locked_joints, 0.0)
        locked.update(zip(self.locked_joints, self.locked_positions))
        return locked
