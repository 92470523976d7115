"""Robots that are not ours: slower, faster, encoders with steps, a sensor mounted wrong."""

from __future__ import annotations

from arms import HOME
from multicontact_control.config import SensorFrontEndConfig, WatchdogConfig
from multicontact_control.errors import CommandError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
import numpy as np
import pytest


@pytest.mark.parametrize(('rate', 'force'), [
    (125.0, {'damping_rate': 40.0, 'input_delay': 0.012, 'time_constant': 0.05}),
    (250.0, {'damping_rate': 60.0, 'input_delay': 0.008}), (1000.0, {})])
def test_a_robot_of_another_rate_presses_without_any_reaction(rate, force):
    """Ages, gaps and bounces are counted in periods: a single sample says nothing of a surface."""
    loop = ClosedLoop(resolve('quick', plant='rigid', noise_estimator={'rate': rate}, controller={
        'rate': rate, 'force': force,
        'watchdog': {'frozen_joint_samples': 0}}), commanded=True)
    forces = []
    free = loop.sample.wrench
    loop.advance()
    loop.control.set_forces({'table': 10.0, 'board': 10.0})
    for _ in range(round(3.0 * rate)):
        loop.advance()
        forces.append(loop.true_forces)
    np.testing.assert_allclose(np.mean(forces[-round(0.2 * rate):], axis=0), 10.0, atol=0.5)
    loop.advance(lambda inputs: inputs._replace(wrench=inputs.wrench._replace(wrench=free)))
    for _ in range(round(0.5 * rate)):
        loop.advance()
    loop.close()
    assert set(loop.control.reactions) == {'none'}
    assert not loop.control.rejected
    losses = [event for _, event in loop.control.events.events if 'lost' in event]
    assert not losses


@pytest.mark.parametrize(('samples', 'trips'), [
    (WatchdogConfig().frozen_joint_samples, False), (2, True)])
def test_encoder_with_steps_is_not_taken_for_a_frozen_one(samples, trips):
    """A joint that moves by less than a step in a period repeats itself."""
    step = 2.0 * np.pi / 2 ** 16

    def rounded(inputs):
        joints = inputs.joints
        q = step * np.round(joints.q / step)
        return inputs._replace(joints=joints._replace(q=q, qd=1e-3 * np.round(1e3 * joints.qd)))

    loop = ClosedLoop(resolve('quick', plant='rigid', controller={
        'watchdog': {'frozen_joint_samples': samples}}))
    for _ in range(700):
        loop.advance(rounded)
    loop.close()
    assert ('joints_frozen' in loop.control.rejected) == trips
    if not trips:
        assert set(loop.control.reactions) == {'none'}


def test_with_a_flipped_sensor_nothing_moves_before_the_push_test_is_passed():
    """As it is by default: every command is refused, and the arm stays where it is."""
    loop = ClosedLoop(resolve('quick', plant='rigid', controller={
        'sensor': {'require_push_test': SensorFrontEndConfig().require_push_test}}),
        commanded=True)

    def flipped(inputs):
        return inputs._replace(wrench=inputs.wrench._replace(wrench=-inputs.wrench.wrench))

    for k in range(1500):
        loop.advance(flipped)
        if k % 100 == 0:
            with pytest.raises(CommandError, match='~/push_test: expected passed'):
                loop.control.set_forces({'table': 10.0, 'board': 10.0})
    assert np.abs(loop.sample.q - HOME).max() < 1e-3
    assert not loop.control.output.active.any()
    loop.close()
