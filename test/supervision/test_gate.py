"""The gate: nothing but finite torques within every limit, and joints that brake."""

from arms import controller_config, HOME
from hypothesis import given, settings
from hypothesis import strategies as st
from multicontact_control.control.arm_state import ArmState
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.paths import config_dir
from multicontact_control.supervision.gate import TorqueGate
import numpy as np

CONFIG = controller_config()
ROBOT = RobotModel(CONFIG.robot, config_dir())
LIMIT = np.array(CONFIG.torque_limit)
STEP = np.array(CONFIG.limits.torque_rate) * CONFIG.period


def view_arm(q, velocity):
    arm = ArmState(ROBOT)
    assert arm.update(q, velocity)
    return arm


ANY = st.lists(st.floats(width=64), min_size=6, max_size=6)


@settings(max_examples=100, deadline=None)
@given(torques=st.lists(ANY, min_size=1, max_size=4), fallback=ANY, q=ANY, known=st.booleans())
def test_gate_lets_nothing_through_that_is_not_finite_and_within_limits(
        torques, fallback, q, known):
    gate = TorqueGate(CONFIG, 6)
    arm = view_arm(HOME, np.zeros(6)) if known else None
    if arm is not None:
        arm.q[:] = q
    before = None
    with np.errstate(all='ignore'):
        for torque in torques:
            out = gate.apply(np.array(torque), np.array(fallback), arm)[0]
            assert np.isfinite(out).all()
            assert (np.abs(out) <= LIMIT).all()
            if before is not None:
                assert (np.abs(out - before) <= STEP * (1 + 1e-9)).all()
            before = out


def test_gate_does_not_touch_what_is_within_limits():
    torque = np.array([10.0, 20.0, -5.0, 1.0, 0.5, -0.2])
    gated, limits = TorqueGate(CONFIG, 6).apply(
        torque, np.zeros(6), view_arm(HOME, 0.1 * np.ones(6)))
    np.testing.assert_array_equal(gated, torque)
    assert limits == ()


def test_joint_driven_at_its_stop_comes_to_rest_before_it():
    """A single joint under full torque, with the model's own dynamics (semi-implicit Euler)."""
    gate = TorqueGate(CONFIG, 6)
    q, v = HOME.copy(), np.zeros(6)
    upper = np.array(CONFIG.limits.joint_upper)
    fastest = 0.0
    for _ in range(1500):
        state = ROBOT.update(q, v)
        wanted = state.gravity + state.coriolis
        wanted[4] += 15.0
        torque = gate.apply(wanted, state.gravity, view_arm(q, v))[0]
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
