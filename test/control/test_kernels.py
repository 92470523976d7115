"""Kernels by themselves: sizes beyond a controller's, documentation, masks."""

import inspect
import time

from equations import contact_normals, rotation_error
from multicontact_control import algebra
from multicontact_control.contact import geometry, projections
from multicontact_control.control import arm_state, law, momentum, motion, wrench
from multicontact_control.dynamics import operational_space, rotations
from multicontact_control.dynamics.pose import Pose
from multicontact_control.force import force_law, linear_law, observer, stiffness
from multicontact_control.force.noise import kernels as noise_kernels
from multicontact_control.force.plant_model import design_force_loop
from multicontact_control.records import CONTACT, CONTROL, FORCE_LAW, JOINT
from multicontact_control.supervision import (
    contacts,
    gate,
    plausibility,
    readings,
    reference_limits,
    supervised_law,
)
import numpy as np
import pytest

MODULES = (
    algebra, arm_state, contacts, force_law, gate, geometry, law, linear_law, momentum, motion,
    noise_kernels, observer, operational_space, plausibility, projections, readings,
    reference_limits, rotations, stiffness, supervised_law, wrench)


@pytest.mark.parametrize('module', MODULES, ids=lambda module: module.__name__)
def test_every_compiled_function_says_what_it_does(module):
    compiled = [(name, value) for name, value in vars(module).items()
                if hasattr(value, 'py_func') and value.py_func.__module__ == module.__name__]
    assert compiled
    for name, dispatcher in compiled:
        assert inspect.getdoc(dispatcher.py_func), name
        annotations = dispatcher.py_func.__annotations__
        parameters = inspect.signature(dispatcher.py_func).parameters
        assert set(annotations) == {*parameters, 'return'}
        assert len(parameters) <= 10, name


def twelve_column_law(joints, active_count):
    """Return the arguments of the law for twelve contacts, of which some are active."""
    random = np.random.default_rng(3)
    normals = random.standard_normal((12, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    columns = np.zeros(12, dtype=CONTACT)
    columns['N'] = contact_normals(normals, random.standard_normal((12, 3))).T
    root = random.standard_normal((joints, joints))
    mass = root @ root.T + np.eye(joints)
    jacobian = random.standard_normal((6, joints))
    columns['active'] = np.arange(12) < active_count
    columns['alpha_des'] = np.where(columns['active'], 5.0, 0.0)
    columns['noise_variance'], columns['alpha_meas'] = 0.6, random.standard_normal(12)
    loop = design_force_loop(
        6000.0, damping_rate=20.0, input_delay=0.006, period=0.002, time_constant=0.02)
    controls = np.zeros(1, dtype=CONTROL)
    for name, value in (('k_p', 900.0), ('k_v', 60.0), ('K_2', 20.0), ('friction_speed', 0.02),
                        ('nullspace_damping', 2.0), ('max_condition', 1e8),
                        ('decoupled', True)):
        controls['law'][name] = value
    controls['frame']['rotation'] = controls['task']['rotation'] = np.eye(3)
    controls['measured'] = True
    arm = np.zeros(joints, dtype=JOINT)
    arm['velocity'], arm['bias_torque'] = random.standard_normal((2, joints))
    controls['frame']['twist'] = jacobian @ arm['velocity']
    arm['torque_limit'] = np.inf
    laws = np.zeros(12, dtype=FORCE_LAW)
    laws['observer'] = observer.make_observers([observer.design_observer(loop)] * 12)
    return [controls, arm, np.asfortranarray(mass), np.asfortranarray(jacobian),
            np.asfortranarray(np.zeros((6, joints))), columns,
            laws]


def test_twelve_contact_columns_and_fourteen_joints_stay_below_a_millisecond():
    """Six of them active: more cannot be independent on one operational point."""
    arguments = twelve_column_law(14, 6)
    times = []
    for _ in range(50):
        start = time.thread_time()
        assert law.control_law(*arguments) == law.OK
        times.append(time.thread_time() - start)
    assert np.median(times) < 1e-3
    assert np.isfinite(arguments[1]['torque']).all()


def test_seven_active_contacts_are_dependent():
    arguments = twelve_column_law(7, 7)
    before = arguments[5].tobytes(), arguments[6].tobytes()
    assert law.control_law(*arguments) == law.DEPENDENT
    assert (arguments[5].tobytes(), arguments[6].tobytes()) == before


def test_contacts_that_are_not_active_change_nothing():
    """The law with twelve columns, two of them active, is that with these two alone."""
    arguments, few = twelve_column_law(7, 2), twelve_column_law(7, 2)
    for k in (5, 6):
        few[k] = few[k][:2].copy()
    for _ in range(5):
        law.control_law(*arguments)
        law.control_law(*few)
        np.testing.assert_allclose(arguments[1]['torque'], few[1]['torque'], rtol=1e-12)
        for name in ('alpha_est', 'alpha_rate_est', 'innovation', 'prior_variance'):
            np.testing.assert_allclose(arguments[5][name][:2], few[5][name], rtol=1e-12)
    np.testing.assert_array_equal(arguments[5]['alpha_est'][2:], 0.0)


def test_cholesky_refuses_what_is_not_positive_definite():
    L = np.zeros((2, 2))
    assert algebra.cholesky(np.array([[4.0, 2.0], [2.0, 5.0]]), L, 0.0)
    np.testing.assert_allclose(np.tril(L), [[2.0, 0.0], [1.0, 2.0]])
    assert not algebra.cholesky(np.array([[1.0, 2.0], [2.0, 1.0]]), L, 0.0)
    assert not algebra.cholesky(np.array([[1.0, 1.0], [1.0, 1.0 + 1e-13]]), L, 1e-12)
    assert not algebra.cholesky(np.full((2, 2), np.nan), L, 0.0)


@pytest.mark.parametrize('angle', [0.0, 1e-12, 1e-6, 0.3, 3.0, np.pi - 1e-4, np.pi - 1e-9])
def test_rotation_vector_equals_scipy(angle):
    random = np.random.default_rng(5)
    vector = np.empty(3)
    for _ in range(50):
        axis = random.standard_normal(3)
        quaternion = random.standard_normal(4)
        rotation = Pose.from_quaternion(np.zeros(3), quaternion).rotation_world
        turn = Pose.from_quaternion(np.zeros(3), np.append(
            np.sin(angle / 2) * axis / np.linalg.norm(axis), np.cos(angle / 2))).rotation_world
        rotations.rotation_vector(turn @ rotation, rotation, vector)
        np.testing.assert_allclose(
            vector, rotation_error(turn @ rotation, rotation), atol=1e-12, rtol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(vector), angle, atol=1e-12, rtol=1e-9)
