"""
The push test: a user proves sign, frame and scale of the wrist sensor before force is controlled.

A hand that pushes the tool along d with force F makes a right sensor read -F d, what the robot
does to the hand. A fit f_i = s Q e_i of the measured forces to the expected names what is wrong;
the decision is stricter: every push has to be read along its own direction, as large as it is.
The moments m_i = p x f_i give the point p of the pushes, which has to be where the tool is pushed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import math
from typing import Literal, NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import Config, cross_check, parameter, Real, ToolConfig
from multicontact_control.contact.wrench import contact_wrench
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ConfigError
import numpy as np
from scipy.spatial.transform import Rotation

NEEDED = 'force control is disabled until ~/push_test has passed'

DETECT_FORCE = 2.0  # N, change of force that begins a push
RELEASE_FORCE = 1.0  # N, change of force below which a push is over
MAX_ANGLE = 0.35  # rad between a push and its reading; a hand is good for 0.2
ALIGNED = 0.95  # cosine from which an axis is called x, y or z
MAX_REST_FORCE = 1.0  # N read with nothing touching the tool
LEVER_TOLERANCE = 0.05  # m, of the point of the pushes; a hand is good for 0.03
MIN_LEVER = 0.08  # m from the sensor to the tip of a tool, from which moments tell of any point
NEAR_TIP = 0.25  # of that lever, beyond which the tool is pushed if no point is declared

Direction = Literal['+x', '-x', '+y', '-y', '+z', '-z']


class PushTestConfig(Config):
    """How the tool is pushed, and what is accepted as right."""

    directions: tuple[Direction, ...] = parameter(
        ('+x', '+y', '+z'), 'World axes along which the tool is pushed, each axis at least once.')
    force: Real = parameter(
        10.0, 'Force of every push, by a spring balance or a known weight.', unit='N',
        gt=DETECT_FORCE)
    rest_time: Real = parameter(
        0.3, 'Time of rest, before the pushes and after each.', unit='s', gt=0.0)
    settle_time: Real = parameter(
        0.3, 'Time of a push before it is measured.', unit='s', ge=0.0)
    hold_time: Real = parameter(0.3, 'Time over which a push is averaged.', unit='s', gt=0.0)
    timeout: Real = parameter(
        30.0, 'Longest wait for rest, for a push or for its end.', unit='s', gt=0.0)
    max_rest_std: Real = parameter(
        0.5, 'Largest standard deviation of a force axis at rest.', unit='N', gt=0.0)
    scale_tolerance: Real = parameter(
        0.2, 'Largest deviation of the scale from 1.', gt=0.0, le=0.4)

    @cross_check
    def _check_across_fields(self) -> Iterator[ConfigError]:
        if {direction[1] for direction in self.directions} != set('xyz'):
            yield ConfigError(
                'push_test.directions', 'each of x, y and z at least once', list(self.directions))

    @property
    def directions_world(self) -> Matrix:
        """Return the unit vectors of the pushes, world axes, shape (p, 3)."""
        return np.array([(1.0 if sign == '+' else -1.0) * np.eye(3)['xyz'.index(axis)]
                         for sign, axis in self.directions])


class PushTestResult(NamedTuple):
    """The verdict on a sensor: what is wrong or not checked, in words, and its scale."""

    findings: tuple[str, ...]
    scale: float
    unchecked: str = ''

    @property
    def passed(self) -> bool:
        """Whether force control may be enabled."""
        return not self.findings

    @property
    def message(self) -> str:
        """Return the verdict in one line."""
        if self.passed:
            right = self.unchecked or 'moments right'
            return f'push test passed: sign and frame right, scale {self.scale:.2f}, {right}'
        return f'push test failed: {"; ".join(self.findings)}'


class PushGate:
    """
    Leads through a push test, and allows force control once it has passed.

    Rest, then a push per direction: the user is told which, pushes, holds, lets go.

    Parameters
    ----------
    required
        Whether force control waits for a test.
    robot
        The arm.
    gravity_world
        g, shape (3,) [m/s^2].
    rate
        Rate of the samples [Hz].

    Attributes
    ----------
    open
        Whether force control is allowed.
    result
        The last verdict, None without any.
    phase
        What a test waits for: ``rest``, ``push`` or ``release``; empty if none is under way.

    """

    def __init__(
        self, *, required: bool, robot: RobotModel, gravity_world: Vector, rate: float,
    ) -> None:
        self.open, self.phase = not required, ''
        self.result: PushTestResult | None = None
        self._robot, self._gravity, self._rate = robot, gravity_world, rate
        self._samples: list[Vector] = []
        self._ticks = 0  # of the phase

    @property
    def running(self) -> bool:
        """Whether a test is under way."""
        return self.phase != ''

    @property
    def direction(self) -> str:
        """Direction to push in now, e.g. ``+x``; empty if it is not time to push."""
        return self._config.directions[len(self._pushes)] if self.phase == 'push' else ''

    @property
    def instruction(self) -> str:
        """Return what the user should do now; empty if there is nothing to be done."""
        if self.phase == 'push':
            where = 'at the declared point' if self._point else 'near its tip'
            return (f'push the tool along world {self.direction} with {self._config.force:g} N '
                    f'{where} and hold')
        if self.running:
            return 'let go of the tool' if self.phase == 'release' else 'keep off the tool'
        if self.result is not None:
            return self.result.message
        return '' if self.open else NEEDED

    def start(
        self, config: PushTestConfig, point_sensor: tuple[float, ...] = (),
        contacts: Mapping[str, Vector] | None = None,
    ) -> None:
        """Begin a test at a point [m], or near the `contacts`, in the operational frame [m]."""
        self._config, self._point, self.result = config, point_sensor, None
        self._contacts = contacts or {}
        self._enter('rest')
        self.restart()

    def restart(self) -> None:
        """Begin a test that is under way anew, with the next sample."""
        if self.running:
            self._rest, self._pushes = np.zeros(6), list[Vector]()
            self._rotation: Matrix = np.eye(3)
            self._lever: Vector | None = None
            self._tips: dict[str, Vector] = {}
            self._enter('rest')

    def update(self, q: Vector, wrench_sensor: Vector, tool: ToolConfig) -> bool:
        """
        Take the next sample of a test that is under way; return whether it has come to its end.

        Joint positions, shape (n,) [rad], and the reading in sensor axes, force first, shape (6,)
        [N, N m].
        """
        state = self._robot.update(q, np.zeros(len(q)))
        sensor, pose = state.sensor_pose, state.pose
        self._rotation, origin = sensor.rotation_world, sensor.position_world
        self._lever = self._rotation @ self._point if self._point else None
        self._tips = {'the operational point': pose.position_world - origin} | {
            f'contact {name}': pose.position_world + pose.rotation_world @ point - origin
            for name, point in self._contacts.items()}
        self.take(contact_wrench(wrench_sensor, sensor, origin, tool, self._gravity))
        return not self.running

    def take(self, wrench_world: Vector) -> None:
        """Take the next wrench, as `contact_wrench` makes it, shape (6,) [N, N m]."""
        config = self._config
        self._ticks += 1
        if not np.isfinite(wrench_world).all():
            self._fail('a reading that is not a finite number')
        elif self._ticks > max(1, round(config.timeout * self._rate)):
            waited = f'within {config.timeout:g} s'
            self._fail({
                'rest': f'no rest {waited}: the force never kept still',
                'push': f'no push along {self.direction} of more than {DETECT_FORCE:g} N felt '
                        f'{waited}',
                'release': f'the force did not return to that at rest {waited} after the push',
            }[self.phase])
        else:
            change = float(np.linalg.norm(wrench_world[:3] - self._rest[:3]))
            if (self.phase == 'push' and change < DETECT_FORCE) or (
                    self.phase == 'release' and change >= RELEASE_FORCE):
                self._samples = []
                return
            self._samples.append(wrench_world.copy())
            self._end_phase()

    def _end_phase(self) -> None:
        """Go on to the next phase once there are samples enough of this one."""
        config, count = self._config, len(self._samples)
        settling = round(config.settle_time * self._rate)
        if self.phase == 'push':
            if count == settling + max(1, round(config.hold_time * self._rate)):
                self._pushes.append(np.mean(self._samples[settling:], axis=0))
                self._enter('release')
        elif count == max(2, round(config.rest_time * self._rate)):
            if self.phase == 'rest':
                if np.std(self._samples, axis=0)[:3].max() > config.max_rest_std:
                    self._samples = []
                    return
                self._rest = np.mean(self._samples, axis=0)
            if len(self._pushes) < len(config.directions):
                self._enter('push')
            else:
                self._finish(judge_pushes(
                    np.array(self._pushes), self._rest, config,
                    rotation_world=self._rotation, lever_world=self._lever, tips=self._tips))

    def _enter(self, phase: str) -> None:
        self.phase, self._ticks, self._samples = phase, 0, []

    def _fail(self, finding: str) -> None:
        self._finish(PushTestResult((finding,), math.nan))

    def _finish(self, result: PushTestResult) -> None:
        self.result, self.open = result, result.passed
        self._enter('')


def judge_pushes(
    wrenches: Matrix, rest: Vector, config: PushTestConfig, *,
    rotation_world: Matrix, lever_world: Vector | None = None,
    tips: Mapping[str, Vector] | None = None,
) -> PushTestResult:
    """
    Judge a sensor by its readings under pushes.

    Parameters
    ----------
    wrenches, rest
        Compensated mean wrench at the sensor, world axes, of each push, shape (p, 6), and while
        nothing touches the tool, shape (6,) [N, N m].
    config
        Directions, force and tolerances.
    rotation_world
        Orientation of the sensor, shape (3, 3), to name what is found in its axes.
    lever_world
        From the sensor to where the tool is pushed, world axes, shape (3,) [m]; None if that is
        anywhere near its tips.
    tips
        From the sensor to the operational point and the contacts, likewise, by what they are
        called: ends of the tool, and what moments may be about instead of the sensor.

    """
    expected, deltas = -config.force * config.directions_world, wrenches - rest
    sign, rotation, scale = fit_mounting(deltas[:, :3], expected)
    findings = _mounting_findings(
        sign, rotation_world.T @ rotation @ rotation_world, scale, config) or _push_findings(
        deltas[:, :3], expected, config)
    unchecked, tips = '', tips or {}
    if not findings:
        reach = max((float(np.linalg.norm(tip)) for tip in tips.values()), default=0.0)
        if lever_world is None and reach < MIN_LEVER:
            unchecked = f'moments not checked: the tool reaches {100.0 * reach:.0f} cm'
        else:
            findings = _lever_findings(deltas, rotation_world, lever_world, tips, config)
    offset = float(np.linalg.norm(rest[:3]))
    if offset > MAX_REST_FORCE:
        findings.append(f'{offset:.1f} N read with nothing touching the tool: tare or identify it')
    return PushTestResult(tuple(findings), scale, unchecked)


def fit_mounting(measured: Matrix, expected: Matrix) -> tuple[int, Matrix, float]:
    """
    Fit f = s Q e to forces of shape (p, 3) [N]; return the sign, Q without it, and the scale s.

    Orthogonal Procrustes problem, reflections allowed: Q = U V^T of the singular value
    decomposition of sum f_i e_i^T. The expected ones span space.
    """
    U, sigma, Vt = np.linalg.svd(measured.T @ expected)
    Q = U @ Vt
    sign = 1 if np.linalg.det(Q) > 0.0 else -1
    return sign, sign * Q, float(sigma.sum() / np.sum(expected ** 2))


def _mounting_findings(
    sign: int, rotation: Matrix, scale: float, config: PushTestConfig,
) -> list[str]:
    """Name a flipped sign, a turn and a wrong scale, in the sensor's axes."""
    findings = []
    vector = Rotation.from_matrix(rotation).as_rotvec()
    angle = float(np.linalg.norm(vector))
    axis = vector / max(angle, 1e-12)
    largest = int(np.argmax(np.abs(axis)))
    aligned, turn = abs(axis[largest]) >= ALIGNED, 1
    name = f'the axis ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f}) of the sensor'
    if aligned:
        name, turn = f"the sensor's {'xyz'[largest]}", 1 if axis[largest] > 0.0 else -1
    half_turn = angle > np.pi - MAX_ANGLE
    if sign < 0 and half_turn and aligned:
        findings.append(f'sign of {name} alone flipped')  # a reflection is -(half a turn)
    else:
        if sign < 0:
            findings.append('sign flipped')
        if angle > MAX_ANGLE:
            degrees = 180 if half_turn else turn * round(float(np.degrees(angle)))
            findings.append(f'rotated by {degrees} deg about {name}')
    if abs(scale - 1.0) > config.scale_tolerance:
        findings.append(f'scale {scale:.2g}')
    return findings


def _push_findings(forces: Matrix, expected: Matrix, config: PushTestConfig) -> list[str]:
    """Name the pushes that are read off their direction or their size."""
    findings = []
    for name, force, wanted in zip(config.directions, forces, expected):
        size, right = float(np.linalg.norm(force)), float(np.linalg.norm(wanted))
        cosine = float(force @ wanted) / (size * right) if size > 0.0 else -1.0
        angle = float(np.degrees(np.arccos(min(max(cosine, -1.0), 1.0))))
        if not cosine >= np.cos(MAX_ANGLE):  # NaN does not pass
            findings.append(f'push along {name} read {angle:.0f} deg off')
        elif not abs(size / right - 1.0) <= config.scale_tolerance:
            findings.append(f'push along {name} read as {size:.3g} N instead of {right:g} N')
    return findings


def _lever_findings(
    deltas: Matrix, rotation_world: Matrix, lever: Vector | None, tips: Mapping[str, Vector],
    config: PushTestConfig,
) -> list[str]:
    """Name moments that are not those of pushes where the tool is pushed, and likely causes."""
    forces, moments = deltas[:, :3], deltas[:, 3:]
    point: Vector = np.linalg.lstsq(
        np.vstack([np.cross(np.eye(3), force).T for force in forces]), moments.ravel())[0]
    off = np.linalg.norm(
        moments - np.cross(point, forces), axis=1) / np.linalg.norm(forces, axis=1)
    farthest = max((float(np.linalg.norm(tip)) for tip in tips.values()), default=0.0)

    def right(point: Vector) -> bool:
        if lever is not None:
            return bool(np.linalg.norm(point - lever) <= LEVER_TOLERANCE)
        return bool(np.linalg.norm(point) <= farthest + LEVER_TOLERANCE) and any(
            point @ tip >= NEAR_TIP * (tip @ tip) for tip in tips.values()
            if np.linalg.norm(tip) >= 0.5 * farthest)

    if not (off <= 2.0 * LEVER_TOLERANCE).all():
        worst = config.directions[int(np.argmax(off))]
        return [f'torque of the push along {worst} is {100.0 * off.max():.0f} cm off the point '
                'of the others: torque channels swapped?']
    if right(point):
        return []
    causes = [f'moments about {name} instead of the sensor (a wrench at the TCP)'
              for name, tip in tips.items() if np.linalg.norm(tip) > LEVER_TOLERANCE and right(
                  point + tip)][:1]
    causes += ['sign of the torques flipped'] * right(-point)
    x, y, z = rotation_world.T @ point
    return [f'torques are those of pushes at ({x:.2f}, {y:.2f}, {z:.2f}) m from the sensor, which '
            f'is not {"near the tip" if lever is None else "the point"} of the tool'
            + (f': {" or ".join(causes)}?' if causes else '')]
