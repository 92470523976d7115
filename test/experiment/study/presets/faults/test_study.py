"""The fault campaign: what it is made of, and what it writes."""

import io
import json

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.faults.fault import PROCESS
from multicontact_control.experiment.faults.judge import FaultRow
from multicontact_control.experiment.faults.vocabulary import faults_of
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.presets.faults.jobs import PHASE_TIMES
from multicontact_control.experiment.study.presets.faults.study import (
    FaultStudy,
    PAIRS,
    QUICK_PAIRS,
    SEEDS,
    situation,
)
from multicontact_control.experiment.study.study import report_study, run_study, StudyOptions
from multicontact_control.experiment.study.table import terminal_table
import pytest
from rich.console import Console

KEYS = ['kind', 'input', 'seed', 'reaction', 'time_to_safe_s', 'peak_force_n',
        'peak_torque_fraction', 'safe']
KINDS = faults_of(PROCESS)
PLANTS = ('rigid', 'puma')


def row(**changes):
    values = {'kind': 'nan', 'input': 'wrench', 'seed': 1, 'reaction': 'hold',
              'time_to_safe_s': 0.004, 'peak_force_n': 12.0, 'peak_torque_fraction': 0.2,
              'safe': True, 'plant': 'rigid', 'phase': 'rest'}
    return FaultRow(**{**values, **changes})


def test_there_are_enough_kinds_and_faults():
    assert len(KINDS) >= 40
    assert len(KINDS) * SEEDS >= 1000
    assert {situation(number, PLANTS) for number in range(6)} == {
        (plant, phase) for plant in PLANTS for phase in PHASE_TIMES}


@pytest.mark.parametrize('quick', [False, True])
def test_campaign_has_every_fault_once_and_early_phases_first(quick):
    jobs = FaultStudy(3, quick).jobs()
    faults = [fault for job in jobs for fault in job.faults]
    assert len(faults) == len(set(faults)) == (
        len(KINDS) + QUICK_PAIRS if quick else len(KINDS) * SEEDS + PAIRS)
    assert {(job.plant, job.phase) for job in jobs} == {
        situation(number, PLANTS) for number in range(6)}
    times = [PHASE_TIMES[job.phase] for job in jobs]
    assert times == sorted(times)


def test_rows_are_in_one_table_and_page(tmp_path):
    rows = [row(), row(seed=2, reaction='float', time_to_safe_s=0.012),
            row(input='joints', kind='frozen', time_to_safe_s=-1.0,
                safe=False, problems='force <beyond> the ceiling')]
    shown = io.StringIO()
    report_study(FaultStudy(), rows, JobRun(tmp_path, JobCache(tmp_path), {}, {}),
                 Console(file=shown, width=160))
    report = json.loads((tmp_path / 'faults.json').read_text(encoding='utf-8'))
    assert list(report) == ['faults']
    assert [list(found)[:len(KEYS)] for found in report['faults']] == [KEYS] * 3
    page = (tmp_path / 'faults.html').read_text(encoding='utf-8')
    for text in (shown.getvalue(), page.replace('&lt;', '<').replace('&gt;', '>')):
        assert '3 faults of 2 kinds, 1 unsafe' in text
        assert 'not safe: rigid, rest, joints frozen, seed 1: ' in text
        assert 'force <beyond> the ceiling' in text
        for word in ('float, hold', 'never', '1 not'):
            assert word in text


def test_terminal_of_80_columns_has_names_in_one_piece(tmp_path):
    """The ten words of its head left four letters to each kind."""
    rows = [row(kind=kind, input=source, reaction=reaction, time_to_safe_s=1.2,
                peak_force_n=160.7, off_command_s=1.2, transitions=7)
            for kind, source in KINDS for reaction in ('hold', 'float', 'inflate')]
    (section,) = FaultStudy().page(rows, tmp_path).sections
    shown = io.StringIO()
    Console(file=shown, width=80).print(
        terminal_table(section.heading, section.listing, 80))
    words = shown.getvalue().split()
    assert {'input', 'kind', 'reaction', 'short', 'safe', '160.7', '1200'} <= set(words)
    assert {name for fault in KINDS for name in fault if len(name) <= 13} <= set(words)


def test_negative_seed_is_refused():
    with pytest.raises(ConfigError, match='seed: expected a whole number >= 0, found -1'):
        FaultStudy(-1).check()


@pytest.mark.slow
def test_one_fault_of_every_kind_is_safe(tmp_path):
    rows = run_study(FaultStudy(20, quick=True), StudyOptions(tmp_path, jobs=2))
    assert len(rows) == len(KINDS) + QUICK_PAIRS
    assert [row for row in rows if not row.safe or row.shortfalls] == []
