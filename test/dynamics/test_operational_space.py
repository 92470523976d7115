"""Lambda, mu, p and the torque map against joint-space dynamics (P04 eqs 23-25)."""

from arms import controller_config, HOME, seven_joint_config, seven_joint_urdf
import equations
from multicontact_control.control.arm import ArmState
from multicontact_control.control.law import control_law, OK
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.paths import config_dir
from multicontact_control.records import CONTACT, CONTROL, FORCE_LAW, LAW
import numpy as np


def _acceleration(state, torque):
    """Joint acceleration of the free arm, and that of its operational point."""
    qdd = np.linalg.solve(state.mass_matrix, torque - state.coriolis - state.gravity)
    return state.jacobian @ qdd + state.jacobian_drift


def torque_for(model, q, v, acceleration, **nullspace):
    """Return J^T Lambda (a + bias), with the null space as records of `LAW` and `JOINT` say it."""
    controls = np.zeros(1, dtype=CONTROL)
    arm, law, terms = ArmState(model, controls), controls['law'], model.terms
    arm.joints['torque_limit'] = np.inf
    controls['task']['acceleration'] = acceleration
    for name, value in nullspace.items():
        (law if name in LAW.names else arm.joints)[name] = value
    arm.update(q, v)
    assert control_law(
        controls, arm.joints, terms.mass_matrix, terms.jacobian, terms.jacobian_rate,
        np.zeros(0, dtype=CONTACT), np.zeros(0, dtype=FORCE_LAW)) == OK
    return arm.joints['torque'].copy()


def test_operational_force_gives_the_commanded_acceleration():
    """F = Lambda a + mu + p makes the operational point accelerate by a (P04 eqs 24-25)."""
    puma, rng = RobotModel(controller_config().robot, config_dir()), np.random.default_rng(1)
    for _ in range(10):
        q, v, a = HOME + 0.3 * rng.standard_normal(6), *rng.standard_normal((2, 6))
        torque = torque_for(puma, q, v, a)
        state = puma.update(q, v)
        np.testing.assert_allclose(_acceleration(state, torque), a, atol=1e-9)
        space = equations.operational_space(state)
        np.testing.assert_allclose(torque, state.jacobian.T @ (
            space.Lambda @ a + space.mu + space.p), atol=1e-9)


def test_redundant_arm_gives_the_commanded_acceleration_in_any_null_space_motion(tmp_path):
    """J M^-1 of what damping, posture and stops add is 0, to rounding."""
    model = RobotModel(seven_joint_config(seven_joint_urdf(tmp_path)), tmp_path)
    rng = np.random.default_rng(4)
    for _ in range(10):
        q, v, a, posture = *rng.standard_normal((2, 7)), rng.standard_normal(6), np.ones(7)
        lower, upper = q - 0.05, q + np.array([0.03] * 3 + [np.inf] * 4)
        free, damped, pulled = (torque_for(model, q, v, a, **each) for each in (
            {}, {'nullspace_damping': 10.0},
            {'nullspace_damping': 10.0, 'posture_stiffness': 25.0, 'stop_stiffness': 400.0,
             'posture': posture, 'lower': lower, 'upper': upper}))
        state = model.update(q, v)
        for torque in (free, damped, pulled):
            np.testing.assert_allclose(_acceleration(state, torque), a, atol=1e-8)
        assert (damped - free) @ v < 0.0
        assert np.abs(np.linalg.solve(state.mass_matrix, pulled - damped)).max() > 0.1
        space = equations.operational_space(state)
        np.testing.assert_allclose(pulled, equations.joint_torque(
            space.Lambda @ a + space.mu + space.p, state, space, 10.0,
            equations.posture_pull(q, posture, lower, upper, 5.0, 0.1)), atol=1e-8)
