"""Lambda, mu, p and the torque map against joint-space dynamics (P04 eqs 23-25)."""

from arms import controller_config, HOME, seven_joint_config, seven_joint_urdf
from multicontact_control.dynamics.operational_space import (
    joint_torque,
    operational_space,
    task_inertia,
)
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import ShapeError, SingularTaskError
from multicontact_control.paths import config_dir
import numpy as np
import pytest


@pytest.fixture
def puma():
    return RobotModel(controller_config().robot, config_dir())


def _acceleration(state, torque):
    """Joint acceleration of the free arm, and that of its operational point."""
    qdd = np.linalg.solve(state.mass_matrix, torque - state.coriolis - state.gravity)
    return state.jacobian @ qdd + state.jacobian_drift


def test_operational_force_gives_the_commanded_acceleration(puma):
    """F = Lambda a + mu + p makes the operational point accelerate by a (P04 eqs 24-25)."""
    rng = np.random.default_rng(1)
    for _ in range(10):
        state = puma.update(HOME + 0.3 * rng.standard_normal(6), rng.standard_normal(6))
        space = operational_space(state)
        a = rng.standard_normal(6)
        torque = joint_torque(space.Lambda @ a + space.mu + space.p, state, space)
        np.testing.assert_allclose(_acceleration(state, torque), a, atol=1e-9)


def test_redundant_arm_gives_the_commanded_acceleration_and_damps_the_rest(tmp_path):
    """The null-space torque does not reach the operational point and takes energy."""
    model = RobotModel(seven_joint_config(seven_joint_urdf(tmp_path)), tmp_path)
    rng = np.random.default_rng(2)
    q, v = rng.standard_normal((2, 7))
    state = model.update(q, v)
    space = operational_space(state)
    a = rng.standard_normal(6)
    force = space.Lambda @ a + space.mu + space.p
    torque = joint_torque(force, state, space, nullspace_damping=3.0)
    np.testing.assert_allclose(_acceleration(state, torque), a, atol=1e-9)
    undamped = joint_torque(force, state, space)
    assert (torque - undamped) @ v < 0.0


def test_operational_space_quantities_are_consistent(puma):
    """J J_bar = 1, Lambda is symmetric and J^T p is the gravity torque."""
    state = puma.update(HOME, np.zeros(6))
    space = operational_space(state)
    np.testing.assert_allclose(state.jacobian @ space.J_bar, np.eye(6), atol=1e-9)
    np.testing.assert_allclose(space.Lambda, space.Lambda.T, atol=1e-9)
    np.testing.assert_allclose(state.jacobian.T @ space.p, state.gravity, atol=1e-9)
    np.testing.assert_allclose(space.mu, 0.0, atol=1e-12)


def test_armature_is_in_the_task_inertia(puma):
    """Without its rotors the PUMA's wrist would be many times lighter."""
    state = puma.update(HOME, np.zeros(6))
    bare = RobotModel(
        controller_config(robot={'armature': []}).robot, config_dir()).update(HOME, np.zeros(6))
    with_rotors = np.diag(task_inertia(state.mass_matrix, state.jacobian))
    without = np.diag(task_inertia(bare.mass_matrix, bare.jacobian))
    assert (with_rotors > 1.2 * without).all()


def test_task_inertia_refuses_a_singular_posture(puma):
    """At a stretched wrist no torque accelerates every direction."""
    straight = HOME.copy()
    straight[4] = 0.0
    state = puma.update(straight, np.zeros(6))
    with pytest.raises(SingularTaskError, match='condition number below 1e'):
        task_inertia(state.mass_matrix, state.jacobian)


def test_task_inertia_refuses_a_jacobian_of_another_width():
    """The message names the array."""
    with pytest.raises(ShapeError, match=r'jacobian: expected shape \(2, 3\), found \(2, 4\)'):
        task_inertia(np.eye(3), np.zeros((2, 4)))
