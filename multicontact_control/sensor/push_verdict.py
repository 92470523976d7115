"""
What pushes of known direction say about a wrist sensor: its sign, frame and scale.

A hand that pushes the tool along d with force F makes a right sensor read -F d, what the robot
does to the hand. The measured forces f_i and the expected e_i are related by f_i = s Q e_i with
the orthogonal Q that minimises sum |f_i - s Q e_i|^2 (orthogonal Procrustes problem, solved by the
singular value decomposition of sum f_i e_i^T, reflections allowed): Q = U V^T.

The fit only names what is wrong. What is decided by is stricter and cannot be averaged away: every
single push has to be read along its own direction, within an angle far below 90 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.sensor.push_config import MAX_ANGLE, PushTestConfig
import numpy as np
from scipy.spatial.transform import Rotation

ALIGNED = 0.95  # cosine from which an axis is called x, y or z
MAX_REST_FORCE = 1.0  # N read with nothing touching the tool
MOMENT_TOLERANCE = 0.3  # of a moment from that of the force, relative to it
MIN_MOMENT = 0.5  # N m of a push, from which its torque channels are checked


@dataclass(frozen=True, slots=True)
class PushTestResult:
    """
    The verdict on a sensor.

    Attributes
    ----------
    passed
        Whether force control may be enabled.
    sign
        1, or -1 if the best fit needs a reflection, as for a flipped sign.
    rotation
        Rotation of the readings, shape (3, 3): forces read = scale sign rotation (true forces),
        in the sensor's axes if its orientation was given, else in world axes.
    scale
        Readings relative to the true forces.
    findings
        What is wrong, in words; empty if the test was passed.

    """

    passed: bool
    sign: int
    rotation: Matrix
    scale: float
    findings: tuple[str, ...]

    @property
    def message(self) -> str:
        """One line for a person."""
        if self.passed:
            return f'push test passed: sign and frame right, scale {self.scale:.2f}'
        return f'push test failed: {"; ".join(self.findings)}'


def failed(finding: str) -> PushTestResult:
    """Return the verdict on a test that did not come to its end."""
    return PushTestResult(False, 1, np.eye(3), float('nan'), (finding,))


def judge_pushes(
    wrenches: Matrix, rest: Vector, config: PushTestConfig, *,
    sensor_rotation_world: Matrix | None = None, lever_world: Vector | None = None,
) -> PushTestResult:
    """
    Judge a sensor by its readings under pushes.

    Parameters
    ----------
    wrenches
        Compensated mean wrench of each push at the operational point, world axes, in the order
        of ``config.directions``, shape (p, 6) [N, N m].
    rest
        The same while nothing touches the tool, shape (6,).
    config
        Directions, force and tolerances.
    sensor_rotation_world
        Orientation of the sensor, shape (3, 3), to name what is found in its axes.
    lever_world
        From the operational point to where the tool is pushed, world axes, shape (3,) [m], to
        check the torque channels too; None not to.

    Returns
    -------
    PushTestResult
        The verdict.

    Raises
    ------
    ShapeError
        If there is not one wrench per direction.

    """
    expected = -config.force * config.directions_world
    require_shape('wrenches', wrenches, (len(expected), 6))
    deltas = wrenches - rest
    sign, rotation, scale = fit_mounting(deltas[:, :3], expected)
    axes = 'world'
    if sensor_rotation_world is not None:
        axes = "the sensor's"
        rotation = sensor_rotation_world.T @ rotation @ sensor_rotation_world
    findings = [*_mounting_findings(sign, rotation, scale, axes, config)]
    if not findings:
        findings += _push_findings(deltas[:, :3], expected, config)
    if not findings and lever_world is not None:
        findings += _moment_findings(deltas, lever_world, config)
    offset = float(np.linalg.norm(rest[:3]))
    if offset > MAX_REST_FORCE:
        findings.append(f'{offset:.1f} N read with nothing touching the tool: tare or identify it')
    return PushTestResult(not findings, sign, rotation, scale, tuple(findings))


def fit_mounting(measured: Matrix, expected: Matrix) -> tuple[int, Matrix, float]:
    """
    Fit f = scale sign rotation e to pairs of forces.

    Parameters
    ----------
    measured, expected
        Shape (p, 3) [N]; the expected ones span space.

    Returns
    -------
    tuple of int, Matrix, float
        Sign, proper rotation of shape (3, 3), scale >= 0.

    """
    U, sigma, Vt = np.linalg.svd(measured.T @ expected)
    Q = U @ Vt
    sign = 1 if np.linalg.det(Q) > 0.0 else -1
    return sign, sign * Q, float(sigma.sum() / np.sum(expected ** 2))


def _mounting_findings(
    sign: int, rotation: Matrix, scale: float, axes: str, config: PushTestConfig,
) -> list[str]:
    findings = []
    vector = Rotation.from_matrix(rotation).as_rotvec()
    angle = float(np.linalg.norm(vector))
    axis, turn = _axis_name(vector / angle, axes) if angle > 0.0 else ('', 1)
    half_turn = angle > np.pi - MAX_ANGLE
    if sign < 0 and half_turn and 'axis' not in axis:
        findings.append(f'sign of {axis} alone flipped')  # a reflection is -(half a turn)
    else:
        if sign < 0:
            findings.append('sign flipped')
        if angle > MAX_ANGLE:
            degrees = 180 if half_turn else turn * round(float(np.degrees(angle)))
            findings.append(f'rotated by {degrees} deg about {axis}')
    if abs(scale - 1.0) > config.scale_tolerance:
        findings.append(f'scale {scale:.2g}')
    return findings


def _axis_name(axis: Vector, axes: str) -> tuple[str, int]:
    """Return the name of a unit vector and the sign of its turn about that."""
    largest = int(np.argmax(np.abs(axis)))
    if abs(axis[largest]) >= ALIGNED:
        return f'{axes} {"xyz"[largest]}', 1 if axis[largest] > 0.0 else -1
    return f'the axis ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f}) of {axes} axes', 1


def _push_findings(measured: Matrix, expected: Matrix, config: PushTestConfig) -> list[str]:
    findings = []
    for name, force, wanted in zip(config.directions, measured, expected):
        size, right = float(np.linalg.norm(force)), float(np.linalg.norm(wanted))
        cosine = float(force @ wanted) / (size * right) if size > 0.0 else -1.0
        angle = float(np.degrees(np.arccos(min(max(cosine, -1.0), 1.0))))
        # Not `angle > ...`: what is not a number must not pass.
        if not cosine >= np.cos(MAX_ANGLE):
            findings.append(f'push along {name} read {angle:.0f} deg off')
        elif not abs(size / right - 1.0) <= config.scale_tolerance:
            findings.append(f'push along {name} read as {size:.3g} N instead of {right:g} N')
    return findings


def _moment_findings(deltas: Matrix, lever_world: Vector, config: PushTestConfig) -> list[str]:
    """Compare moments with what the forces, proved right by now, make at the point pushed."""
    expected = np.cross(lever_world, deltas[:, :3])
    sizes = np.linalg.norm(expected, axis=1)
    strong = sizes >= MIN_MOMENT
    errors = np.linalg.norm(deltas[strong, 3:] - expected[strong], axis=1)
    if np.all(errors <= MOMENT_TOLERANCE * sizes[strong]):
        return []
    worst = int(np.argmax(errors / sizes[strong]))
    name = [d for d, kept in zip(config.directions, strong) if kept][worst]
    share = 100.0 * errors[worst] / sizes[strong][worst]
    return [f'torque of the push along {name} is {share:.0f} % off what its force makes at the '
            'point pushed']
