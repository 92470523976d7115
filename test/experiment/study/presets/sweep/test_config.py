from multicontact_control.errors import ConfigError
from multicontact_control.experiment.study.presets.sweep.config import read_study, study_path
from multicontact_control.paths import config_dir
import pytest
import yaml

STUDY = {'name': 'one', 'scenario': 'step', 'plants': ['rigid']}


def study_of(tmp_path, seeds=None, **changes):
    path = tmp_path / 'study.yaml'
    path.write_text(yaml.safe_dump({**STUDY, **changes}))
    return read_study(path, seeds=seeds)


def test_range_is_spelled_out_evenly_by_difference_or_by_ratio(tmp_path):
    study = study_of(tmp_path, grid={
        'a.b': {'start': 0.1, 'stop': 0.5, 'count': 5},
        'c.d': {'start': 1.0, 'stop': 1000.0, 'count': 4, 'spacing': 'log'}, 'e.f': [True, 'x']})
    assert study.grid == {'a.b': (0.1, 0.2, 0.3, 0.4, 0.5), 'c.d': (1.0, 10.0, 100.0, 1000.0),
                          'e.f': (True, 'x')}


def test_seeds_are_a_list_or_a_number_and_can_be_replaced(tmp_path):
    assert study_of(tmp_path, seeds=None).seeds == (0,)
    path = tmp_path / 'study.yaml'
    for given, seeds in ((3, (0, 1, 2)), ([7, 2], (7, 2))):
        path.write_text(yaml.safe_dump({**STUDY, 'seeds': given}))
        assert read_study(path).seeds == seeds
    assert read_study(path, seeds=(5, 6)).seeds == (5, 6)


@pytest.mark.parametrize(('changes', 'message'), [
    ({'name': 'a/b'}, 'name: expected'),
    ({'plants': []}, 'plants: expected'),
    ({'plants': ['rigid', 'rigid']}, 'plants: expected each of them once'),
    ({'seeds': 0}, 'seeds: expected a number of seeds of at least 1, or a list, found 0'),
    ({'seeds': [1, -2]}, 'seeds: expected whole numbers >= 0, found -2'),
    ({'seeds': [1, 1]}, 'seeds: expected each of them once'),
    ({'seeds': 'many'}, 'seeds: expected'),
    ({'duration': 0.0}, 'duration: expected greater than 0, found 0.0'),
    ({'repeats': 3}, "repeats: expected a known key .*, found unknown key 'repeats'"),
    ({'grid': 'all'}, "grid: expected a valid dictionary, found 'all'"),
    ({'grid': {'a.b': 3}}, 'grid.a.b: expected a list of values, or a range of start, stop'),
    ({'grid': {'a.b': []}}, 'grid.a.b: expected a list of values'),
    ({'grid': {'a.b': {'start': 1.0, 'stop': 2.0}}}, 'grid.a.b.count: expected a value, found'),
    ({'grid': {'a.b': {'start': 1, 'stop': 2, 'count': 1}}}, 'grid.a.b.count: expected greater'),
    ({'grid': {'a.b': {'start': 0, 'stop': 2, 'count': 3, 'spacing': 'log'}}},
     'grid.a.b.start: expected a value above 0, for spacing: log, found 0.0'),
    ({'points': [{}]}, 'points.0: expected at least one parameter, found none'),
    ({'fixed': {'a.b': 1}, 'grid': {'a.b': [2]}}, 'fixed.a.b: expected a parameter that is not'),
])
def test_bad_study_is_refused_by_field_expectation_and_finding(tmp_path, changes, message):
    with pytest.raises(ConfigError, match=message) as caught:
        study_of(tmp_path, **changes)
    assert str(caught.value).startswith(f'{tmp_path / "study.yaml"}: ')
    assert '\n' not in str(caught.value)


def test_studies_that_come_with_the_package_are_found_by_name():
    names = sorted(path.stem for path in (config_dir() / 'studies').glob('*.yaml'))
    assert len(names) >= 2
    for name in names:
        assert read_study(study_path(name)).name == name
    with pytest.raises(ConfigError, match=rf"study: expected one of {', '.join(names)}, or a pa"):
        study_path('stifness')
