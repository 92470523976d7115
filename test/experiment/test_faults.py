"""The fault campaign: what it is made of, what it writes, and that it can fail."""

import json

from multicontact_control.control.watchdog import Believed, Watchdog
from multicontact_control.experiment.fault_campaign import (
    _in_fork,
    PHASE_TIMES,
    run_campaign,
    SEEDS,
    situation,
    write_report,
)
from multicontact_control.experiment.fault_run import RUN_TICKS, World
from multicontact_control.experiment.faults import fault_kinds
from multicontact_control.experiment.scenario import resolve
import numpy as np
import pytest

KEYS = ['kind', 'input', 'seed', 'reaction', 'time_to_safe_s', 'peak_force_n',
        'peak_torque_fraction', 'safe']
KINDS = {(kind.kind, kind.input): kind for kind in fault_kinds()}


@pytest.fixture(scope='module')
def world():
    """Return a rigid plant at the approach."""
    world = World(resolve('quick', plant='rigid', seed=0))
    while world.tick < 330:
        world.advance()
    return world


def test_there_are_enough_kinds_and_faults():
    assert len(KINDS) == len(fault_kinds()) >= 40
    assert len(KINDS) * SEEDS >= 1000
    assert {situation(number) for number in range(6)} == {
        (plant, phase) for plant in ('rigid', 'puma') for phase in PHASE_TIMES}


@pytest.mark.parametrize(('kind', 'reaction'), [
    (('nan', 'wrench'), 'hold'), (('dropped', 'joints'), 'float'),
    (('delayed', 'variance'), 'inflate'), (('duplicated', 'wrench'), 'none'),
    (('restarted', 'clock'), 'hold'), (('surface_gone', 'plant'), 'none')])
def test_fault_is_answered_as_declared(world, kind, reaction):
    row = _in_fork(world, KINDS[kind], 1, 'approach')
    assert (row.reaction, row.safe, row.problems) == (reaction, True, '')
    assert 0.0 <= row.time_to_safe_s <= 0.004


def test_same_seed_same_row(world):
    rows = [_in_fork(world, KINDS['biased', 'wrench'], seed, 'approach') for seed in (5, 5, 6)]
    assert rows[0] == rows[1]
    assert rows[0] != rows[2]


def test_fault_that_nobody_notices_is_not_safe(world, monkeypatch):
    """The judge judges: with a watchdog that believes everything, NaN reaches the law."""
    def believe(self, inputs):
        return Believed(np.array(inputs.joints.q), np.array(inputs.joints.qd),
                        np.array(inputs.wrench.wrench), np.array(inputs.variance.variance),
                        (), ())
    monkeypatch.setattr(Watchdog, 'judge', believe)
    row = _in_fork(world, KINDS['delayed', 'wrench'], 1, 'approach')
    assert not row.safe
    assert row.problems == 'declared reaction late'
    row = _in_fork(world, KINDS['delayed', 'joints'], 1, 'approach')
    assert not row.safe


def test_fault_that_kills_its_process_is_not_safe(world, monkeypatch):
    monkeypatch.setattr(World, 'advance', lambda self, fault=None: 1 / 0)
    row = _in_fork(world, KINDS['nan', 'wrench'], 1, 'approach')
    assert (row.safe, row.problems) == (False, 'died')


def test_report_has_the_promised_keys(world, tmp_path):
    row = _in_fork(world, KINDS['nan', 'wrench'], 1, 'approach')
    report = json.loads(write_report(tmp_path / 'new', [row]).read_text(encoding='utf-8'))
    assert list(report) == ['faults']
    assert list(report['faults'][0])[:len(KEYS)] == KEYS


def test_run_is_long_enough_to_recover_in():
    """The longest fault and the recovery time fit into it."""
    assert RUN_TICKS >= 150 + 25 + 100


@pytest.mark.slow
def test_one_fault_of_every_kind_is_safe():
    rows = run_campaign(20, quick=True, jobs=2)
    assert len(rows) == len(KINDS)
    assert [row for row in rows if not row.safe] == []
