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
QUARTER_TURNS = Rotation.from_rotvec(
    np.pi / 2 * np.vstack([np.eye(3), -np.eye(3)])
).as_matrix()
SIX = ('+x', '-x', '+y', '-y', '+z', '-z')
seeds = st.integers(0, 2**32 - 1)
rotations = seeds.map(lambda seed: Rotation.random(None, seed).as_matrix())


class Hand:
    """
    A hand that pushes a sensor, and what this reads.

    It is off by `unsteadiness` rad, and by as much of the force and of the point. The sensor has
    axes, and reads moments about a point beside its own.
    """

    def __init__(
        self, seed=0, *, unsteadiness=0.0, noise=0.0, sensor=STRAIGHT, about=0.0
    ):
        self._random = np.random.default_rng(seed)
        self._unsteadiness = unsteadiness
        self._noise = noise
        self.sensor = sensor
        self._about = about

    def push(self, force, direction):
        """Return force and torque of a push against a direction, world axes."""
        random = self._random
        unsteadiness = self._unsteadiness
        axis = np.cross(direction, random.standard_normal(3))
        angle = unsteadiness * random.uniform()
        turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
        size = force * (1.0 + unsteadiness * random.uniform(-1, 1))
        pushed = -size * turn.apply(direction)
        beside = 0.2 * unsteadiness * random.uniform(-1.0, 1.0, 3)
        return pushed, np.cross(LEVER - self._about + beside, pushed)

    def read_pushes(self, mounting, config):
        """Return the readings of all pushes of a sensor mounted otherwise, shape (n, 6)."""
        M = self.sensor @ mounting @ self.sensor.T
        readings = []
        for direction in config.directions_world:
            force, torque = self.push(config.force, direction)
            error = self._noise * self._random.standard_normal(6)
            readings.append(np.append(M @ force, M @ torque) + error)
        return np.array(readings)


STEADY = Hand()


def unsteady_hand(seed, sensor):
    return Hand(seed, unsteadiness=0.1, noise=0.02, sensor=sensor)


def judge(mounting, config=DEFAULTS, *, hand=STEADY, rest=0.0, tips=TIPS):
    rest = np.array([0.0, 0.0, rest, 0.0, 0.0, 0.0])
    pushes = hand.read_pushes(mounting, config) + rest
    return judge_pushes(pushes, rest, config, hand.sensor, tips)


@given(rotations, seeds, st.sampled_from([('+x', '+y', '+z'), ('-z', '+y', '-x'), SIX]))
def test_push_test_passes_a_right_sensor_with_an_unsteady_hand(
    sensor, seed, directions
):
    config = PushTestConfig(directions=directions)
    result = judge(np.eye(3), config, hand=unsteady_hand(seed, sensor))
    assert result.passed, result.message
    assert result.findings == ()
    assert result.scale == pytest.approx(1.0, abs=0.12)


mountings = rotations | st.sampled_from(list(QUARTER_TURNS))
signs = st.sampled_from([1.0, -1.0])
scales = st.floats(0.2, 5.0)


@given(rotations, mountings, seeds, signs, scales)
def test_push_test_refuses_every_flip_and_every_large_rotation(
    sensor, mounting, seed, sign, scale
):
    """Any orthogonal mounting but a small rotation, the tolerance and the hand apart."""
    angle = Rotation.from_matrix(mounting).magnitude()
    # Two of the three pushes see at least sqrt(2/3) of the rotation's sine; a flip needs none.
    assume(sign < 0.0 or angle > 2.0 * MAX_ANGLE + 0.2)
    hand = unsteady_hand(seed, sensor)
    assert not judge(sign * scale * mounting, hand=hand).passed


@given(mountings, seeds, signs, scales)
def test_fit_finds_sign_mounting_and_scale(mounting, seed, sign, scale):
    expected = np.random.default_rng(seed).standard_normal((5, 3))
    forces = expected @ (sign * scale * mounting).T
    found_sign, found_mounting, found_scale = fit_sensor_mounting(forces, expected)
    assert found_sign == sign
    assert found_scale == pytest.approx(scale)
    assert_allclose(found_mounting, mounting, atol=1e-8)


@given(seeds)
def test_push_test_refuses_any_linear_fault_beyond_its_tolerances(seed):
    """Cross-talk, dead or swapped channels: a matrix that turns or scales one push too much."""
    rng = np.random.default_rng(seed)
    M = np.eye(3) + rng.standard_normal((3, 3)) * rng.uniform(0.0, 1.0)
    sizes = np.linalg.norm(M, axis=0)
    angles = np.arccos(np.clip(np.diag(M) / sizes, -1.0, 1.0))
    scaled = np.abs(sizes - 1.0) > SCALE_TOLERANCE
    assume(scaled.any() or (angles > MAX_ANGLE).any())
    assert not judge(M).passed


@pytest.mark.parametrize(
    ('mounting', 'finding'),
    [
        (-np.eye(3), 'sign flipped'),
        (QUARTER_TURNS[4], 'rotated by 90 deg about the axis (0, -1, 0)'),
        (
            np.diag([1.0, -1.0, 1.0]),
            'sign along the axis (0, 1, 0) of the sensor alone flipped',
        ),
        (
            4.45 * QUARTER_TURNS[2],
            'rotated by 90 deg about the axis (0, 0, 1) of the sensor; scale 4',
        ),
        (np.diag([1.0, 1.0, 0.7]), 'push along -z read as 7 N instead of 10 N'),
    ],
)
def test_push_test_names_its_findings_in_the_sensors_axes(mounting, finding):
    sensor = Rotation.from_euler('x', np.pi).as_matrix()
    config = PushTestConfig(directions=('+x', '+y', '-z'))
    hand = Hand(sensor=sensor)
    assert finding in judge(mounting, config, hand=hand).message


@pytest.mark.parametrize(
    ('about', 'finding'),
    [
        (0.0, 'moments right'),
        (LEVER, 'moments about the operational point'),
        (2.0 * LEVER, 'sign of the torques flipped'),
    ],
)
def test_push_test_names_the_point_that_moments_are_about(about, finding):
    result = judge(np.eye(3), hand=Hand(about=about, unsteadiness=0.1))
    assert finding in result.message
    assert result.passed is (finding == 'moments right')


def test_push_test_does_not_check_moments_without_a_lever():
    result = judge(np.eye(3), tips={'the operational point': 0.1 * LEVER})
    assert result.passed
    assert 'moments not checked' in result.message


def test_push_test_refuses_a_force_at_rest():
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


def read_direction(gate):
    """Return the direction in which the gate asks for a push now, empty for none."""
    if gate.phase != 'push':
        return ''
    return gate.instruction.partition('world ')[2][:2]


def run_test(gate, push):
    """Let a hand push in each direction; return the directions asked for."""
    rng = np.random.default_rng(0)
    directions = []
    asked = ''
    while gate.running:
        direction = read_direction(gate)
        if direction not in ('', asked):
            asked = direction
            directions.append(asked)
        feel(gate, -push(direction) + 0.02 * rng.standard_normal(3))
    return directions


PUSHES = {
    '': np.zeros(3),
    '+x': np.array([10.0, 0.0, 0.0]),
    '+y': np.array([0.0, 10.0, 0.0]),
    '+z': np.array([0.0, 0.0, 10.0]),
}


def test_push_gate_guides_through_the_pushes_and_opens():
    gate = begun()
    assert run_test(gate, PUSHES.get) == ['+x', '+y', '+z']
    assert gate.open


def wait_for_phase(gate, phase, force):
    while gate.phase != phase:
        feel(gate, force)


def test_push_that_is_let_go_too_soon_is_asked_for_again():
    gate = begun()
    wait_for_phase(gate, 'push', np.zeros(3))
    for _ in range(40):
        feel(gate, -PUSHES['+x'])
    feel(gate, np.zeros(3))
    assert read_direction(gate) == '+x'


def test_push_test_that_begins_anew_asks_for_all_pushes():
    gate = begun()
    wait_for_phase(gate, 'push', np.zeros(3))
    wait_for_phase(gate, 'release', -PUSHES['+x'])
    gate.restart_test()
    assert run_test(gate, PUSHES.get) == ['+x', '+y', '+z']


def keep_off(direction):
    return np.zeros(3)


def never_rest(direction):
    return 5.0 * UNSTEADY.standard_normal(3)


def push_without_numbers(direction):
    if not direction:
        return np.zeros(3)
    return np.full(3, np.nan)


@pytest.mark.parametrize(
    ('push', 'message'),
    [
        (keep_off, 'within 2 s: push the tool near its tip along world +x with'),
        (never_rest, 'within 2 s: keep off the tool'),
        (push_without_numbers, 'not a finite number'),
    ],
)
def test_push_gate_ends_when_nothing_comes(push, message):
    gate = begun(timeout=2.0)
    run_test(gate, push)
    assert not gate.result.passed
    assert not gate.open
    assert message in gate.result.message
