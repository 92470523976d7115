"""Where each link of a URDF is with respect to its parent, as /tf says it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
import xml.etree.ElementTree as ElementTree

from multicontact_control.errors import ConfigError
import numpy as np

TURNING, SLIDING, FIXED = ('revolute', 'continuous'), ('prismatic',), ('fixed',)

Quaternion = tuple[float, float, float, float]
Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class LinkTransform:
    """
    Pose of a link in its parent's frame.

    Attributes
    ----------
    parent, child
        Names of the links.
    translation
        Origin of the child [m].
    quaternion_xyzw
        Its orientation, scalar last.

    """

    parent: str
    child: str
    translation: Vector3
    quaternion_xyzw: Quaternion


@dataclass(frozen=True, slots=True)
class _Joint:
    name: str
    kind: str
    origin: LinkTransform
    axis: Vector3
    slide: Vector3

    def at(self, position: float) -> LinkTransform:
        origin = self.origin
        if self.kind in FIXED:
            return origin
        if self.kind in SLIDING:
            x, y, z = (a + position * b for a, b in zip(origin.translation, self.slide))
            return LinkTransform(origin.parent, origin.child, (x, y, z), origin.quaternion_xyzw)
        sine = math.sin(0.5 * position)
        x, y, z = (sine * a for a in self.axis)
        turn = (x, y, z, math.cos(0.5 * position))
        return LinkTransform(origin.parent, origin.child, origin.translation,
                             _product(origin.quaternion_xyzw, turn))


class LinkTransforms:
    """
    The joints of a robot, ready to be evaluated many times a second.

    Parameters
    ----------
    urdf
        Text of the URDF.
    world_frame
        Name of the frame that the root link stands in; empty for none. It coincides with the
        root, which is where the controller has the world.

    Raises
    ------
    ConfigError
        If the text is not a URDF or has a joint that is neither turning, sliding nor fixed.

    """

    def __init__(self, urdf: str, world_frame: str = '') -> None:
        try:
            root = ElementTree.fromstring(urdf)
        except ElementTree.ParseError as error:
            raise ConfigError('robot_description', 'a URDF', str(error)) from None
        self._joints = [_read_joint(element) for element in root.iter('joint')
                        if element.find('parent') is not None]
        children = {joint.origin.child for joint in self._joints}
        roots = [name for name in (x.get('name', '') for x in root.iter('link'))
                 if name not in children]
        self._fixed = [
            LinkTransform(world_frame, name, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
            for name in roots if world_frame and name != world_frame]

    def at(self, positions: Mapping[str, float]) -> list[LinkTransform]:
        """
        Return the pose of every link whose joint is known.

        Parameters
        ----------
        positions
            Position by joint name [rad or m]; one that is not finite is not known.

        """
        moved = [joint.at(positions.get(joint.name, 0.0)) for joint in self._joints
                 if joint.kind in FIXED or math.isfinite(positions.get(joint.name, math.nan))]
        return [*self._fixed, *moved]


def _read_joint(element: ElementTree.Element) -> _Joint:
    # Only now: the recorder is up 0.2 s earlier, before there is a description.
    from scipy.spatial.transform import Rotation

    name, kind = element.get('name', ''), element.get('type', '')
    if kind not in (*TURNING, *SLIDING, *FIXED):
        raise ConfigError(
            'robot_description', 'joints that turn, slide or are fixed', f'{name}: {kind}')
    rotation = Rotation.from_euler('xyz', _numbers(element, 'origin', 'rpy', (0.0, 0.0, 0.0)))
    axis = np.array(_numbers(element, 'axis', 'xyz', (1.0, 0.0, 0.0)))
    axis = axis / (np.linalg.norm(axis) or 1.0)
    slide, unit = (rotation.apply(axis)).tolist(), axis.tolist()
    x, y, z, w = rotation.as_quat().tolist()
    origin = LinkTransform(
        _link(element, 'parent'), _link(element, 'child'),
        _numbers(element, 'origin', 'xyz', (0.0, 0.0, 0.0)), (x, y, z, w))
    return _Joint(name, kind, origin, (unit[0], unit[1], unit[2]), (slide[0], slide[1], slide[2]))


def _link(element: ElementTree.Element, role: str) -> str:
    found = element.find(role)
    return '' if found is None else found.get('link', '')


def _numbers(element: ElementTree.Element, tag: str, key: str, default: Vector3) -> Vector3:
    found = element.find(tag)
    text = None if found is None else found.get(key)
    if text is None:
        return default
    try:
        x, y, z = (float(part) for part in text.split())
    except ValueError:
        raise ConfigError('robot_description', 'three numbers', f"{tag} {key} '{text}'") from None
    return x, y, z


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation b followed, in the outer frame, by a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz)
