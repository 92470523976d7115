"""Kernels by themselves: sizes beyond a controller's, documentation, masks."""

import inspect
import time

from multicontact_control import algebra
from multicontact_control.contact import kernels as contact_kernels
from multicontact_control.contact.geometry import contact_normals
from multicontact_control.control import kernels
from multicontact_control.dynamics import kernels as dynamics_kernels
from multicontact_control.dynamics.pose import Pose, rotation_error
from multicontact_control.force import kernels as force_kernels
from multicontact_control.force.active_observer import ActiveObserver
from multicontact_control.force.noise import kernels as noise_kernels
from multicontact_control.force.observer_bank import ObserverBank
from multicontact_control.force.plant_model import design_force_loop
from multicontact_control.supervision import contact_kernels as state_kernels
from multicontact_control.supervision import (
    gate_kernels,
    reference_kernels,
    validation_kernels,
)
import numpy as np
import pytest

MODULES = (
    algebra, contact_kernels, dynamics_kernels, force_kernels, gate_kernels, kernels,
    noise_kernels, reference_kernels, state_kernels, validation_kernels)


@pytest.mark.parametrize('module', MODULES, ids=lambda module: module.__name__)
def test_every_compiled_function_says_what_it_does(module):
    compiled = [(name, value) for name, value in vars(module).items()
                if hasattr(value, 'py_func') and value.py_func.__module__ == module.__name__]
    assert compiled
    for name, dispatcher in compiled:
        assert inspect.getdoc(dispatcher.py_func), name
        annotations = dispatcher.py_func.__annotations__
        assert set(annotations) == {*inspect.signature(dispatcher.py_func).parameters, 'return'}


def twelve_column_law(joints, active_count):
    """Return the arguments of the law for twelve contacts, of which some are active."""
    random = np.random.default_rng(3)
    normals = random.standard_normal((12, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    rows = np.ascontiguousarray(contact_normals(normals, random.standard_normal((12, 3))).T)
    root = random.standard_normal((joints, joints))
    mass = root @ root.T + np.eye(joints)
    jacobian = random.standard_normal((6, joints))
    active = np.arange(12) < active_count
    loop = design_force_loop(
        6000.0, damping_rate=20.0, input_delay=0.006, period=0.002, time_constant=0.02)
    bank = ObserverBank([ActiveObserver(loop) for _ in range(12)], 1e-3)
    report = np.zeros((len(force_kernels.REPORT_ROWS), 12))
    report[force_kernels.MEASURED] = random.standard_normal(12)
    gains = np.array([900.0, 60.0, 20.0, 0.02, 2.0, 1e8, 0.0])
    law = [
        jacobian, np.zeros((6, joints)), np.asfortranarray(mass),
        random.standard_normal(joints), random.standard_normal(joints), np.zeros(3),
        np.asfortranarray(np.eye(3)), np.eye(4, 3), np.zeros((2, 6)), rows, active,
        np.where(active, 5.0, 0.0), np.full(12, 0.6), gains, False, True,
        np.stack([np.zeros(joints), np.zeros(joints), np.full(joints, np.inf)]),
        bank.matrices, bank.vectors, bank.scalars, bank.P_0]
    return report, np.empty(joints), law


def test_twelve_contact_columns_and_fourteen_joints_stay_below_a_millisecond():
    """Six of them active: more cannot be independent on one operational point."""
    report, torque, law = twelve_column_law(14, 6)
    times = []
    for _ in range(50):
        start = time.thread_time()
        assert kernels.control_law(report, torque, *law) == kernels.OK
        times.append(time.thread_time() - start)
    assert np.median(times) < 1e-3
    assert np.isfinite(torque).all()


def test_seven_active_contacts_are_dependent():
    report, torque, law = twelve_column_law(7, 7)
    before = report.copy()
    assert kernels.control_law(report, torque, *law) == kernels.DEPENDENT
    np.testing.assert_array_equal(report, before)


def test_contacts_that_are_not_active_change_nothing():
    """The law with twelve columns, two of them active, is that with these two alone."""
    report, torque, law = twelve_column_law(7, 2)
    few_report, few_torque = report[:, :2].copy(), np.empty(7)
    few = list(law)
    for k in (9, 10, 11, 12):  # rows, active, desired forces, R
        few[k] = np.ascontiguousarray(law[k][:2])
    for k in (17, 18, 19):  # observers
        few[k] = np.ascontiguousarray(law[k][:, :2])
    for _ in range(5):
        kernels.control_law(report, torque, *law)
        kernels.control_law(few_report, few_torque, *few)
        np.testing.assert_allclose(torque, few_torque, rtol=1e-12)
        np.testing.assert_allclose(report[:, :2], few_report, rtol=1e-12)
    np.testing.assert_array_equal(report[force_kernels.ESTIMATED, 2:], 0.0)


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
        dynamics_kernels.rotation_vector(turn @ rotation, np.asfortranarray(rotation), vector)
        np.testing.assert_allclose(
            vector, rotation_error(turn @ rotation, rotation), atol=1e-12, rtol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(vector), angle, atol=1e-12, rtol=1e-9)
