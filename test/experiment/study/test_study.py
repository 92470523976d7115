"""What all studies have in common: options, dry run, resuming, the same files."""

import io
import json

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.study.presets.compare.study import ComparisonStudy
from multicontact_control.experiment.study.presets.faults.study import FaultStudy
from multicontact_control.experiment.study.presets.laws.study import LawStudy
from multicontact_control.experiment.study.presets.robots.study import RobotStudy
from multicontact_control.experiment.study.presets.robustness.study import RobustnessStudy
from multicontact_control.experiment.study.presets.sweep.study import sweep_study
from multicontact_control.experiment.study.presets.tune.study import TuneStudy
from multicontact_control.experiment.study.study import run_study, StudyOptions
import pytest
from rich.console import Console

SMALL = RobustnessStudy(('rigid',), ('fixed',), (1.0, 20.0), (1,))


def shown_of(study, options):
    shown = io.StringIO()
    run_study(study, options, Console(file=shown, width=160))
    return shown.getvalue()


@pytest.mark.parametrize(('study', 'jobs', 'grid'), [
    (ComparisonStudy(('rigid',), ('fixed',), 2), 20, '  estimators: fixed\n'),
    (SMALL, 2, '  delays: 1\n'),
    (sweep_study('delay', seeds=(0,)), None, '  plants: '),
    (RobotStudy(('puma', 'iiwa'), ('pybullet', 'mujoco-native'), ('quick', 'curved')), 6,
     '  engines: pybullet, mujoco-native\n'),
    (LawStudy(('rigid',), ('best',), 1, quick=True), 5, '  seeds: 1\n'),
    (TuneStudy('feedforward', ('rigid',)), 4, '  plants: rigid\n'),
    (FaultStudy(7, quick=True), None, '  seeds: 7, 8, 9, 10, 11, 12\n')],
    ids=lambda value: getattr(value, 'title', ''))
def test_dry_run_lists_the_grid_and_leaves_nothing(tmp_path, study, jobs, grid):
    text = shown_of(study, StudyOptions(tmp_path / 'out', jobs=2, dry_run=True))
    assert grid in text
    assert f'{jobs or len(study.jobs())} {study.unit}, 0 of them finished' in text
    assert not (tmp_path / 'out').exists()


@pytest.mark.slow
def test_second_start_takes_what_is_kept_and_writes_the_same_files(tmp_path):
    options = StudyOptions(tmp_path, jobs=1)
    assert '2 runs, 0 of them finished' in shown_of(SMALL, options)
    content = (tmp_path / 'robustness.json').read_bytes()
    ages = {path: path.stat().st_mtime_ns for path in tmp_path.glob('cells/*')}
    assert len(ages) == 4  # and their traces
    assert '2 runs, 2 of them finished' in shown_of(SMALL, options)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob('cells/*')} == ages
    assert (tmp_path / 'robustness.json').read_bytes() == content
    points = json.loads(content)['points']
    assert [(point['ratio'], point['stable']) for point in points] == [(1.0, True), (20.0, False)]
    for name in ('robustness.png', 'robustness.html'):
        assert (tmp_path / name).stat().st_size > 10000
    anew = StudyOptions(tmp_path, jobs=1, dry_run=True, overwrite=True)
    assert '2 runs, 0 of them finished' in shown_of(SMALL, anew)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob('cells/*')} == ages


def test_all_bad_values_are_named_before_the_folder_is_made(tmp_path):
    with pytest.raises(ConfigError) as error:
        run_study(ComparisonStudy(('ur5',), ('kalman',)), StudyOptions(
            tmp_path / 'out', jobs=2, dask='tcp://127.0.0.1:1'), Console(quiet=True))
    assert [each.field for each in error.value.errors] == ['jobs', 'plant', 'estimators']
    assert not (tmp_path / 'out').exists()
