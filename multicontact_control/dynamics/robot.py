"""The rigid-body model of the arm; the only place that knows pinocchio."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
import sys
from typing import NamedTuple
import xml.etree.ElementTree as ElementTree

from multicontact_control.arrays import Mask, Matrix, require_shape, Vector
from multicontact_control.config import RobotConfig, ToolConfig
from multicontact_control.dynamics import known_arm, model_check
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.dynamics.terms import ModelTerms, TermTuple
from multicontact_control.dynamics.urdf import check_link_tree, parse_urdf
from multicontact_control.errors import ConfigError, PinocchioError
from multicontact_control.records import MAX_JOINTS
import numpy as np

INSTALL = (
    "pip install 'pin>=4.0,<5' (extra [pin] or [ros]), or, beside a native ROS 2 Jazzy, "
    'apt install ros-jazzy-pinocchio'
)
try:
    import pinocchio as pin
except ImportError as error:
    sys.tracebacklimit = 0  # a node's process ends with one line, as a command does
    raise PinocchioError(
        f'pinocchio cannot be loaded: {str(error).splitlines()[0]}; {INSTALL}'
    ) from None

POSTURES = 64  # in which gravity is compared with the torque limits
MEETING_AXES = 0.01  # m, between axes whose link may have no mass


@dataclass(frozen=True, slots=True)
class RobotState:
    """The terms of the model in arrays of its own, and what follows from them."""

    mass_matrix: Matrix  # M with armature, shape (n, n) [kg m^2]
    coriolis: Vector  # C(q, v) v, shape (n,) [N m]
    gravity: Vector  # g(q), shape (n,) [N m]
    jacobian: Matrix  # J of the operational point, shape (6, n)
    jacobian_drift: Vector  # dJ/dt v, shape (6,) [m/s^2, rad/s^2]
    pose: Pose  # of the operational frame
    twist_world: Vector  # J v, shape (6,) [m/s, rad/s]
    velocity: Vector  # v, shape (n,) [rad/s]
    sensor_pose: Pose


class RobotModel:
    """
    A fixed-base arm read from a URDF.

    Parameters
    ----------
    config
        Names and armature; without a wrist sensor, the operational frame is in its place.
    base_dir
        Folder that a relative ``config.urdf`` is relative to.

    Attributes
    ----------
    term_tuple
        The fields of `terms` in a plain tuple, which Python makes, and compiled code takes, in
        half the time of a named one.
    gravity
        g(q) where `compute` was called last, shape (n,) [N m].

    Raises
    ------
    ConfigError
        If the URDF cannot be read, a joint or frame name does not match it, or the wrist sensor
        does not feel what the operational frame touches.

    Attributes
    ----------
    terms
        What `compute` has found last, in pinocchio's memory.
    last_mass
        Mass of the links that the last joint carries, as the URDF has it [kg].
    turning
        Whether each joint turns, and does not slide, shape (n,).

    """

    def __init__(self, config: RobotConfig, base_dir: Path = Path()) -> None:
        self._warnings: list[str] = []
        self._adds_gravity = config.adds_gravity
        self._model = load_model(base_dir / config.urdf, config.locked, self._warnings)
        _require_joints(_list_joints(self._model), list(config.joint_names))
        if config.armature:
            self._model.armature = np.array(config.armature)
        self._model.gravity.linear = np.array(config.gravity_world)
        self._frame = self._find_frame(
            'robot.operational_frame', config.operational_frame
        )
        self._sensor = self._frame
        if config.sensor_frame:
            self._sensor = self._find_frame('robot.sensor_frame', config.sensor_frame)
            self._require_felt_contacts(config)
        self._mount = self._model.frames[self._sensor]
        self._body = pin.Inertia(self._model.inertias[self._mount.parentJoint])
        self.last_mass = float(self._body.mass)
        self._data = self._model.createData()
        self._view_terms()
        kinds = [joint.shortname() for joint in self._model.joints[1:]]
        self.turning: Mask = np.array(['ModelR' in kind for kind in kinds])

    def _view_terms(self) -> None:
        """Look at pinocchio's memory as terms, so that nothing needs to be copied."""
        data = self._data
        frame = data.oMf[self._frame]
        sensor = data.oMf[self._sensor]
        self.gravity: Vector = data.g
        self._joint_terms: tuple[Matrix, Vector, Vector] = (data.M, data.nle, data.g)
        self._placements: tuple[Vector, Matrix, Vector, Matrix] = (
            frame.translation,
            frame.rotation,
            sensor.translation,
            sensor.rotation,
        )
        unknown = np.zeros((6, self._model.nv))
        self.term_tuple: TermTuple = (
            *self._joint_terms,
            unknown,
            unknown,
            *self._placements,
        )

    @property
    def terms(self) -> ModelTerms:
        """
        Return the terms of the model where `compute` was called last.

        They are in pinocchio's memory, and so valid until the next call.
        """
        return ModelTerms(*self.term_tuple)

    @property
    def joint_count(self) -> int:
        """Return the number of joints n."""
        return int(self._model.nv)

    @property
    def torque_limit(self) -> Vector:
        """Return the largest torques by the URDF, infinite without, shape (n,) [N m]."""
        limit = np.array(self._model.effortLimit)
        return np.where(limit > 0.0, limit, np.inf)

    def list_warnings(self, torque_limit: Sequence[float] = ()) -> tuple[str, ...]:
        """
        Return what is suspicious of the model, a line each.

        Parameters
        ----------
        torque_limit
            Largest torques, shape (n,) [N m]; those of the URDF if none are given.

        Raises
        ------
        ConfigError
            If the arm cannot be held with these torques; see `check_torques`.

        """
        limit = self.torque_limit
        if torque_limit:
            limit = np.array(torque_limit)
        return (*self._warnings, *check_torques(self._model, limit, self._adds_gravity))

    def _require_felt_contacts(self, config: RobotConfig) -> None:
        """Refuse contacts that the wrist sensor cannot feel: those of a link before it."""
        model = self._model
        carrier = model.names[model.frames[self._frame].parentJoint]
        sensor_carrier = model.names[model.frames[self._sensor].parentJoint]
        if carrier != sensor_carrier:
            raise ConfigError(
                'robot.operational_frame',
                f'a link that is carried by {sensor_carrier}, as the wrist '
                f"sensor on '{config.sensor_frame}' is, which feels nothing else",
                f"'{config.operational_frame}', carried by {carrier}",
            )

    def _find_frame(self, field: str, name: str) -> int:
        """Return pinocchio's number of a link; ConfigError of the field if there is none."""
        links = []
        for frame in self._model.frames:
            if frame.type == pin.FrameType.BODY:
                links.append(frame.name)
        if name not in links:
            raise ConfigError(
                field, f'a link of the robot among {", ".join(links)}', f"'{name}'"
            )
        return int(self._model.getFrameId(name, pin.FrameType.BODY))

    def compute(self, q: Vector, v: Vector) -> None:
        """Work out `terms` and `gravity` at positions [rad] and velocities [rad/s], (n,)."""
        jacobians = _compute_terms(self._model, self._data, self._frame, q, v)
        self.term_tuple = (*self._joint_terms, *jacobians, *self._placements)

    def update(self, q: Vector, v: Vector) -> RobotState:
        """
        Return the arm's state in arrays of its own, which later calls leave as they are.

        Parameters
        ----------
        q, v
            Positions [rad] and velocities [rad/s], shape (n,).

        Raises
        ------
        ShapeError
            If positions or velocities are of another shape.

        """
        require_shape('q', q, (self._model.nv,))
        require_shape('v', v, (self._model.nv,))
        self.compute(q, v)
        terms = self.terms
        data = self._data
        upper = np.triu(terms.mass_matrix)
        gravity = self.gravity.copy()
        jacobian = np.ascontiguousarray(terms.jacobian)
        return RobotState(
            mass_matrix=upper + np.triu(upper, 1).T,
            coriolis=terms.bias_torque - gravity,
            gravity=gravity,
            jacobian=jacobian,
            jacobian_drift=terms.jacobian_rate @ v,
            pose=_copy_pose(data.oMf[self._frame]),
            twist_world=jacobian @ v,
            velocity=v.copy(),
            sensor_pose=_copy_pose(data.oMf[self._sensor]),
        )

    def compute_load_torque(self, load: ToolConfig) -> Vector:
        """Return what a load adds to g(q) where `compute` was called last, shape (n,) [N m]."""
        weight = load.mass * self._model.gravity.linear
        sensor = self._data.oMf[self._sensor]
        lever = sensor.rotation @ np.array(load.com_sensor)
        jacobian = pin.getFrameJacobian(
            self._model, self._data, self._sensor, pin.LOCAL_WORLD_ALIGNED
        )
        wrench = np.concatenate([weight, np.cross(lever, weight)])
        torque: Vector = -jacobian.T @ wrench
        return torque

    def compute_gravity_shares(self, q: Vector, load: ToolConfig) -> Matrix:
        """
        Return dg/d(gravity) of the arm without a load where `compute` was called last.

        g(q) is linear in the vector of gravity, so that unit vectors of gravity give the columns.

        Parameters
        ----------
        q
            Positions of that call, shape (n,) [rad].
        load
            Load that the model carries.

        Returns
        -------
        Matrix
            A column for each world axis, shape (n, 3) [N m per m/s^2].

        """
        model = self._model
        data = model.createData()
        gravity_before = model.gravity.linear.copy()
        columns = []
        for axis in np.eye(3):
            model.gravity.linear = axis
            torque = pin.computeGeneralizedGravity(model, data, q)
            columns.append(torque - self.compute_load_torque(load))
        model.gravity.linear = gravity_before
        return np.array(columns).T

    def carry_load(self, load: ToolConfig, in_urdf: ToolConfig) -> None:
        """Let the model carry a point mass on the sensor in place of one that its URDF has."""
        last_body = self._body
        if load != in_urdf:
            # Linear in mass, first and second moments.
            parameters = self._body.toDynamicParameters()
            parameters += self._point_mass(load)
            parameters += -1.0 * self._point_mass(in_urdf)
            last_body = pin.Inertia.FromDynamicParameters(parameters)
        self._model.inertias[self._mount.parentJoint] = last_body

    def _point_mass(self, load: ToolConfig) -> Vector:
        """Return pinocchio's dynamic parameters of a load on the sensor, shape (10,)."""
        inertia = pin.Inertia(load.mass, np.array(load.com_sensor), np.zeros((3, 3)))
        parameters: Vector = self._mount.placement.act(inertia).toDynamicParameters()
        return parameters

    def save_model(self) -> str:
        """
        Return the model as text that pinocchio of the same version loads, also in C++.

        Armature, gravity, locked joints and the load are in it.
        """
        text: str = self._model.saveToString()
        return text

    def compute_link_poses(self, q: Vector, links: Sequence[str]) -> list[Pose]:
        """Return the poses of links at positions, shape (n,) [rad]; ConfigError if unknown."""
        require_shape('q', q, (self._model.nv,))
        pin.framesForwardKinematics(self._model, self._data, q)
        frames = [self._find_frame('link', name) for name in links]
        return [_copy_pose(self._data.oMf[frame]) for frame in frames]


def _compute_terms(
    model: pin.Model, data: pin.Data, frame: int, q: Vector, v: Vector
) -> tuple[Matrix, Matrix]:
    """Return J and dJ/dt of a frame in world axes; M, C v + g and placements are in the data."""
    pin.computeAllTerms(model, data, q, v)
    pin.updateFramePlacements(model, data)
    axes = pin.LOCAL_WORLD_ALIGNED
    jacobian = pin.getFrameJacobian(model, data, frame, axes)
    jacobian_rate = pin.getFrameJacobianTimeVariation(model, data, frame, axes)
    return jacobian, jacobian_rate


@cache
def require_known_terms() -> None:
    """
    Compare what pinocchio computes for a known arm with numbers, once in a process.

    Raises
    ------
    PinocchioError
        With its version and what differs. Pinocchio 2 takes an armature without a word and leaves
        it out of M.

    """
    model = pin.buildModelFromXML(known_arm.URDF)
    model.armature = np.array(known_arm.ARMATURE)
    model.gravity.linear = np.array(known_arm.GRAVITY)
    data = model.createData()
    jacobian, jacobian_rate = _compute_terms(
        model,
        data,
        model.getFrameId(known_arm.TIP, pin.FrameType.BODY),
        known_arm.POSITIONS,
        known_arm.VELOCITIES,
    )
    found = {
        'M': np.triu(data.M),
        'C v + g': data.nle,
        'J': jacobian,
        'dJ/dt': jacobian_rate,
    }
    differences = known_arm.list_differences(found)
    if differences:
        raise PinocchioError(
            'pinocchio: expected the terms of a known arm, as versions 3 and 4 compute them, '
            f'got version {pin.__version__}: {", ".join(differences)}; {INSTALL}'
        )


def _list_joints(model: pin.Model) -> list[str]:
    """Return the names of the joints, without the world, which pinocchio counts as the first."""
    return list(model.names)[1:]


def _require_joints(names: list[str], configured: list[str]) -> None:
    """Check that an arm's joints are the configured ones, and not too many; ConfigError."""
    if names != configured:
        expected = f"the robot's joints {names}"
        others = [name for name in names if name not in configured]
        if others:
            expected = f'{expected}, or {others} in robot.locked_joints'
        raise ConfigError('robot.joint_names', expected, configured)
    if len(names) > MAX_JOINTS:
        raise ConfigError(
            'robot.joint_names',
            f'at most {MAX_JOINTS} joints',
            len(names),
            hint='lock others: robot.locked_joints',
        )


def load_model(
    urdf: Path | str,
    locked_joints: Mapping[str, float] | None = None,
    warnings: list[str] | None = None,
) -> pin.Model:
    """
    Read an arm from a URDF as its vendor ships it.

    Continuous joints are revolute ones without limits, so that each joint has one coordinate; a
    locked joint is rigid, also one that mimics another; a torque or speed limit that is missing
    is 0.

    Parameters
    ----------
    urdf
        Path of the file, or the text itself.
    locked_joints
        Positions of joints that are no part of the arm, by name, e.g. of a gripper [rad or m].
    warnings
        Gets a line for each suspicious figure.

    Raises
    ------
    ConfigError
        If the file cannot be read or is no URDF; if joints that are not locked have more than one
        coordinate or no motor of their own (`find_followers`); if a locked joint is unknown; or if
        figures are impossible (`model_check`).
    PinocchioError
        If pinocchio computes other terms than it should (`require_known_terms`).

    """
    require_known_terms()
    locked = dict(locked_joints or {})
    text: str | bytes
    try:
        if isinstance(urdf, Path):
            source = str(urdf)
            text = urdf.read_bytes()  # the XML names its encoding
        else:
            source = 'text'
            text = urdf
        root = _read_root(text, source)
        _remove_shapes(root)
        _refuse_followers(root, locked)
        axes = _read_axes(root)
        endless = _complete_limits(root)
        model = pin.buildModelFromXML(ElementTree.tostring(root, encoding='unicode'))
    except OSError as error:
        raise ConfigError(
            'robot.urdf', 'a readable URDF file', f'{source} ({error.strerror})'
        ) from None
    except (ValueError, RuntimeError) as error:
        reasons = ['not a URDF', *str(error).strip().splitlines()]
        raise ConfigError(
            'robot.urdf', 'a valid URDF', f'{source} ({reasons[-1]})'
        ) from None
    names = _list_joints(model)
    unknown = [name for name in locked if name not in names]
    if unknown:
        raise ConfigError(
            'robot.locked_joints', f'joints among {", ".join(names)}', unknown
        )
    if locked:
        model = _lock_joints(model, locked)
    if model.nq != model.nv:
        raise ConfigError('robot.urdf', 'joints with one coordinate each', source)
    for name in endless - set(locked):
        at = model.joints[model.getJointId(name)].idx_q
        model.lowerPositionLimit[at] = -np.inf
        model.upperPositionLimit[at] = np.inf
    suspicious = model_check.collect_warnings(_find_defects(model, axes))
    if warnings is not None:
        warnings.extend(suspicious)
    return model


def _read_root(text: str | bytes, source: str) -> ElementTree.Element:
    """Return the root element of a URDF that is one tree; ConfigError of `robot.urdf`."""
    try:
        root = parse_urdf(text)
        check_link_tree(root)
    except ConfigError as error:
        raise error.as_config_error(f'robot.{error.field}', source) from None
    return root


def _remove_shapes(root: ElementTree.Element) -> None:
    """Remove the shapes of links, seen or colliding, which are no part of the model."""
    for link in root.findall('link'):
        for name in ('visual', 'collision'):
            for shape in link.findall(name):
                link.remove(shape)


class Follower(NamedTuple):
    """
    The coupling of a joint that mimics another, to multiplier x leader + offset.

    Attributes
    ----------
    leader
        Name of the joint that it mimics.
    multiplier, offset
        Factor of the leader's position, and what is added [rad or m].

    """

    leader: str
    multiplier: float
    offset: float


def find_followers(root: ElementTree.Element) -> dict[str, Follower]:
    """
    Return the joints of a URDF that have no motor of their own, by name.

    A coupling of the mechanism moves them, which neither the model nor the law knows of.

    Raises
    ------
    ConfigError
        If a multiplier or an offset is no number.

    """
    followers = {}
    for joint in root.findall('joint'):
        mimic = joint.find('mimic')
        if mimic is None or joint.get('type') == 'fixed':
            continue
        name = joint.get('name', '')
        numbers: dict[str, float] = {}
        for key, default in (('multiplier', '1'), ('offset', '0')):
            text = mimic.get(key, default)
            try:
                numbers[key] = float(text)
            except ValueError:
                raise ConfigError(
                    f'robot.urdf.{name}.mimic.{key}', 'a number', f"'{text}'"
                ) from None
        followers[name] = Follower(mimic.get('joint', ''), **numbers)
    return followers


def _refuse_followers(root: ElementTree.Element, locked: Mapping[str, float]) -> None:
    """Refuse joints that mimic others, unless they are locked, by ConfigError with all."""
    errors = []
    for name, follower in find_followers(root).items():
        if name in locked:
            continue
        error = ConfigError(
            f'robot.urdf.{name}.mimic',
            'joints with a motor of their own',
            f'{name} follows {follower.leader}, no motor of its own',
            hint='list it in robot.locked_joints if it is no part of the arm',
        )
        errors.append(error)
    if errors:
        raise ConfigError.combine(errors)


def _read_axes(root: ElementTree.Element) -> dict[str, Vector]:
    """Return the axes of the joints of a URDF by name, shape (3,); x where it does not say."""
    axes = {}
    for joint in root.findall('joint'):
        axis = joint.find('axis')
        text = '1 0 0'
        if axis is not None:
            text = axis.get('xyz', text)
        name = joint.get('name', '')
        axes[name] = np.array(text.split(), dtype=float)
    return axes


def _complete_limits(root: ElementTree.Element) -> set[str]:
    """
    Give joints the limits they lack; return the names of those that turn without an end.

    A joint that mimics another is locked, and so independent: pinocchio's versions differ in what
    they make of the element.
    """
    endless = set()
    for joint in root.findall('joint'):
        for mimic in joint.findall('mimic'):
            joint.remove(mimic)
        limit = joint.find('limit')
        if limit is None:
            limit = ElementTree.SubElement(joint, 'limit')
        for missing in {'effort', 'velocity'} - set(limit.keys()):
            limit.set(missing, '0')
        if joint.get('type') == 'continuous':
            endless.add(joint.get('name', ''))
            joint.set('type', 'revolute')
            limit.attrib.update(lower='-1e30', upper='1e30')
    return endless


def _lock_joints(model: pin.Model, locked: Mapping[str, float]) -> pin.Model:
    """Return a model with joints at these positions made rigid."""
    posture = pin.neutral(model)
    for name, position in locked.items():
        joint = model.joints[model.getJointId(name)]
        if joint.nq != 1:
            raise ConfigError(
                'robot.locked_joints', 'joints with one coordinate each', f"'{name}'"
            )
        posture[joint.idx_q] = position
    # Pinocchio looks joints up among all frames, where a link may have the same name.
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            frame.name = f' {frame.name}'
    numbers = list(map(model.getJointId, locked))
    reduced = pin.buildReducedModel(model, numbers, posture)
    for frame in reduced.frames:
        frame.name = frame.name.strip()
    return reduced


def _find_defects(
    model: pin.Model, axes: Mapping[str, Vector]
) -> Iterator[model_check.Finding]:
    """Yield defects of the joints of an arm and of the bodies that they carry."""
    for joint in range(1, model.njoints):
        name = model.names[joint]
        yield from model_check.check_joint(
            name,
            axes[name],
            model.lowerPositionLimit[joint - 1],
            model.upperPositionLimit[joint - 1],
        )
        body = _join_links(model, joint)
        if body is not None:
            yield from model_check.check_body(body)


def _join_links(model: pin.Model, joint: int) -> model_check.Body | None:
    """Return the links that a joint carries; None of a massless link between axes that meet."""
    offsets = list(map(_measure_distance, model.jointPlacements))
    next_offsets = []
    for offset, parent in zip(offsets, model.parents):
        if parent == joint:
            next_offsets.append(offset)
    inertia = model.inertias[joint]
    if not inertia.mass and min(next_offsets, default=1.0) <= MEETING_AXES:
        return None
    frames = [frame for frame in model.frames if frame.parentJoint == joint]
    fixed = [frame for frame in frames if frame.inertia.mass]  # to the joint's own link
    fixed_masses = [frame.inertia.mass for frame in fixed]
    own_mass = inertia.mass - sum(fixed_masses)
    lengths = [_measure_distance(frame.placement) for frame in frames]
    lengths.append(offsets[joint])
    if next_offsets:
        lengths += next_offsets
    else:  # no joint follows: any length between the arm's joints may be that of the links
        lengths += offsets
    names = [frame.name for frame in (frames[1], *fixed)]
    return model_check.Body(
        name='+'.join(names),
        length=max(lengths),
        mass=inertia.mass,
        least_mass=min(own_mass, *fixed_masses, 0.0),
        com=inertia.lever,
        inertia=inertia.inertia,
    )


def _measure_distance(placement: pin.SE3) -> float:
    """Return how far a placement is from the frame that it is relative to [m]."""
    return float(np.linalg.norm(placement.translation))


def check_torques(
    model: pin.Model,
    limits: Vector,
    adds_gravity: bool = False,
) -> tuple[str, ...]:
    """
    Return what is suspicious of torque limits, a line each.

    Parameters
    ----------
    model
        The arm, of n joints.
    limits
        Largest torques, infinite where there is none, shape (n,) [N m].
    adds_gravity
        Whether the robot itself adds the torques of gravity, which then count for 0.

    Raises
    ------
    ConfigError
        If gravity is far beyond a limit, or nothing turns about an axis.

    """
    data = model.createData()
    inertias = [np.diag(pin.crba(model, data, q)) for q in _sample_postures(model)]
    least_inertias = np.min(inertias, axis=0)
    gravity = find_largest_gravity(model)
    if adds_gravity:
        gravity = np.zeros_like(gravity)
    masses = [inertia.mass for inertia in model.inertias]
    heaviest = int(np.argmax(masses))
    heaviest_body = f'{masses[heaviest]:.4g} kg on {model.names[heaviest]}'
    findings: list[model_check.Finding] = []
    for figures in zip(_list_joints(model), gravity, least_inertias, limits):
        load = model_check.JointLoad(*figures)
        findings += model_check.check_load(load, heaviest_body)
    return model_check.collect_warnings(findings)


def find_largest_gravity(model: pin.Model) -> Vector:
    """
    Return the largest torques of gravity in `POSTURES` postures, shape (n,) [N m].

    The postures are spread over the ranges of the joints at random, always the same ones: a motor
    that holds these torques holds the arm nearly everywhere.
    """
    data = model.createData()
    torques = []
    for q in _sample_postures(model):
        torques.append(pin.computeGeneralizedGravity(model, data, q))
    largest: Vector = np.abs(torques).max(axis=0)
    return largest


def _sample_postures(model: pin.Model) -> Matrix:
    """Return joint angles over the joints' ranges, shape (POSTURES, n) [rad]."""
    generator = np.random.default_rng(0)
    angles = generator.uniform(-np.pi, np.pi, (POSTURES, model.nq))
    return np.clip(angles, model.lowerPositionLimit, model.upperPositionLimit)


def _copy_pose(placement: pin.SE3) -> Pose:
    """Return a placement of pinocchio in arrays of its own."""
    return Pose(placement.translation.copy(), np.ascontiguousarray(placement.rotation))
