"""A study's file: what it may say, what a user chooses of it, and the runs it makes."""

from multicontact_control.cli.options import described
from multicontact_control.config import NoiseEstimatorConfig, read_yaml
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.study.cells import run_cells
from multicontact_control.experiment.study.config import read_choices, read_study, select
from multicontact_control.experiment.study.presets import study_of
from multicontact_control.force.laws import LAWS
from multicontact_control.force.noise import lead_filter
from multicontact_control.paths import config_dir
import pytest
import yaml

STIFFNESS, DELAY = 'plant.surfaces.*.stiffness', 'plant.actuator_delay_ticks'
ESTIMATOR, DAMPING = 'noise_estimator.estimator', 'controller.force.damping_rate'
STUDY = {'name': 'one', 'scenario': 'step', 'plants': ['rigid'], 'seeds': 2, 'factors': {
    DELAY: [0, 2], ESTIMATOR: ['fixed', 'lead_window']}}


@pytest.fixture(name='read')
def fixture_read(tmp_path):
    """Return what reads a study with some changes from its file."""
    def read(**changes):
        path = tmp_path / 'study.yaml'
        path.write_text(yaml.safe_dump({**STUDY, **changes}, sort_keys=False))
        return read_study(str(path))
    return read


@pytest.fixture(name='preset', scope='module')
def fixture_preset():
    """Return what gives a study of config/studies with some choices."""
    def preset(name, quick=False, **choices):
        study = read_study(name)
        short = {'seed': study.seeds[:1], **study.quick} if quick else {}
        return study_of(select(study, {**short, **choices}))
    return preset


def test_ranges_are_even_and_levels_keep_their_labels(read):
    factors = read(factors={
        'a': {'start': 0.1, 'stop': 0.5, 'count': 5}, 'e': [True, 'x'],
        'c': {'start': 1.0, 'stop': 1000.0, 'count': 4, 'spacing': 'log'},
        'ratio': {'start': 1, 'stop': 2, 'count': 2, 'sets': 'p', 'multiples_of': 'q'},
        'level': {'plain': {}, 'soft': {'a.b': 1}}}).parts[''].factors
    assert [[value for value, _ in factors[name].settings(name)] for name in 'ace'] == [
        [0.1, 0.2, 0.3, 0.4, 0.5], [1.0, 10.0, 100.0, 1000.0], [True, 'x']]
    assert factors['ratio'].settings('ratio') == [(1.0, {'p': 1.0}), (2.0, {'p': 2.0})]
    assert factors['level'].settings('level') == [('plain', {}), ('soft', {'a.b': 1})]


BAD_IN_FILE = [
    ({'name': 'a/b'}, 'name'), ({'plants': []}, 'plants'), ({'seeds': [0, -1]}, 'seeds.1'),
    ({'seeds': 0}, 'seeds'), ({'duration': 0.9}, 'duration'), ({'repeats': 3}, 'repeats'),
    ({'factors': 'all'}, 'factors'), ({'factors': {'a.b': 3}}, 'factors.a.b'),
    ({'factors': {'a.b': {'start': 1.0, 'stop': 2.0}}}, 'factors.a.b'),
    ({'factors': {'a.b': {'start': 0, 'stop': 2, 'count': 3, 'spacing': 'log'}}}, 'factors.a.b'),
    ({'columns': [{'aggregate': 'mean', 'name': 'x'}]}, 'columns.0.aggregate')]


@pytest.mark.parametrize(('changes', 'field'), [
    *((changes, f'study.yaml: {field}') for changes, field in BAD_IN_FILE),
    ({'scenario': 'papper'}, 'scenario'), ({'plants': ['x']}, 'plant'),
    ({'factors': {'controller.farce.x': [1]}}, 'factors.controller.farce.x'),
    ({'fixed': {'plant.x': 1}}, 'factors.plant.x'),
    ({'factors': {DAMPING: [20.0, -1.0]}}, rf'\({DAMPING} = -1.0\): force.damping_rate'),
    ({'factors': {'noise_estimator.rate': [250.0]}}, r'\(.*\): noise_estimator.rate')])
def test_bad_file_parameter_or_value_is_refused_before_anything_runs(read, changes, field):
    with pytest.raises(ConfigError, match=f'{field}: expected ') as caught:
        run_cells(select(read(**changes), {}))
    assert '\n' not in str(caught.value)


def test_cells_are_every_combination_with_every_seed_on_every_plant(read):
    cells = run_cells(select(read(plants=['rigid', 'puma']), {}))
    assert [tuple(cell.factors[name] for name in ('plant', DELAY, ESTIMATOR, 'seed'))
            for cell in cells] == [
        (plant, ticks, estimator, seed) for plant in ('rigid', 'puma') for ticks in (0, 2)
        for estimator in ('fixed', 'lead_window') for seed in (0, 1)]
    assert len({cell.key for cell in cells}) == 16
    assert all(cell.key == cell.job.key() for cell in cells)
    setup = cells[5].job.setup()
    assert (setup.plant.actuator_delay_ticks, setup.noise_estimator.estimator, setup.seed) == (
        2, 'fixed', 1)


def test_parts_have_what_the_study_has_and_the_values_of_the_files_for_the_rest(read):
    study = read(parts={
        'grid': {}, 'one': {'factors': {DAMPING: [30.0], DELAY: [3]}, 'seeds': [7]},
        'never': {'where': {'plant.drives': 'flexible'}},
        'soft': {'factors': {'ratio': {'values': [0.5], 'sets': STIFFNESS, 'multiples_of':
                                       'controller.contacts.*.stiffness'}}}})
    cells = run_cells(select(study, {'seed': (0,), **read_choices([f'{ESTIMATOR}=fixed'])}))
    rows = [tuple(cell.factors[name] for name in ('part', DELAY, DAMPING, 'ratio', 'seed'))
            for cell in cells]
    assert rows == [('grid', 0, 100.0, 1.0, 0), ('grid', 2, 100.0, 1.0, 0),
                    ('one', 3, 30.0, 1.0, 7), ('soft', 0, 100.0, 0.5, 0),
                    ('soft', 2, 100.0, 0.5, 0)]
    soft = cells[-1].job.setup()
    assert {surface.stiffness for surface in soft.plant.surfaces.values()} == {3000.0}
    assert {contact.stiffness for contact in soft.controller.contacts.values()} == {6000.0}


def test_adjustment_holds_where_its_condition_does(read):
    cells = run_cells(select(read(plants=['rigid', 'puma'], factors={}, seeds=1, adjustments=[
        {'where': {'plant.drives': 'rigid'}, 'values': {DAMPING: 30.0}}]), {}))
    assert [cell.job.setup().controller.force.damping_rate for cell in cells] == [30.0, 100.0]


def test_user_chooses_plants_seeds_and_values(read):
    study = read(factors={'level': {'a': {DELAY: 0}, 'b': {DELAY: 2}}})
    cells = run_cells(select(
        study, {'seed': (5,), **read_choices(['level=b', f'{DAMPING}=20, 60'])}, robot='panda'))
    assert [(cell.factors['level'], cell.factors[DAMPING]) for cell in cells] == [
        ('b', 20.0), ('b', 60.0)]
    assert {(cell.factors['plant'], cell.factors['seed']) for cell in cells} == {
        ('panda/rigid', 5)}
    with pytest.raises(ConfigError, match='^level: expected some of a, b, got'):
        select(study, {'level': ['c']})
    with pytest.raises(ConfigError, match='^part: expected some of'):
        select(study, {'part': ['c']})
    for text in ('level', '=3', 'level=', 'level=]'):
        with pytest.raises(ConfigError, match='^--set'):
            read_choices([text])


def test_studies_of_the_package_can_be_planned_and_quick_ones_are_shorter(preset):
    names = described('studies')
    assert {'compare', 'laws', 'map', 'robots', 'tune', 'faults', 'delay', 'stiffness'} <= {*names}
    for name in names:
        study = read_study(name)
        assert study.name == name and ': ' in study.description
    counts = [{cell.key for cell in preset(name, quick=True, plant=('rigid',)).cells()}
              for name in ('compare', 'laws', 'map', 'delay', 'faults')]
    assert [len(keys) for keys in counts] == [18, 45, 64, 14, 12]
    with pytest.raises(ConfigError, match=rf"^study: expected one of {', '.join(names)}"):
        read_study('stifness')


def test_comparison_has_every_estimator_and_numbers_that_follow_from_the_lead_filter(preset):
    cells = preset('compare', plant=('puma',), seed=(0,)).cells()
    setups = {(cell.factors['part'], cell.factors['estimator']): cell.job.setup()
              for cell in cells}
    labels = {label for part, label in setups if part == 'active state'}
    kinds = NoiseEstimatorConfig.model_fields['estimator'].annotation.__args__
    assert labels == {*kinds, 'window rescaled', 'innovation matched'}
    usual = setups['active state', 'lead_window']
    config = usual.noise_estimator
    f = lead_filter(config.zero_frequency, config.pole_frequency, config.rate)
    gain = f.gain ** 2 * (1.0 + (f.pole - f.zero) ** 2 / (1.0 - f.pole ** 2))  # of white noise
    rescaled, matched = (setups['active state', label]
                         for label in ('window rescaled', 'innovation matched'))
    assert rescaled.noise_estimator.variance_scale == pytest.approx(gain, rel=1e-12)
    assert matched.controller.force.process_noise == pytest.approx(
        usual.controller.force.process_noise / gain, rel=1e-12)


def test_every_law_has_ranges_whose_ends_are_acceptable():
    declared = read_yaml(config_dir() / 'tuning.yaml')
    assert set(declared) == set(LAWS)
    for law, ranges in declared.items():
        study = read_study('tune').model_copy(update={'law': law})
        whole = study_of(select(study, {}))
        ends = {name: [values[0], values[-1]] for name, values in ranges.items()}
        cells = run_cells(select(whole.config, ends))
        assert 2 <= len(cells) <= 2 ** len(ranges)
        assert {cell.factors['seed'] for cell in cells} == {0}
        assert cells[0].job.setup().controller.force.law == law
