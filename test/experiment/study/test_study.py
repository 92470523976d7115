"""What all studies have in common: options, dry run, folder, resuming."""

from dataclasses import asdict
import io
import json

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.faults.judge import FaultRow
from multicontact_control.experiment.study.cache import JobCache
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.jobs import JobResult
from multicontact_control.experiment.study.presets.compare.study import ComparisonStudy
from multicontact_control.experiment.study.presets.faults.study import FaultStudy
from multicontact_control.experiment.study.presets.laws.study import LawStudy
from multicontact_control.experiment.study.presets.robots.study import RobotStudy
from multicontact_control.experiment.study.presets.robustness.study import RobustnessStudy
from multicontact_control.experiment.study.presets.sweep.study import sweep_study
from multicontact_control.experiment.study.study import report_study, run_study, StudyOptions
import pytest
from rich.console import Console

SMALL = RobustnessStudy(('rigid',), ('fixed',), (1.0, 20.0), (1,))


def shown_of(study, options):
    shown = io.StringIO()
    run_study(study, options, Console(file=shown, width=160))
    return shown.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize(('study', 'jobs', 'words'), [
    (ComparisonStudy(('rigid',), ('fixed',), 2), 20, [
        'compare: 1 plant, 1 estimator, 2 observers, 2 seeds, 3 values of K_2',
        '  estimators: fixed\n', '  seeds: 0, 1\n', 'lead_window, true stiffness x 5',
        'will take about']),
    (SMALL, 2, ['map: 1 plant, 1 estimator, 2 stiffness ratios, 1 delay\n', '  delays: 1\n',
                'will take about']),
    (sweep_study('delay'), None, ['study delay: ', 'controller.force.input_delay [s]: ']),
    (RobotStudy(('puma', 'iiwa'), ('pybullet', 'mujoco-native'), ('quick', 'curved')), 6, [
        'robots: 2 robots, 2 engines, 2 scenarios, 1 seed\n', '  engines: pybullet, mujoco-nat']),
    (FaultStudy(7, quick=True), None, [
        'kinds', '  seeds: 7, 8, 9, 10, 11, 12\n', 'joints nan_q, ', 'will take about'])])
def test_dry_run_says_what_would_be_run_and_leaves_nothing(tmp_path, study, jobs, words):
    text = shown_of(study, StudyOptions(tmp_path / 'out', dry_run=True))
    for word in words:
        assert word in text
    assert f'{jobs or len(study.jobs())} {study.unit}, 0 of them finished before' in text
    assert not (tmp_path / 'out').exists()


@pytest.mark.slow
def test_second_start_takes_from_the_cache_and_gives_the_same_files(tmp_path):
    options = StudyOptions(tmp_path, jobs=1)
    assert '2 runs, 0 of them finished before; the other 2' in shown_of(SMALL, options)
    content = (tmp_path / 'robustness.json').read_bytes()
    ages = {path: path.stat().st_mtime_ns for path in tmp_path.glob('cells/*')}
    assert len(ages) == 4  # and their traces
    assert '2 runs, 2 of them finished before' in shown_of(SMALL, options)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob('cells/*')} == ages
    assert (tmp_path / 'robustness.json').read_bytes() == content
    anew = StudyOptions(tmp_path, jobs=1, dry_run=True, overwrite=True)
    assert '2 runs, 0 of them finished before; the other 2' in shown_of(SMALL, anew)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob('cells/*')} == ages


@pytest.mark.parametrize('study', [
    ComparisonStudy(('rigid',), ('fixed',), 1, quick=True), SMALL,
    FaultStudy(7, quick=True, plants=('rigid',)), LawStudy(('rigid',), ('best',), 1, quick=True),
    RobotStudy(('puma',), ('pybullet',), ('quick',)),
    sweep_study('delay', seeds=(0,))], ids=lambda study: study.title)
def test_study_of_which_everything_is_lost_says_so(tmp_path, study):
    jobs = study.jobs()
    keys = {job: str(number) for number, job in enumerate(jobs)}
    run = JobRun(tmp_path, JobCache(tmp_path), keys, dict.fromkeys(jobs, 'died'))
    shown = reported(study, run)
    assert shown.count(': died\n') == len(keys)
    assert 'plant rigid' in shown and ': died' in shown
    assert 'lost: ' in (tmp_path / f'{study.name}.html').read_text(encoding='utf-8')


def reported(study, run):
    """Return what is shown of a study that has lost jobs."""
    shown = io.StringIO()
    with pytest.raises(RunError, match=f'^{len(run.lost)} of {len(run.keys)} jobs were lost; '):
        report_study(study, study.content(run), run, Console(file=shown, width=1000))
    return shown.getvalue()


def test_what_was_not_lost_is_reported(tmp_path):
    study = FaultStudy(7, quick=True, plants=('rigid',))
    first, *others = study.jobs()
    cache = JobCache(tmp_path)
    for number, job in enumerate(others):
        kind, source, seed, *_ = job.faults[0]
        row = FaultRow(kind, source, seed, 'hold', 0.0, 1.0, 0.1, True, 'rigid', job.phase)
        cache.save(str(number), job, JobResult({'rows': [asdict(row)]}, {}, 0.1))
    keys = {first: 'first', **{job: str(number) for number, job in enumerate(others)}}
    shown = reported(study, JobRun(tmp_path, cache, keys, {first: 'died'}))
    assert f'{len(others)} faults of ' in shown
    assert f'lost: plant rigid, phase {first.phase}, ' in shown
    rows = json.loads((tmp_path / 'faults.json').read_text(encoding='utf-8'))['faults']
    assert len(rows) == len(others)


@pytest.mark.parametrize(('options', 'message'), [
    ({'jobs': -2}, '^jobs: expected a whole number >= 0, found -2\nplant: '),
    ({'jobs': 2, 'dask': 'tcp://127.0.0.1:1'},
     "^jobs: expected nothing together with --dask, .*\nplant: .*'ur5'\nestimators: ")])
def test_all_that_is_wrong_is_said_before_the_folder_is_made(tmp_path, options, message):
    study = ComparisonStudy(('ur5',), ('kalman',))
    with pytest.raises(ConfigError, match=message) as error:
        run_study(study, StudyOptions(tmp_path / 'out', **options), Console(quiet=True))
    assert str(error.value).count('\n') == 2  # a line for each
    assert not (tmp_path / 'out').exists()
