"""Faults in process: how they are answered and judged, and that the judge can say no."""

from dataclasses import replace

from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.fault import PlantEdit, PROCESS, REST
from multicontact_control.experiment.faults.in_process import RUN_TICKS, together
from multicontact_control.experiment.faults.judge import judge, MET_FORCE, Observation
from multicontact_control.experiment.faults.situation import with_obstacles
from multicontact_control.experiment.faults.vocabulary import (
    ELBOW_WALL,
    faults_of,
    SIDE_WALL,
)
from multicontact_control.experiment.study.presets.faults.jobs import in_fork
from multicontact_control.supervision.collision import CollisionWatch
from multicontact_control.supervision.validation import Watchdog
import numpy as np
import pytest

KINDS = faults_of(PROCESS)


@pytest.fixture(scope='module')
def world():
    """Return a rigid plant at the approach, with walls far away."""
    world = ClosedLoop(with_obstacles('quick', 'rigid', 0))
    while world.tick < 330:
        world.advance()
    return world


@pytest.mark.parametrize(('kind', 'reaction'), [
    (('nan', 'wrench'), 'hold'), (('dropped', 'joints'), 'float'),
    (('delayed', 'variance'), 'inflate'), (('duplicated', 'wrench'), 'none'),
    (('restarted', 'clock'), 'hold'), (('surface_gone', 'plant'), 'none')])
def test_fault_is_answered_as_declared(world, kind, reaction):
    row = in_fork(world, KINDS[kind], 1, 'approach')
    assert (row.reaction, row.safe, row.problems) == (reaction, True, '')
    # R may be three periods late, and a wrench that is missing is predicted for twelve.
    latest = {'variance': 0.008, 'wrench': 0.024}.get(kind[1], 0.004)
    assert 0.0 <= row.time_to_safe_s <= latest


def test_same_seed_same_row(world):
    rows = [in_fork(world, KINDS['biased', 'wrench'], seed, 'approach') for seed in (5, 5, 6)]
    assert rows[0] == rows[1]
    assert rows[0] != rows[2]


def test_fault_that_nobody_notices_is_not_safe(world, monkeypatch):
    """The judge judges: with a watchdog that believes everything, NaN reaches the law."""
    def believe(self, inputs):
        for place, numbers in zip(self._all_well, (
                inputs.joints.q, inputs.joints.qd, inputs.wrench.wrench,
                inputs.variance.variance)):
            place[:] = numbers
        return self._all_well
    monkeypatch.setattr(Watchdog, 'validate', believe)
    row = in_fork(world, KINDS['delayed', 'wrench'], 1, 'approach')
    assert not row.safe
    assert row.problems == 'declared reaction late'
    row = in_fork(world, KINDS['delayed', 'joints'], 1, 'approach')
    assert not row.safe


def test_fault_that_kills_its_process_is_not_safe(world, monkeypatch):
    monkeypatch.setattr(ClosedLoop, 'advance', lambda self, corrupt=None: 1 / 0)
    row = in_fork(world, KINDS['nan', 'wrench'], 1, 'approach')
    assert (row.safe, row.problems) == (False, 'died')
    row = in_fork(world, KINDS['nan', 'wrench'], 1, 'approach', KINDS['nan_q', 'joints'])
    assert (row.kind, row.input, row.problems) == (
        'two at once', 'wrench nan + joints nan_q', 'died')


def test_torque_without_a_limit_is_judged_by_the_rest(world):
    """Neither of the limits is there: nothing is beyond them, not even 1000 N m at once."""
    config = world.setup.controller
    free = replace(world.setup, controller=config.model_copy(update={
        'torque_limit': (), 'limits': config.limits.model_copy(update={'torque_rate': ()})}))
    torque = np.zeros((10, len(config.robot.joint_names)))
    torque[5:] = 1e3
    seen = Observation(torque, np.arange(1.0, 11.0) * config.period, np.zeros(10), 'none')
    row = judge(KINDS['biased', 'wrench'], 1, free, seen, where=PROCESS)
    assert (row.safe, row.peak_torque_fraction) == (True, 0.0)
    assert not judge(KINDS['biased', 'wrench'], 1, world.setup, seen, where=PROCESS).safe


def observation(setup, **changes):
    """Return what is seen while nothing happens."""
    time = np.arange(1.0, RUN_TICKS + 1.0) * setup.controller.period
    return Observation(
        np.zeros((RUN_TICKS, len(setup.controller.robot.joint_names))), time,
        np.zeros(RUN_TICKS), 'none', **changes)


@pytest.mark.parametrize(('kinds', 'short'), [
    ((('nan', 'wrench'), ('dropped', 'joints')), True),
    ((('nan', 'wrench'), ('frozen', 'joints')), True),
    ((('raises', '_gate.apply'), ('frozen', 'joints')), True),
    ((('biased', 'wrench'), ('dropped', 'joints')), False),
    ((('surface_gone', 'plant'), ('dropped', 'joints')), False)])
def test_pair_is_to_be_back_if_both_faults_pass_whatever_their_order(world, kinds, short):
    forces = np.zeros((RUN_TICKS, 2))
    seen = observation(world.setup, forces=forces, wanted=forces + 10.0)
    for one, other in (kinds, kinds[::-1]):
        row = judge(together(KINDS[one], KINDS[other]), 1, world.setup, seen, where=PROCESS,
                    phase=REST)
        assert row.shortfalls == ('not back at its command' if short else '')


@pytest.mark.parametrize(('wall', 'force', 'problems'), [
    (SIDE_WALL, MET_FORCE - 1.0, ''), (SIDE_WALL, MET_FORCE + 1.0, 'obstacle pressed too hard'),
    (ELBOW_WALL, MET_FORCE - 1.0, 'obstacle not noticed')])
def test_what_is_in_the_way_is_judged_whichever_fault_it_is(world, wall, force, problems):
    """The wrist sensor feels the side wall, so that no collision need be told of there."""
    met = np.zeros((RUN_TICKS, 2))
    met[100, wall] = force
    obstacle, other = KINDS['elbow_obstacle', 'plant'], KINDS['nan', 'wrench']
    for fault in (obstacle, together(obstacle, other), together(other, obstacle)):
        row = judge(fault, 1, world.setup, observation(world.setup, met=met), where=PROCESS)
        assert (row.problems, row.safe, row.peak_force_n) == (problems, not problems, force)


def test_side_wall_that_is_pressed_hard_is_not_safe(world):
    """The arm is in it by 3 cm; its contacts are not pressed as hard."""
    wall = replace(KINDS['side_wall', 'plant'], action=PlantEdit(
        lambda plant, choice: plant.contacts.put_before_tip(SIDE_WALL, -0.03)))
    row = in_fork(world, wall, 1, 'approach')
    assert 'obstacle pressed too hard' in row.problems
    assert row.peak_force_n > MET_FORCE


def test_run_is_long_enough_to_recover_in():
    """The longest fault and the recovery time fit into it."""
    assert RUN_TICKS >= 150 + 300 + 100


@pytest.mark.slow
@pytest.mark.parametrize('plant', ['rigid', 'puma'])
def test_obstacle_at_the_elbow_is_noticed_and_not_pressed_hard(plant, monkeypatch):
    """Without a reaction the slide goes on into it: 193 N once, for as long as it took."""
    world = ClosedLoop(with_obstacles('quick', plant, 0))
    while world.tick < 4100:
        world.advance()
    row = in_fork(world, KINDS['elbow_obstacle', 'plant'], 1, 'sliding')
    assert (row.reaction, row.safe, row.problems) == ('hold', True, '')
    assert 10.0 < row.peak_force_n < 40.0
    monkeypatch.setattr(CollisionWatch, 'cause', lambda self, found: '')
    row = in_fork(world, KINDS['elbow_obstacle', 'plant'], 1, 'sliding')
    assert not row.safe
    assert 'obstacle not noticed' in row.problems
    row = in_fork(world, KINDS['frozen', 'variance'], 1, 'sliding',
                  KINDS['elbow_obstacle', 'plant'])
    assert 'obstacle not noticed' in row.problems
    world.close()
