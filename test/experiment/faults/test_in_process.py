"""The fault campaign: what it is made of, what it writes, and that it can fail."""

import json

from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.campaign import (
    campaign_cells,
    run_campaign,
    SEEDS,
    situation,
    write_report,
)
from multicontact_control.experiment.faults.cells import (
    FaultCell,
    in_fork,
    PHASE_TIMES,
    run_fault_cell,
)
from multicontact_control.experiment.faults.in_process import RUN_TICKS
from multicontact_control.experiment.faults.vocabulary import fault_kinds
from multicontact_control.experiment.scenario import resolve
from multicontact_control.supervision.validation import ValidatedInputs, Watchdog
import numpy as np
import pytest

KEYS = ['kind', 'input', 'seed', 'reaction', 'time_to_safe_s', 'peak_force_n',
        'peak_torque_fraction', 'safe']
KINDS = {(kind.kind, kind.input): kind for kind in fault_kinds()}


@pytest.fixture(scope='module')
def world():
    """Return a rigid plant at the approach."""
    world = ClosedLoop(resolve('quick', plant='rigid', seed=0))
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
    row = in_fork(world, KINDS[kind], 1, 'approach')
    assert (row.reaction, row.safe, row.problems) == (reaction, True, '')
    assert 0.0 <= row.time_to_safe_s <= 0.004


def test_same_seed_same_row(world):
    rows = [in_fork(world, KINDS['biased', 'wrench'], seed, 'approach') for seed in (5, 5, 6)]
    assert rows[0] == rows[1]
    assert rows[0] != rows[2]


def test_fault_that_nobody_notices_is_not_safe(world, monkeypatch):
    """The judge judges: with a watchdog that believes everything, NaN reaches the law."""
    def believe(self, inputs):
        return ValidatedInputs(np.array(inputs.joints.q), np.array(inputs.joints.qd),
                               np.array(inputs.wrench.wrench),
                               np.array(inputs.variance.variance), (), ())
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


@pytest.mark.parametrize('quick', [False, True])
def test_campaign_has_every_fault_once_and_early_phases_first(quick):
    cells = campaign_cells(3, quick=quick)
    faults = [fault for cell in cells for fault in cell.faults]
    assert len(faults) == len(set(faults)) == len(KINDS) * (1 if quick else SEEDS)
    assert {(cell.plant, cell.phase) for cell in cells} == {
        situation(number) for number in range(6)}
    times = [PHASE_TIMES[cell.phase] for cell in cells]
    assert times == sorted(times)


@pytest.mark.slow
def test_fault_does_not_depend_on_those_before_it():
    """A world that others have used before gives the same rows as a fresh one."""
    cell = FaultCell('rigid', 'approach', 0, (('nan', 'wrench', 1), ('biased', 'wrench', 5)))
    later = FaultCell('rigid', 'rest', 0, (('nan', 'wrench', 1),))
    fresh = [run_fault_cell(piece).metrics for piece in (later, cell)]
    assert [run_fault_cell(piece).metrics for piece in (cell, later)] == fresh[::-1]


def test_report_has_the_promised_keys(world, tmp_path):
    row = in_fork(world, KINDS['nan', 'wrench'], 1, 'approach')
    report = json.loads(write_report(tmp_path / 'new', [row]).read_text(encoding='utf-8'))
    assert list(report) == ['faults']
    assert list(report['faults'][0])[:len(KEYS)] == KEYS


def test_run_is_long_enough_to_recover_in():
    """The longest fault and the recovery time fit into it."""
    assert RUN_TICKS >= 150 + 25 + 100


@pytest.mark.slow
def test_one_fault_of_every_kind_is_safe(tmp_path):
    rows = run_campaign(20, tmp_path, quick=True, jobs=2)
    assert len(rows) == len(KINDS)
    assert [row for row in rows if not row.safe] == []
