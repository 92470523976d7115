"""Where control must not start, the arm is held, and why is said."""

from __future__ import annotations

from arms import HOME
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
import numpy as np
import pytest

BOX = {'limits': {'workspace_upper': [0.6, 0.9, 0.6]}}
STOP = {'limits': {'joint_upper': [2.793, 3.927, 2.9, 2.967, 1.745, 4.643]}}


@pytest.mark.parametrize(('changes', 'place'), [
    (BOX, 'operational point: expected z in 0.3 to 0.6 m'), (STOP, 'joint3: ')])
def test_outside_its_limits_an_arm_is_held_where_it_is(changes, place):
    """The limits would have led it inside at once."""
    loop = ClosedLoop(resolve('quick', plant='rigid', controller=changes))
    for _ in range(500):
        loop.advance(lambda inputs: inputs._replace(joints=inputs.joints._replace(
            effort=np.zeros(6))))
        assert loop.status.reaction == 'hold'
        assert loop.status.causes == ('start_outside',)
    (found,) = loop.control.supervisor.outside
    assert found.startswith(place)
    assert np.abs(loop.sample.q - HOME).max() < 1e-4
    assert loop.sample.contact_force.max() == 0.0
    loop.close()


def test_control_starts_once_the_arm_is_inside():
    """Told another posture, as if it had been moved there by hand."""
    loop = ClosedLoop(resolve('quick', plant='rigid', controller={
        **STOP, 'sensor': {'frozen_ticks': 0}, 'watchdog': {'frozen_joint_ticks': 0}}))
    third = np.eye(6)[2]
    for k in range(400):
        joints = loop.inputs().joints._replace(
            q=HOME - 0.05 * min(k / 300, 1.0) * third, qd=-0.05 / 0.6 * (k < 300) * third)
        loop.control.step(loop.inputs()._replace(joints=joints))
        assert loop.control.supervisor.outside or k > 100
        loop.tick += 1
    assert loop.status.reaction == 'none'
    assert loop.control.supervisor.outside == ()
    loop.close()
