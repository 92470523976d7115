"""
The push test: a user proves sign, frame and scale of the wrist sensor before force is controlled.

A hand that pushes the tool along d with force F makes a right sensor read -F d, what the robot
does to the hand. A fit f_i = s Q e_i of the measured forces to the expected names what is wrong;
the decision is stricter: every push has to be read along its own direction, as large as it is.
"""

from __future__ import annotations

from collections.abc import Iterator
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
MOMENT_TOLERANCE = 0.3  # of a moment from that of the force, relative to it
MIN_MOMENT = 0.5  # N m of a push, from which its torque channels are checked

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
    """The verdict on a sensor: what is wrong, in words, and the scale of its readings."""

    findings: tuple[str, ...]
    scale: float

    @property
    def passed(self) -> bool:
        """Whether force control may be enabled."""
        return not self.findings

    @property
    def message(self) -> str:
        """Return the verdict in one line."""
        if self.passed:
            return f'push test passed: sign and frame right, scale {self.scale:.2f}'
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
            return (f'push the tool along world {self.direction} with {self._config.force:g} N '
                    'and hold')
        if self.running:
            return 'let go of the tool' if self.phase == 'release' else 'keep off the tool'
        if self.result is not None:
            return self.result.message
        return '' if self.open else NEEDED

    def start(self, config: PushTestConfig, point_sensor: tuple[float, ...]) -> None:
        """Begin a test; the torque is checked if the tool is pushed at `point_sensor` [m]."""
        self._config, self._point, self.result = config, point_sensor, None
        self._enter('rest')
        self.restart()

    def restart(self) -> None:
        """Begin a test that is under way anew, with the next sample."""
        if self.running:
            self._rest, self._pushes = np.zeros(6), list[Vector]()
            self._rotation: Matrix = np.eye(3)
            self._lever: Vector | None = None
            self._enter('rest')

    def update(self, q: Vector, qd: Vector, wrench_sensor: Vector, tool: ToolConfig) -> bool:
        """
        Take the next sample of a test that is under way; return whether it has come to its end.

        Joint positions [rad] and velocities [rad/s], shape (n,), and the reading in sensor axes,
        force first, shape (6,) [N, N m].
        """
        state = self._robot.update(q, qd)
        sensor, position = state.sensor_pose, state.pose.position_world
        self._rotation = sensor.rotation_world
        if self._point:
            self._lever = sensor.position_world + self._rotation @ self._point - position
        self.take(contact_wrench(wrench_sensor, sensor, position, tool, self._gravity))
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
                    rotation_world=self._rotation, lever_world=self._lever))

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
) -> PushTestResult:
    """
    Judge a sensor by its readings under pushes.

    Parameters
    ----------
    wrenches, rest
        Compensated mean wrench at the operational point, world axes, of each push, shape (p, 6),
        and while nothing touches the tool, shape (6,) [N, N m].
    config
        Directions, force and tolerances.
    rotation_world
        Orientation of the sensor, shape (3, 3), to name what is found in its axes.
    lever_world
        From the operational point to where the tool is pushed, world axes, shape (3,) [m], to
        check the torque channels too.

    """
    expected, deltas = -config.force * config.directions_world, wrenches - rest
    sign, rotation, scale = fit_mounting(deltas[:, :3], expected)
    findings = _mounting_findings(
        sign, rotation_world.T @ rotation @ rotation_world, scale, config) or _push_findings(
        deltas, expected, lever_world, config)
    offset = float(np.linalg.norm(rest[:3]))
    if offset > MAX_REST_FORCE:
        findings.append(f'{offset:.1f} N read with nothing touching the tool: tare or identify it')
    return PushTestResult(tuple(findings), scale)


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


def _push_findings(
    deltas: Matrix, expected: Matrix, lever_world: Vector | None, config: PushTestConfig,
) -> list[str]:
    """Name the pushes that are read off their direction, their size or the moment they make."""
    findings = []
    for name, delta, wanted in zip(config.directions, deltas, expected):
        force = delta[:3]
        size, right = float(np.linalg.norm(force)), float(np.linalg.norm(wanted))
        cosine = float(force @ wanted) / (size * right) if size > 0.0 else -1.0
        angle = float(np.degrees(np.arccos(min(max(cosine, -1.0), 1.0))))
        moment = np.cross(np.zeros(3) if lever_world is None else lever_world, force)
        strength, error = np.linalg.norm(moment), np.linalg.norm(delta[3:] - moment)
        if not cosine >= np.cos(MAX_ANGLE):  # NaN does not pass
            findings.append(f'push along {name} read {angle:.0f} deg off')
        elif not abs(size / right - 1.0) <= config.scale_tolerance:
            findings.append(f'push along {name} read as {size:.3g} N instead of {right:g} N')
        elif strength >= MIN_MOMENT and not error <= MOMENT_TOLERANCE * strength:
            findings.append(f'torque of the push along {name} is {100.0 * error / strength:.0f} % '
                            'off what its force makes at the point pushed')
    return findings
