"""Tuning: what is tried, what counts as best, and what is written."""

from multicontact_control.config import read_yaml
from multicontact_control.experiment.scenario import resolve
from multicontact_control.experiment.study.presets.tune import study as tuning
from multicontact_control.experiment.study.presets.tune.study import (
    cost,
    read_ranges,
    SCALES,
    TuneStudy,
)
from multicontact_control.experiment.study.study import run_study, StudyOptions
from multicontact_control.force.laws import LAWS
from multicontact_control.paths import config_dir
import pytest


def test_every_law_has_ranges_whose_ends_are_acceptable():
    assert set(read_yaml(config_dir() / 'tuning.yaml')) == set(LAWS)
    for law in LAWS:
        tried = TuneStudy(law).jobs()
        assert len(tried) == len(set(tried)) > 1
        assert {job.seed for job in tried} == {0}
        ranges = read_ranges(law)
        for values in ([each[0] for each in ranges.values()], [each[-1] for each in
                                                               ranges.values()]):
            next(job for job in tried if job.settings == tuple(zip(ranges, values))).setup()


def test_cost_adds_figures_and_refuses_what_is_not_stable():
    row = {'stable': 1, 'runs': 1, **SCALES}
    assert cost(row) == pytest.approx(len(SCALES))
    assert cost(row | {'stable': 0}) == float('inf')
    assert cost(row | {'rise_s': None}) == float('inf')


def test_table_says_why_a_combination_has_no_cost(tmp_path):
    row = {'settings': {'a.b': 1.0}, 'stable': 1, 'runs': 1, **SCALES}
    page = TuneStudy('dob').page([
        {**row, 'cost': 6.0}, {**row, 'cost': None, 'rise_s': None},
        {**row, 'cost': None, 'stable': 0, 'rise_s': None}], tmp_path)
    cells = [line.cells[0] for line in page.sections[0].listing.lines]
    assert cells[0] == '6.00' and 'rise_s' in cells[1] and 'stable' in cells[2]


@pytest.mark.slow
def test_best_combination_is_written_judged_on_other_seeds_and_not_run_again(
        tmp_path, monkeypatch):
    monkeypatch.setattr(tuning, 'read_ranges', lambda law: {
        'controller.force.damping_rate': [40.0, 100.0]})
    monkeypatch.setattr(tuning, 'JUDGED_ON', (1,))
    content = run_study(TuneStudy('dob', ('rigid',)), StudyOptions(tmp_path, jobs=1))
    assert content[0]['cost'] <= content[1]['cost']
    assert content[0]['judged'][0]['stable'] == 1
    setup = resolve('quick', preset=str(tmp_path / 'dob.yaml'))
    assert setup.controller.force.law == 'dob'
    assert setup.controller.force.damping_rate == content[0]['settings'][
        'controller.force.damping_rate']
    ages = {path: path.stat().st_mtime_ns for path in tmp_path.glob('cells/*')}
    assert len(ages) == 3
    assert run_study(TuneStudy('dob', ('rigid',)), StudyOptions(tmp_path, jobs=1)) == content
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob('cells/*')} == ages
