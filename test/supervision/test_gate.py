"""The gate: blends, nothing but finite torques within every limit, joints that brake."""

from arms import controller_config, HOME
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.control.arm import ArmState
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.paths import config_dir
from multicontact_control.supervision.gate import TorqueGate
import numpy as np
import pytest

CONFIG = controller_config()
ROBOT = RobotModel(CONFIG.robot, config_dir())
LIMIT = np.array(CONFIG.torque_limit)
STEP = np.array(CONFIG.limits.torque_rate) * CONFIG.period
REST = np.zeros(6)
START = np.array([1.0, 10.0, 0.0, 0.5, -0.5, 0.1])
TORQUE = np.array([3.0, -40.0, 0.0, 0.2, 0.5, -0.2])


def make(q=HOME, velocity=REST, config=CONFIG, limit=LIMIT, guarded=True):
    """Return a gate, and its arm at a posture."""
    arm = ArmState(ROBOT)
    assert arm.update(q, velocity)
    arm.joints['torque_limit'] = limit
    return TorqueGate(config, arm.joints, guarded=guarded), arm


def blending(**transition):
    """Return a gate that starts from a torque and has no limits."""
    config = controller_config(transition=transition)
    gate, _ = make(config=config, limit=np.inf, guarded=False)
    gate.begin(START)
    return gate


ANY = st.lists(st.floats(width=64), min_size=6, max_size=6)


@settings(max_examples=100, deadline=None)
@given(torques=st.lists(ANY, min_size=1, max_size=4), q=ANY, known=st.booleans(),
       laws=st.lists(st.sampled_from('ab'), min_size=4, max_size=4), over=st.booleans())
def test_gate_passes_finite_torques_within_limits_only(
        torques, q, known, laws, over):
    gate, arm = make()
    arm.joints['q'] = q
    before = None
    with np.errstate(all='ignore'):
        for law, torque in zip(laws, torques):
            if over:
                gate.go_over()
            out, _ = gate.apply(law, np.array(torque), known=known, seen=known)
            assert np.isfinite(out).all()
            assert (np.abs(out) <= LIMIT).all()
            if before is not None:
                assert (np.abs(out - before) <= STEP * (1 + 1e-9)).all()
            before = out


def test_gate_brakes_a_joint_before_its_stop():
    """A single joint under full torque, with the model's own dynamics (semi-implicit Euler)."""
    q, v = HOME.copy(), np.zeros(6)
    gate, arm = make()
    upper = np.array(CONFIG.limits.joint_upper)
    fastest = 0.0
    for _ in range(1500):
        state = ROBOT.update(q, v)
        arm.update(q, v)
        wanted = state.gravity + state.coriolis
        wanted[4] += 15.0
        torque, _ = gate.apply('law', wanted)
        v = v + 0.002 * np.linalg.solve(
            state.mass_matrix, torque - state.gravity - state.coriolis)
        v[[0, 1, 2, 3, 5]] = 0.0
        q = q + 0.002 * v
        fastest = max(fastest, v[4])
        assert q[4] < upper[4]
        assert v[4] < 1.02 * CONFIG.limits.joint_speed[4]
    assert fastest > 1.0
    assert abs(v[4]) < 0.02
    assert upper[4] - q[4] < 0.05


@pytest.mark.parametrize(('blend_time', 'torque_rate'), [
    (0.2, 1e6), (0.2, 100.0), (0.0, 100.0), (0.0, 1e9)])
def test_commanded_change_starts_at_the_torque_before_and_keeps_to_its_rate(
        blend_time, torque_rate):
    gate = blending(blend_time=blend_time, torque_rate=torque_rate)
    gate.go_over()
    torques = [gate.apply(None, TORQUE.copy())[0]]
    while (torques[-1] != TORQUE).any():
        torques.append(gate.apply(None, TORQUE.copy())[0])
    np.testing.assert_array_equal(torques[0], START)
    steps = np.diff(torques, axis=0)
    assert np.abs(steps).max() <= torque_rate * CONFIG.period * (1.0 + 1e-9)
    assert len(steps) >= blend_time / CONFIG.period
    assert (steps[:, 1] <= 0.0).all()


def test_commanded_change_fades_the_difference_at_its_start_alone():
    """What the law adds later comes through at once; torques within limits are not changed."""
    calm, moved = blending(blend_time=1.0), blending(blend_time=1.0)
    for gate in (calm, moved):
        gate.go_over()
        gate.apply(None, TORQUE.copy())
    np.testing.assert_allclose(
        moved.apply(None, TORQUE + 5.0)[0] - calm.apply(None, TORQUE.copy())[0], 5.0)
    gate, _ = make(velocity=0.1 * np.ones(6))
    gated, limits = gate.apply('law', TORQUE.copy())
    np.testing.assert_array_equal(gated, TORQUE)
    assert limits == ()


def test_change_of_law_is_continuous_and_decays_at_its_declared_rate():
    gate = blending()
    out = [gate.apply('old', START.copy())[0]]
    out += [gate.apply('new', TORQUE.copy())[0] for _ in range(60)]
    np.testing.assert_allclose(out[1], START)
    np.testing.assert_allclose(out[-1], TORQUE, atol=1e-5)
    steps = np.abs(np.diff(out, axis=0))
    assert (steps <= np.abs(START - TORQUE) * CONFIG.period / 0.003 + 1e-12).all()
    before = gate.apply('other', np.full(6, np.nan))[0]  # the change waits for numbers
    np.testing.assert_allclose(gate.apply('other', TORQUE.copy())[0], before, atol=1e-9)
