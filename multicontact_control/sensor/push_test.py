"""
The push test: a user proves sign, frame and scale of the wrist sensor before force is controlled.

A hand that pushes the tool along d with force F makes a right sensor read -F d, what the robot
does to the hand. A fit f_i = s Q e_i of the measured forces to the expected names what is wrong;
the decision is stricter: every push has to be read along its own direction, as large as it is.
The moments m_i = p x f_i give the point p of the pushes, which has to be near a tip of the tool.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import math
from typing import Literal, NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import Config, parameter, ToolConfig
from multicontact_control.contact.wrench import contact_wrench
from multicontact_control.errors import CommandError, ConfigError
from multicontact_control.records import Frame
import numpy as np
from scipy.spatial.transform import Rotation

DETECT_FORCE = 2.0  # N, change of force that begins a push
RELEASE_FORCE = 1.0  # N, change of force below which a push is over
PHASE_TIME = 0.3  # s: of rest, of a push before it is averaged, and of this average
MAX_REST_STD = 0.5  # N, standard deviation of a force axis at rest
MAX_REST_FORCE = 1.0  # N read with nothing touching the tool
MAX_ANGLE = 0.35  # rad between a push and its reading; a hand is good for 0.2
SCALE_TOLERANCE = 0.2  # of a force that is read
LEVER_TOLERANCE = 0.05  # m, of the point of the pushes; a hand is good for 0.03
MIN_LEVER = 0.08  # m, from the sensor to the tip; moments of less locate no point
NEAR_TIP = 0.25  # of that lever, beyond which the tool is pushed

# What a user is told of a test that is over, and before one.
PASSED = 'push test passed'
FAILED = 'push test failed'
CANCELLED = 'push test cancelled'
DISABLED = 'force control is disabled until ~/push_test has passed'

Direction = Literal['+x', '-x', '+y', '-y', '+z', '-z']


class PushTestConfig(Config):
    """How the tool is pushed: along which world axes, how hard, and how long the test waits."""

    directions: tuple[Direction, ...] = parameter(
        ('+x', '+y', '+z'),
        'World axes along which the tool is pushed, each axis at least once.',
    )
    force: float = parameter(
        10.0,
        'Force of every push, by a spring balance or a known weight.',
        unit='N',
        gt=DETECT_FORCE,
    )
    timeout: float = parameter(
        30.0, 'Longest wait for rest, for a push or for its end.', unit='s', gt=0.0
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        if {direction[1] for direction in self.directions} != set('xyz'):
            yield ConfigError(
                'push_test.directions',
                'each of x, y and z at least once',
                list(self.directions),
            )

    @property
    def directions_world(self) -> Matrix:
        """Return the unit vectors of the pushes, world axes, shape (p, 3)."""
        signs = {'+': 1.0, '-': -1.0}
        axes = dict(zip('xyz', np.eye(3)))
        return np.array([signs[sign] * axes[axis] for sign, axis in self.directions])


class PushTestResult(NamedTuple):
    """The verdict on a sensor."""

    findings: tuple[str, ...]  # its defects, in words; none if it has passed
    scale: float = math.nan  # force that is read over the force of the pushes
    unchecked: str = ''  # what the pushes could not show, in words
    judged: bool = True  # whether all pushes were felt, so that it is about the sensor

    @property
    def passed(self) -> bool:
        """Whether the sensor has no defect, so that force control may be enabled."""
        return not self.findings

    @property
    def message(self) -> str:
        """Return the verdict in one line, for a user."""
        if self.passed:
            right = self.unchecked or 'moments right'
            return f'{PASSED}: sign and frame right, scale {self.scale:.2f}, {right}'
        return f'{FAILED}: {"; ".join(self.findings)}'


class PushGate:
    """
    Leads through a push test: rest, then a push per direction; allows force control after it.

    Parameters
    ----------
    required
        Whether force control waits for a test.
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

    def __init__(self, *, required: bool, gravity_world: Vector, rate: float) -> None:
        self.open = not required
        self.phase = ''
        self.result: PushTestResult | None = None
        # Whether force control was allowed before the tests since the last verdict on the sensor.
        self._open_before = self.open
        self._gravity = gravity_world
        self._rate = rate
        self._samples: list[Vector] = []  # of the phase

    @property
    def running(self) -> bool:
        """Whether a test is under way, for which samples are to come to `take_sample`."""
        return self.phase != ''

    @property
    def instruction(self) -> str:
        """Return what the user should do now; empty if there is nothing to be done."""
        if self.phase == 'push':
            direction = self._config.directions[len(self._pushes)]
            return (
                f'push the tool near its tip along world {direction} with '
                f'{self._config.force:g} N and hold'
            )
        if self.phase == 'release':
            return 'let go of the tool'
        if self.phase == 'rest':
            return 'keep off the tool'
        if self.result is None:
            return '' if self.open else DISABLED
        if self._may_cancel:
            return f'{self.result.message}; repeat it, or cancel it'
        return self.result.message

    def start_test(
        self, config: PushTestConfig, contacts: Mapping[str, Vector]
    ) -> None:
        """
        Begin a test of a tool, with the next sample.

        `contacts` are the tips of the tool by name, operational frame, shape (3,) [m].
        """
        self._config = config
        self._contacts = contacts
        if not self._may_cancel:
            self._open_before = self.open
        self.result = None
        self.phase = 'rest'
        self.restart_test()

    @property
    def _may_cancel(self) -> bool:
        return self.running or (self.result is not None and not self.result.judged)

    def cancel_test(self) -> None:
        """
        Take back a test that is under way, or has ended without a verdict on the sensor.

        Force control is allowed again if it was before. CommandError if there is no such test.
        """
        if not self._may_cancel:
            raise CommandError('push test', hint='none is under way')
        self.open = self._open_before
        self.result = None
        self.phase = ''

    def restart_test(self) -> None:
        """Begin a test that is under way anew, with the next sample."""
        if self.running:
            self._rest = np.zeros(6)
            self._pushes: list[Vector] = []
            self._enter_phase('rest')

    def fail_test(self, finding: str) -> None:
        """End a test that is under way without a verdict on the sensor, with this finding."""
        self._finish(PushTestResult((finding,), judged=False))

    def take_sample(
        self, frame: Frame, wrench_sensor: Vector, tool: ToolConfig
    ) -> bool:
        """
        Take the next sample of a test that is under way.

        Parameters
        ----------
        frame
            Record of `FRAME` of the sample.
        wrench_sensor
            Reading in sensor axes, force first, shape (6,) [N, N m].
        tool
            What hangs on the sensor, whose weight is no part of a push.

        Returns
        -------
        bool
            Whether the test has come to its end, and `result` is set.

        """
        origin = frame['sensor_position']
        rotation = frame['sensor_rotation']
        wrench = contact_wrench(
            wrench_sensor, (origin, rotation), origin, tool, self._gravity
        )
        self._ticks += 1
        if not np.isfinite(wrench).all():
            self._finish(PushTestResult(('a reading that is not a finite number',)))
        elif self._ticks > max(1, round(self._config.timeout * self._rate)):
            self.fail_test(
                f'the force did not follow within {self._config.timeout:g} s: '
                f'{self.instruction}'
            )
        elif self._advance_phase(wrench):
            operational_point = frame['position'] - origin
            tips = {'the operational point': operational_point}
            for name, contact in self._contacts.items():
                tips[f'contact {name}'] = (
                    operational_point + frame['rotation'] @ contact
                )
            pushes = np.array(self._pushes)
            self._finish(judge_pushes(pushes, self._rest, self._config, rotation, tips))
        return not self.running

    def _advance_phase(self, wrench: Vector) -> bool:
        """Average the phase's wrenches, and enter the next; return whether all pushes are felt."""
        change = float(np.linalg.norm(wrench[:3] - self._rest[:3]))
        awaits_push = self.phase == 'push' and change < DETECT_FORCE
        awaits_release = self.phase == 'release' and change >= RELEASE_FORCE
        if awaits_push or awaits_release:
            self._samples = []
            return False
        self._samples.append(wrench)
        averaged = max(2, round(PHASE_TIME * self._rate))
        needed = 2 * averaged if self.phase == 'push' else averaged
        if len(self._samples) < needed:
            return False
        mean = np.mean(self._samples[-averaged:], axis=0)
        if self.phase == 'push':
            self._pushes.append(mean)
            self._enter_phase('release')
            return False
        if self.phase == 'rest':
            if np.std(self._samples, axis=0)[:3].max() > MAX_REST_STD:
                self._samples = []
                return False
            self._rest = mean
        if len(self._pushes) == len(self._config.directions):
            return True
        self._enter_phase('push')
        return False

    def _enter_phase(self, phase: str) -> None:
        self.phase = phase
        self._ticks = 0
        self._samples = []

    def _finish(self, result: PushTestResult) -> None:
        self.result = result
        self.open = result.passed
        self.phase = ''


def judge_pushes(
    wrenches: Matrix,
    rest: Vector,
    config: PushTestConfig,
    rotation_world: Matrix,
    tips: Mapping[str, Vector],
) -> PushTestResult:
    """
    Judge a sensor by its readings under pushes.

    Sign, turn and scale of the whole come first, then single pushes; moments are judged once the
    forces are right, since they locate the pushes by them.

    Parameters
    ----------
    wrenches, rest
        Compensated mean wrench at the sensor, world axes, of each push, shape (p, 6), and while
        nothing touches the tool, shape (6,) [N, N m].
    config
        Directions and force.
    rotation_world
        Orientation of the sensor, shape (3, 3), to name what is found in its axes.
    tips
        From the sensor to the ends of the tool, by name, world axes, shape (3,) [m].

    Returns
    -------
    PushTestResult
        With the defects named in the sensor's axes, or none.

    """
    expected = -config.force * config.directions_world
    changes = wrenches - rest
    forces = changes[:, :3]
    sign, turn_world, scale = fit_sensor_mounting(forces, expected)
    turn_sensor = rotation_world.T @ turn_world @ rotation_world
    findings = _mounting_findings(sign, turn_sensor, scale)
    if not findings:
        findings = _push_findings(forces, expected, config)
    reach = max(float(np.linalg.norm(tip)) for tip in tips.values())
    unchecked = ''
    if reach < MIN_LEVER:
        unchecked = f'moments not checked: the tool reaches {100.0 * reach:.0f} cm'
    elif not findings:
        findings = _moment_findings(changes, rotation_world, tips, config)
    offset = float(np.linalg.norm(rest[:3]))
    if offset > MAX_REST_FORCE:
        findings.append(
            f'{offset:.1f} N read with nothing touching the tool: tare or identify it'
        )
    return PushTestResult(tuple(findings), scale, unchecked)


def fit_sensor_mounting(
    measured: Matrix, expected: Matrix
) -> tuple[int, Matrix, float]:
    """
    Fit f = s Q e to forces of shape (p, 3) [N]; return the sign, Q without it, and the scale s.

    Orthogonal Procrustes problem, reflections allowed: Q = U V^T of the singular value
    decomposition of sum f_i e_i^T. The expected ones span space.
    """
    U, sigma, Vt = np.linalg.svd(measured.T @ expected)
    Q = U @ Vt
    sign = 1 if np.linalg.det(Q) > 0.0 else -1
    scale = float(sigma.sum() / np.sum(expected**2))
    return sign, sign * Q, scale


def _mounting_findings(sign: int, rotation: Matrix, scale: float) -> list[str]:
    """Name a flipped sign, a turn and a wrong scale, in the sensor's axes."""
    findings = []
    vector = Rotation.from_matrix(rotation).as_rotvec()
    angle = float(np.linalg.norm(vector))
    axis = np.round(vector / max(angle, 1e-12), 1) + 0.0  # without negative zeros
    x, y, z = axis
    name = f'the axis ({x:g}, {y:g}, {z:g}) of the sensor'
    if sign < 0 and angle > np.pi - MAX_ANGLE:
        # A reflection is half a turn with the sign flipped.
        findings.append(f'sign along {name} alone flipped')
    else:
        if sign < 0:
            findings.append('sign flipped')
        if angle > MAX_ANGLE:
            findings.append(f'rotated by {np.degrees(angle):.0f} deg about {name}')
    if abs(scale - 1.0) > SCALE_TOLERANCE:
        findings.append(f'scale {scale:.2g}')
    return findings


def _push_findings(
    forces: Matrix, expected: Matrix, config: PushTestConfig
) -> list[str]:
    """Name the pushes that are read off their direction or their size."""
    findings = []
    for name, force, wanted in zip(config.directions, forces, expected):
        size = float(np.linalg.norm(force))
        cosine = float(force @ wanted) / max(size * config.force, 1e-12)
        angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        if not angle <= MAX_ANGLE:  # NaN does not pass
            findings.append(f'push along {name} read {math.degrees(angle):.0f} deg off')
        elif not abs(size / config.force - 1.0) <= SCALE_TOLERANCE:
            findings.append(
                f'push along {name} read as {size:.3g} N instead of {config.force:g} N'
            )
    return findings


def _moment_findings(
    changes: Matrix,
    rotation_world: Matrix,
    tips: Mapping[str, Vector],
    config: PushTestConfig,
) -> list[str]:
    """Name moments that are not those of pushes near a tip of the tool, and likely causes."""
    forces = changes[:, :3]
    moments = changes[:, 3:]
    # m_i = p x f_i is linear in p: the columns are those of e x f_i.
    columns = np.vstack([np.cross(np.eye(3), force).T for force in forces])
    point: Vector = np.linalg.lstsq(columns, moments.ravel())[0]
    missing = np.linalg.norm(moments - np.cross(point, forces), axis=1)
    off = missing / np.linalg.norm(forces, axis=1)  # lever, [m]
    if not (off <= 2.0 * LEVER_TOLERANCE).all():
        worst = config.directions[int(np.argmax(off))]
        return [
            f'torque of the push along {worst} is {100.0 * off.max():.0f} cm off the point '
            'of the others: torque channels swapped?'
        ]
    if _is_near_tip(point, tips):
        return []
    causes = []
    for name, tip in tips.items():
        if _is_near_tip(point + tip, tips):
            causes.append(
                f'moments about {name} instead of the sensor (a wrench at the TCP)'
            )
            break
    if _is_near_tip(-point, tips):
        causes.append('sign of the torques flipped')
    x, y, z = rotation_world.T @ point
    finding = (
        f'torques are those of pushes at ({x:.2f}, {y:.2f}, {z:.2f}) m from the sensor, '
        'which is not near the tip of the tool'
    )
    if causes:
        finding = f'{finding}: {" or ".join(causes)}'
    return [finding]


def _is_near_tip(point: Vector, tips: Mapping[str, Vector]) -> bool:
    """Return whether a point is within reach of the tool, towards a tip far from the sensor."""
    lengths = {name: np.linalg.norm(tip) for name, tip in tips.items()}
    reach = max(lengths.values())
    if not np.linalg.norm(point) <= reach + LEVER_TOLERANCE:
        return False
    for name, tip in tips.items():
        is_long = lengths[name] >= 0.5 * reach
        if is_long and point @ tip >= NEAR_TIP * (tip @ tip):
            return True
    return False
