"""The faults in process: what they are made of, and what is written."""

import io
import json

from multicontact_control.experiment.faults.fault import PROCESS
from multicontact_control.experiment.faults.judge import FaultRow
from multicontact_control.experiment.faults.vocabulary import faults_of
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.presets.faults.jobs import (
    FaultJob,
    PHASE_TIMES,
    run_fault_job,
)
from multicontact_control.experiment.study.presets.faults.study import (
    FaultStudy,
    PAIRS,
    QUICK_PAIRS,
    SEEDS,
    situation,
)
from multicontact_control.experiment.study.study import report_study, run_study, StudyOptions
import pytest
from rich.console import Console

KINDS = faults_of(PROCESS)


@pytest.mark.parametrize('quick', [False, True])
def test_grid_has_every_fault_once_in_every_situation_and_early_phases_first(quick):
    jobs = FaultStudy(3, quick).jobs()
    faults = [fault for job in jobs for fault in job.faults]
    assert len(faults) == len(set(faults)) == (
        len(KINDS) + QUICK_PAIRS if quick else len(KINDS) * SEEDS + PAIRS)
    assert {(job.plant, job.phase) for job in jobs} == {
        (plant, phase) for plant in ('rigid', 'puma') for phase in PHASE_TIMES} == {
        situation(number, ('rigid', 'puma')) for number in range(6)}
    times = [PHASE_TIMES[job.phase] for job in jobs]
    assert times == sorted(times)


def test_table_has_a_line_for_each_kind_and_names_what_was_not_safe(tmp_path):
    values = {'kind': 'nan', 'input': 'wrench', 'reaction': 'hold', 'time_to_safe_s': 0.004,
              'peak_force_n': 12.0, 'peak_torque_fraction': 0.2, 'safe': True, 'plant': 'rigid',
              'phase': 'rest'}
    rows = [FaultRow(**{**values, 'seed': 1}),
            FaultRow(**{**values, 'seed': 2, 'reaction': 'float', 'time_to_safe_s': 0.012}),
            FaultRow(**{**values, 'seed': 3, 'kind': 'huge', 'time_to_safe_s': -1.0,
                        'safe': False, 'problems': 'force <beyond> the ceiling'})]
    shown = io.StringIO()
    report_study(FaultStudy(), rows, JobRun(tmp_path, {}), Console(file=shown, width=160))
    written = json.loads((tmp_path / 'faults.json').read_text(encoding='utf-8'))['faults']
    assert [row['seed'] for row in written] == [1, 2, 3]
    page = (tmp_path / 'faults.html').read_text(encoding='utf-8')
    for text in (shown.getvalue(), page.replace('&lt;', '<').replace('&gt;', '>')):
        for word in ('3 faults of 2 kinds, 1 unsafe', 'force <beyond> the ceiling',
                     'float, hold', 'never', '1 not'):
            assert word in text


@pytest.mark.slow
def test_row_does_not_depend_on_the_faults_before_it():
    job = FaultJob('rigid', 'approach', 0, (('nan', 'wrench', 1), ('biased', 'wrench', 5)))
    later = FaultJob('rigid', 'rest', 0, (('nan', 'wrench', 1),))
    fresh = [run_fault_job(piece).metrics for piece in (later, job)]
    assert [run_fault_job(piece).metrics for piece in (job, later)] == fresh[::-1]


@pytest.mark.parametrize('plant', [
    pytest.param('rigid', marks=pytest.mark.slow),
    pytest.param('puma', marks=pytest.mark.nightly)])
def test_one_fault_of_every_kind_is_safe(tmp_path, plant):
    rows = run_study(FaultStudy(20, quick=True, plants=(plant,)), StudyOptions(tmp_path, jobs=1))
    assert len(rows) == len(KINDS) + QUICK_PAIRS
    assert [row for row in rows if not row.safe or row.shortfalls] == []
