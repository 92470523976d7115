"""A held reference stands still, and then goes on where it was."""

from multicontact_control.control.reference import (
    CommandedReference,
    ReferenceConfig,
    ScenarioReference,
    SineConfig,
)
from multicontact_control.control.reference.holdable import HoldableReference
from multicontact_control.dynamics.pose import Pose
import numpy as np
import pytest

H = 0.002
START = Pose(np.zeros(3), np.eye(3))
NORMALS = np.array([[0.0, 0.0, -1.0]])
NOTHING = np.zeros(1)


def moving():
    config = ReferenceConfig(motion=SineConfig(start_time=0.0))
    return ScenarioReference(config, rate=1.0 / H, contact_names=('one',))


def test_hold_stands_still_and_release_goes_on_where_the_scenario_was():
    reference, other = HoldableReference(moving()), moving()
    for source in (reference, other):
        source.start(START, NORMALS)
    for k in range(500):
        reference.update(k * H, NOTHING)
        expected = other.update(k * H, NOTHING)
    here = Pose(np.array([0.1, 0.2, 0.3]), np.eye(3))
    reference.hold(here, np.ones(1, dtype=bool))
    for k in range(500, 800):
        held = reference.update(k * H, NOTHING)
        assert held.pose_des is here
        assert not held.twist_des.any()
        assert not held.acceleration_des.any()
    reference.release()
    resumed = reference.update(800 * H, NOTHING)
    expected = other.update(500 * H, NOTHING)
    np.testing.assert_allclose(
        resumed.pose_des.position_world, expected.pose_des.position_world, atol=1e-12)


def test_hold_keeps_the_desired_forces():
    commanded = CommandedReference(('one',))
    reference = HoldableReference(commanded)
    reference.start(START, NORMALS)
    commanded.set_forces({'one': 7.0})
    reference.update(0.0, NOTHING)
    reference.hold(START, np.ones(1, dtype=bool))
    commanded.set_forces({'one': 0.0})
    held = reference.update(H, NOTHING)
    assert held.alpha_des == pytest.approx([7.0])
    assert held.active.all()


def test_a_locked_reference_stands_still_until_it_is_unlocked_and_then_begins():
    reference, other = HoldableReference(moving(), locked=True), moving()
    for source in (reference, other):
        source.start(START, NORMALS)
    for k in range(300):
        task = reference.task(k * H)
        assert task.pose_des is START
        assert not task.active.any() and not task.alpha_des.any()
    reference.release()  # only a hold is released
    assert reference.task(300 * H).pose_des is START
    reference.unlock()
    np.testing.assert_allclose(reference.task(800 * H).pose_des.position_world,
                               other.task(500 * H).pose_des.position_world, atol=1e-12)
