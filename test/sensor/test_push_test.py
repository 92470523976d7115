"""The push test: what is wrong is always refused and named, what is right passes."""

from contextlib import closing

from hypothesis import assume, given, settings
from hypothesis import strategies as st
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.push_trial import push_setup
from multicontact_control.sensor.push_test import (
    fit_mounting,
    judge_pushes,
    MAX_ANGLE,
    PushGate,
    PushTestConfig,
)
from multicontact_control.sensor.tool import TareConfig
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

RATE = 100.0
LEVER = np.array([0.1, -0.16, -0.19])
QUARTER_TURNS = [
    Rotation.from_rotvec(sign * np.pi / 2 * np.eye(3)[axis]).as_matrix()
    for axis in range(3) for sign in (1.0, -1.0)]
SIX = ('+x', '-x', '+y', '-y', '+z', '-z')
seeds = st.integers(0, 2 ** 32 - 1)
rotations = seeds.map(
    lambda seed: Rotation.random(rng=np.random.default_rng(seed)).as_matrix())


def read(mounting, sensor_rotation, force_world, torque_world):
    """Return what a wrongly mounted sensor makes of a wrench at its own origin, world axes."""
    M = sensor_rotation @ mounting @ sensor_rotation.T
    return np.concatenate((M @ force_world, M @ torque_world))


def pushes(mounting, config, *, sensor=None, rng=None, hand=0.0, noise=0.0, about=0.0,
           spread=0.0):
    """Return readings of a hand off by `hand` rad and as much of the force, and `spread` [m]."""
    rng = rng or np.random.default_rng(0)
    sensor = np.eye(3) if sensor is None else sensor
    rows = []
    for direction in config.directions_world:
        axis = np.cross(direction, rng.standard_normal(3))
        axis *= hand * rng.uniform() / np.linalg.norm(axis)
        force = -config.force * (1.0 + hand * rng.uniform(-1, 1)) * (
            Rotation.from_rotvec(axis).as_matrix() @ direction)
        rows.append(read(mounting, sensor, force, np.cross(
            LEVER - about + spread * rng.uniform(-1.0, 1.0, 3), force))
                    + noise * rng.standard_normal(6))
    return np.array(rows)


def judge(mounting, config=None, *, rest=None, lever=LEVER, tips=None, **changes):
    config = config or PushTestConfig()
    return judge_pushes(
        pushes(mounting, config, **changes), np.zeros(6) if rest is None else rest, config,
        rotation_world=changes.get('sensor', np.eye(3)), lever_world=lever, tips=tips)


@given(rotations, seeds, st.sampled_from([('+x', '+y', '+z'), ('-z', '+y', '-x'), SIX]))
def test_right_sensor_passes_with_an_unsteady_hand_in_any_pose(sensor, seed, directions):
    result = judge(np.eye(3), PushTestConfig(directions=directions), sensor=sensor, hand=0.1,
                   noise=0.02, rng=np.random.default_rng(seed))
    assert result.passed, result.message
    assert result.findings == ()
    assert result.scale == pytest.approx(1.0, abs=0.12)


@given(rotations, rotations | st.sampled_from(QUARTER_TURNS), seeds,
       st.sampled_from([1.0, -1.0]), st.floats(0.2, 5.0))
@settings(max_examples=200)
def test_every_flip_and_every_large_rotation_is_refused(sensor, mounting, seed, sign, scale):
    """Any orthogonal mounting but a small rotation, the tolerance and the hand apart."""
    config = PushTestConfig()
    angle = np.linalg.norm(Rotation.from_matrix(mounting).as_rotvec())
    # Two of the three pushes see at least sqrt(2/3) of the rotation's sine; a flip needs none.
    assume(sign < 0.0 or angle > 2.0 * MAX_ANGLE + 0.2)
    result = judge(sign * scale * mounting, config, sensor=sensor, hand=0.1, noise=0.02,
                   rng=np.random.default_rng(seed))
    assert not result.passed, result


@given(seeds)
def test_no_linear_fault_beyond_the_tolerances_passes(seed):
    """Cross-talk, dead or swapped channels: any matrix that turns or scales one push too much."""
    rng, config = np.random.default_rng(seed), PushTestConfig()
    M = np.eye(3) + rng.standard_normal((3, 3)) * rng.uniform(0.0, 1.0)
    sizes = np.linalg.norm(M, axis=0)
    angles = np.arccos(np.clip(np.diag(M) / sizes, -1.0, 1.0))
    bad = (np.abs(sizes - 1.0) > config.scale_tolerance).any() or (
        angles > MAX_ANGLE).any()
    assume(bad)
    assert not judge(M).passed


@pytest.mark.parametrize(('mounting', 'found'), [
    (-np.eye(3), 'sign flipped'), (QUARTER_TURNS[0], "rotated by 90 deg about the sensor's x"),
    (QUARTER_TURNS[3], "rotated by -90 deg about the sensor's y"),
    (-QUARTER_TURNS[4], "sign flipped; rotated by 90 deg about the sensor's z"),
    (np.diag([1.0, -1.0, 1.0]), "sign of the sensor's y alone flipped"),
    (4.45 * QUARTER_TURNS[4], "rotated by 90 deg about the sensor's z; scale 4.5"),
    (Rotation.from_rotvec([1.0, 1.0, 0.0]).as_matrix(), 'rotated by 81 deg about the axis (0.71, '
     '0.71, 0.00)'),
    (np.diag([1.0, 1.0, 0.7]), 'push along -z read as 7 N instead of 10 N')])
def test_verdict_names_what_it_found_in_the_sensors_axes(mounting, found):
    sensor = Rotation.from_euler('x', np.pi).as_matrix()
    config = PushTestConfig(directions=('+x', '+y', '-z'))
    assert found in judge(mounting, config, sensor=sensor).message


@pytest.mark.parametrize('lever', [LEVER, None])
@pytest.mark.parametrize(('about', 'found'), [
    (0.0, 'moments right'), (LEVER, 'moments about the operational point'),
    (2.0 * LEVER, 'sign of the torques flipped')])
def test_moments_tell_about_which_point_they_are(lever, about, found):
    tips = {'the operational point': LEVER, 'contact table': 0.8 * LEVER}
    result = judge(np.eye(3), lever=lever, tips=tips, about=about)
    assert found in result.message
    assert result.passed is (found == 'moments right')


@given(rotations, seeds, st.floats(0.4, 1.0))
def test_hand_may_push_anywhere_near_the_tip_and_never_with_moments_about_it(
        sensor, seed, share):
    tips = {'the operational point': LEVER / share}
    changes = {'sensor': sensor, 'hand': 0.1, 'noise': 0.02, 'lever': None, 'tips': tips,
               'spread': 0.02}
    for about, right in ((0.0, True), (LEVER / share, False)):
        rng = np.random.default_rng(seed)
        assert judge(np.eye(3), rng=rng, about=about, **changes).passed is right


def test_tool_without_a_lever_passes_and_its_moments_are_called_not_checked():
    result = judge(np.eye(3), lever=None, tips={'the operational point': 0.1 * LEVER})
    assert result.passed and 'moments not checked' in result.message


def at_tip(loop):
    """Return a driver that reports a wrench at the tip that is pushed, in sensor axes."""
    lever = np.array(loop.plant.tool_push_point)

    def corrupt(inputs):
        force, torque = np.split(inputs.wrench.wrench, 2)
        return inputs._replace(wrench=inputs.wrench._replace(
            wrench=np.concatenate([force, torque - np.cross(lever, force)])))
    return corrupt


@pytest.mark.parametrize('driver', [lambda loop: None, at_tip])
def test_wrench_at_the_tcp_is_refused_without_a_declared_point(driver):
    config = PushTestConfig(settle_time=0.2, hold_time=0.2)
    setup = push_setup('rigid', 0, config, np.eye(3))
    with closing(ClosedLoop(setup)) as loop:
        loop.advance()
        corrupt = driver(loop)
        for _ in range(150):
            loop.advance(corrupt)
        tare = tuple(loop.control.tare(TareConfig()).tolist())
        tool = setup.controller.tool.model_copy(update={'bias_sensor': tare})
        loop.control.supervisor.reconfigure(setup.controller.model_copy(update={'tool': tool}))
        loop.control.push_test(config, ())
        while loop.control.push_gate.running:
            loop.advance(corrupt)
    result = loop.control.push_gate.result
    assert result.passed is (corrupt is None), result.message
    assert result.passed or 'moments about contact' in result.message


def test_force_read_at_rest_is_refused():
    config = PushTestConfig()
    rest = np.array([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
    result = judge_pushes(
        pushes(np.eye(3), config) + rest, rest, config, rotation_world=np.eye(3))
    assert not result.passed and '3.0 N read' in result.message


@given(rotations, st.sampled_from([1, -1]), st.floats(0.1, 10.0), seeds)
def test_fit_recovers_any_mounting_exactly(rotation, sign, scale, seed):
    expected = np.random.default_rng(seed).standard_normal((5, 3))
    found = fit_mounting(expected @ (sign * scale * rotation).T, expected)
    assert found[0] == sign
    np.testing.assert_allclose(found[1], rotation, atol=1e-8)
    assert found[2] == pytest.approx(scale)


def begun(**config):
    """Return a gate with a test under way that is given compensated wrenches."""
    gate = PushGate(required=True, robot=None, gravity_world=np.zeros(3), rate=RATE)
    gate.start(PushTestConfig(**config), ())
    return gate


def run(gate, hand):
    """Let a hand follow the instructions; `hand` turns a direction into a force."""
    rng, said = np.random.default_rng(0), []
    while gate.running:
        if not said or said[-1] != gate.instruction:
            said.append(gate.instruction)
        gate.take(np.concatenate((-hand(gate.direction), np.zeros(3)))
                  + 0.02 * rng.standard_normal(6))
    return gate.result, said


def obedient(direction):
    if not direction:
        return np.zeros(3)
    return 10.0 * float(f'{direction[0]}1') * np.eye(3)['xyz'.index(direction[1])]


def test_push_test_guides_through_the_pushes_and_passes():
    gate = begun()
    result, said = run(gate, obedient)
    assert result.passed and gate.open and gate.instruction == result.message
    assert [text.split()[5] for text in said if text.startswith('push the tool')] == [
        '+x', '+y', '+z']


@pytest.mark.parametrize(('hand', 'message'), [
    (lambda direction: np.zeros(3), 'no push along +x of more than 2 N felt within 2 s'),
    (lambda direction: np.random.default_rng().standard_normal(3) * 5.0, 'no rest within 2 s'),
    (lambda direction: np.full(3, np.nan) if direction else np.zeros(3), 'not a finite number')])
def test_push_test_ends_when_nothing_comes(hand, message):
    gate = begun(timeout=2.0)
    result, _ = run(gate, hand)
    assert not result.passed and not gate.open
    assert message in result.message
    assert np.isnan(result.scale)


def test_push_that_is_let_go_too_soon_is_asked_for_again():
    gate = begun()
    while not gate.direction:
        gate.take(np.zeros(6))
    for force in [-10.0] * 40 + [0.0]:
        gate.take(np.array([force, 0, 0, 0, 0, 0]))
    assert gate.direction == '+x'
    assert run(gate, obedient)[0].passed


def test_test_that_is_under_way_begins_anew_after_a_restart():
    gate = begun()
    while gate.phase != 'release':
        gate.take(np.concatenate((-obedient(gate.direction), np.zeros(3))))
    gate.restart()
    assert gate.phase == 'rest'
    assert len([text for text in run(gate, obedient)[1] if text.startswith('push')]) == 3
