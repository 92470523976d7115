"""The push test: what is wrong is always refused and named, what is right passes."""

from hypothesis import assume, given
from hypothesis import strategies as st
from multicontact_control.config import ToolConfig
from multicontact_control.records import FRAME
from multicontact_control.sensor.push_test import (
    fit_sensor_mounting,
    judge_pushes,
    MAX_ANGLE,
    PushGate,
    PushTestConfig,
    SCALE_TOLERANCE,
)
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

RATE = 100.0
STRAIGHT = np.eye(3)
DEFAULTS = PushTestConfig()
UNSTEADY = np.random.default_rng(5)
LEVER = np.array([0.1, -0.16, -0.19])
TIPS = {'the operational point': LEVER, 'contact table': 0.8 * LEVER}
QUARTER_TURNS = [
    Rotation.from_rotvec(sign * np.pi / 2 * np.eye(3)[axis]).as_matrix()
    for axis in range(3)
    for sign in (1.0, -1.0)
]
SIX = ('+x', '-x', '+y', '-y', '+z', '-z')
seeds = st.integers(0, 2**32 - 1)
rotations = seeds.map(
    lambda seed: Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
)


def pushes(
    mounting, config, *, sensor=STRAIGHT, rng=None, hand=0.0, noise=0.0, about=0.0
):
    """Return readings of a hand off by `hand` rad, and as much of the force and of the point."""
    rng = rng or np.random.default_rng(0)
    rows = []
    M = sensor @ mounting @ sensor.T
    for direction in config.directions_world:
        axis = np.cross(direction, rng.standard_normal(3))
        axis *= hand * rng.uniform() / np.linalg.norm(axis)
        force = (
            -config.force
            * (1.0 + hand * rng.uniform(-1, 1))
            * (Rotation.from_rotvec(axis).as_matrix() @ direction)
        )
        torque = np.cross(LEVER - about + 0.2 * hand * rng.uniform(-1.0, 1.0, 3), force)
        rows.append(np.append(M @ force, M @ torque) + noise * rng.standard_normal(6))
    return np.array(rows)


def judge(mounting, config=DEFAULTS, *, rest=0.0, tips=TIPS, **changes):
    rest = np.array([0.0, 0.0, rest, 0.0, 0.0, 0.0])
    return judge_pushes(
        pushes(mounting, config, **changes) + rest,
        rest,
        config,
        changes.get('sensor', STRAIGHT),
        tips,
    )


@given(rotations, seeds, st.sampled_from([('+x', '+y', '+z'), ('-z', '+y', '-x'), SIX]))
def test_push_test_passes_a_right_sensor_with_an_unsteady_hand(
    sensor, seed, directions
):
    result = judge(
        np.eye(3),
        PushTestConfig(directions=directions),
        sensor=sensor,
        hand=0.1,
        noise=0.02,
        rng=np.random.default_rng(seed),
    )
    assert result.passed, result.message
    assert result.findings == ()
    assert result.scale == pytest.approx(1.0, abs=0.12)


@given(
    rotations,
    rotations | st.sampled_from(QUARTER_TURNS),
    seeds,
    st.sampled_from([1.0, -1.0]),
    st.floats(0.2, 5.0),
)
def test_push_test_refuses_every_flip_and_every_large_rotation(
    sensor, mounting, seed, sign, scale
):
    """Any orthogonal mounting but a small rotation, the tolerance and the hand apart."""
    angle = np.linalg.norm(Rotation.from_matrix(mounting).as_rotvec())
    # Two of the three pushes see at least sqrt(2/3) of the rotation's sine; a flip needs none.
    assume(sign < 0.0 or angle > 2.0 * MAX_ANGLE + 0.2)
    assert not judge(
        sign * scale * mounting,
        sensor=sensor,
        hand=0.1,
        noise=0.02,
        rng=np.random.default_rng(seed),
    ).passed
    expected = np.random.default_rng(seed).standard_normal((5, 3))
    fit = fit_sensor_mounting(expected @ (sign * scale * mounting).T, expected)
    assert fit[0] == sign and fit[2] == pytest.approx(scale)
    assert_allclose(fit[1], mounting, atol=1e-8)


@given(seeds)
def test_push_test_refuses_any_linear_fault_beyond_its_tolerances(seed):
    """Cross-talk, dead or swapped channels: a matrix that turns or scales one push too much."""
    rng = np.random.default_rng(seed)
    M = np.eye(3) + rng.standard_normal((3, 3)) * rng.uniform(0.0, 1.0)
    sizes = np.linalg.norm(M, axis=0)
    angles = np.arccos(np.clip(np.diag(M) / sizes, -1.0, 1.0))
    assume((np.abs(sizes - 1.0) > SCALE_TOLERANCE).any() or (angles > MAX_ANGLE).any())
    assert not judge(M).passed


@pytest.mark.parametrize(
    ('mounting', 'finding'),
    [
        (-np.eye(3), 'sign flipped'),
        (QUARTER_TURNS[3], 'rotated by 90 deg about the axis (0, -1, 0)'),
        (
            np.diag([1.0, -1.0, 1.0]),
            'sign along the axis (0, 1, 0) of the sensor alone flipped',
        ),
        (
            4.45 * QUARTER_TURNS[4],
            'rotated by 90 deg about the axis (0, 0, 1) of the sensor; scale 4',
        ),
        (np.diag([1.0, 1.0, 0.7]), 'push along -z read as 7 N instead of 10 N'),
    ],
)
def test_push_test_names_its_findings_in_the_sensors_axes(mounting, finding):
    sensor = Rotation.from_euler('x', np.pi).as_matrix()
    config = PushTestConfig(directions=('+x', '+y', '-z'))
    assert finding in judge(mounting, config, sensor=sensor).message


@pytest.mark.parametrize(
    ('about', 'finding'),
    [
        (0.0, 'moments right'),
        (LEVER, 'moments about the operational point'),
        (2.0 * LEVER, 'sign of the torques flipped'),
    ],
)
def test_push_test_names_the_point_that_moments_are_about(about, finding):
    result = judge(np.eye(3), about=about, hand=0.1)
    assert finding in result.message
    assert result.passed is (finding == 'moments right')


def test_push_test_does_not_check_moments_without_a_lever_and_refuses_a_force_at_rest():
    result = judge(np.eye(3), tips={'the operational point': 0.1 * LEVER})
    assert result.passed and 'moments not checked' in result.message
    assert not judge(np.eye(3), rest=3.0).passed


def begun(**config):
    """Return a gate with a test under way, of a sensor at a short tool."""
    gate = PushGate(required=True, gravity_world=np.zeros(3), rate=RATE)
    gate.start_test(PushTestConfig(**config), {})
    return gate


def feel(gate, force):
    """Let the sensor, which has the world's axes, read a force [N]."""
    frame = np.zeros(1, dtype=FRAME)
    frame['sensor_rotation'] = STRAIGHT
    return gate.take_sample(frame[0], np.append(force, np.zeros(3)), ToolConfig())


def asked(gate):
    """Return the direction in which the gate asks for a push now, empty for none."""
    return gate.instruction.partition('world ')[2][:2] if gate.phase == 'push' else ''


def run(gate, hand):
    """Let a hand push as `hand` says for each direction; return the directions asked for."""
    rng = np.random.default_rng(0)
    directions = []
    while gate.running:
        if asked(gate) not in ['', *directions[-1:]]:
            directions.append(asked(gate))
        feel(gate, -hand(asked(gate)) + 0.02 * rng.standard_normal(3))
    return directions


def obedient(direction):
    if not direction:
        return np.zeros(3)
    return 10.0 * float(f'{direction[0]}1') * np.eye(3)['xyz'.index(direction[1])]


def test_push_gate_guides_through_the_pushes_and_opens():
    """Also where a push is let go too soon, and where the test begins anew."""
    gate = begun()
    while not asked(gate):
        feel(gate, np.zeros(3))
    for force in [-10.0] * 40 + [0.0]:
        feel(gate, np.array([force, 0.0, 0.0]))
    assert asked(gate) == '+x'
    while gate.phase != 'release':
        feel(gate, -obedient(asked(gate)))
    gate.restart_test()
    assert run(gate, obedient) == ['+x', '+y', '+z'] and gate.open


@pytest.mark.parametrize(
    ('hand', 'message'),
    [
        (
            lambda direction: np.zeros(3),
            'within 2 s: push the tool near its tip along world +x with',
        ),
        (
            lambda direction: UNSTEADY.standard_normal(3) * 5.0,
            'within 2 s: keep off the tool',
        ),
        (
            lambda direction: np.full(3, np.nan) if direction else np.zeros(3),
            'not a finite number',
        ),
    ],
)
def test_push_gate_ends_when_nothing_comes(hand, message):
    gate = begun(timeout=2.0)
    run(gate, hand)
    assert not gate.result.passed and not gate.open
    assert message in gate.result.message
