"""First touch and switches without a jump: in closed loop."""

from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
import numpy as np


def follow(world, ticks):
    """Advance; return true forces and torques, and states per tick."""
    forces, torques, states = [], [], []
    for _ in range(ticks):
        world.advance()
        forces.append(world.sample.contact_force.copy())
        torques.append(world.command)
        states.append(world.status.contact_states)
    return np.array(forces), np.array(torques), states


def test_first_touch_stays_below_three_preloads_and_its_switches_do_not_step_the_torque():
    """At a switch the torque moves by no more than from tick to tick without one."""
    forces, torques, states = follow(ClosedLoop(resolve('quick', plant='rigid')), 700)
    assert forces.max() < 3 * 2.0
    np.testing.assert_allclose(forces[-50:].mean(axis=0), 2.0, atol=0.1)
    limit = np.array(resolve('quick').controller.torque_limit)
    steps = (np.abs(np.diff(torques, axis=0)) / limit).max(axis=1)
    active = [tuple(state in ('impact', 'holding') for state in now) for now in states]
    switched = np.array([a != b for a, b in zip(active, active[1:])])
    assert switched.sum() == 2
    assert steps[switched].max() <= steps[100:][~switched[100:]].max()
