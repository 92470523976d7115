"""A study's file: what it may say, what a user chooses of it, and the runs it makes."""

from itertools import product
from operator import itemgetter

from multicontact_control.errors import ConfigError
from multicontact_control.study.cells import plan_runs
from multicontact_control.study.config import (
    apply_choices,
    read_choices,
    read_study,
)
import pytest
import yaml

STIFFNESS = 'plant.surfaces.*.stiffness'
DELAY = 'plant.actuator_delay_ticks'
ESTIMATOR = 'noise_estimator.estimator'
DAMPING = 'controller.force.damping_rate'
STUDY = {
    'name': 'one',
    'scenario': 'step',
    'plants': ['rigid'],
    'seeds': 2,
    'factors': {DELAY: [0, 2], ESTIMATOR: ['fixed', 'lead_window']},
}


@pytest.fixture(name='read')
def fixture_read(tmp_path):
    """Return what reads a study with some changes from its file."""

    def read(**changes):
        path = tmp_path / 'study.yaml'
        path.write_text(yaml.safe_dump({**STUDY, **changes}, sort_keys=False))
        return read_study(str(path))

    return read


def plan_cells(study, **choices):
    """Return the runs of a study with what a user chooses of it."""
    return plan_runs(apply_choices(study, choices))


def set_each(*values):
    """Return the settings of a factor that sets the parameter a.b."""
    return [(value, {'a.b': value}) for value in values]


@pytest.mark.parametrize(
    ('factor', 'settings'),
    [
        (
            {'start': 0.1, 'stop': 0.5, 'count': 5},
            set_each(0.1, 0.2, 0.3, 0.4, 0.5),
        ),
        (
            {'start': 1.0, 'stop': 1000.0, 'count': 4, 'spacing': 'log'},
            set_each(1.0, 10.0, 100.0, 1000.0),
        ),
        ([True, 'x'], set_each(True, 'x')),
        (
            {'start': 1, 'stop': 2, 'count': 2, 'sets': 'p', 'multiples_of': 'q'},
            [(1.0, {'p': 1.0}), (2.0, {'p': 2.0})],
        ),
        (
            {'plain': {}, 'soft': {'a.b': 1}},
            [('plain', {}), ('soft', {'a.b': 1})],
        ),
    ],
)
def test_ranges_are_even_and_levels_keep_their_labels(read, factor, settings):
    study = read(factors={'a.b': factor})
    assert study.parts[''].factors['a.b'].settings('a.b') == settings


@pytest.mark.parametrize(
    ('changes', 'field'),
    [
        ({'name': 'a/b'}, 'study.yaml: name'),
        ({'plants': []}, 'plants'),
        ({'seeds': 0}, 'seeds'),
        ({'repeats': 3}, 'repeats'),
        ({'factors': {'a.b': 3}}, 'factors.a.b'),
        (
            {'factors': {'a.b': {'start': 0, 'stop': 2, 'count': 3, 'spacing': 'log'}}},
            'factors.a.b',
        ),
        ({'columns': [{'aggregate': 'mode', 'name': 'x'}]}, 'columns.0.aggregate'),
        ({'scenario': 'papper'}, 'scenario'),
        ({'plants': ['x']}, 'plant'),
        ({'factors': {'controller.farce.x': [1]}}, 'factors.controller.farce.x'),
        ({'fixed': {'plant.x': 1}}, 'factors.plant.x'),
        (
            {'factors': {DAMPING: [20.0, -1.0]}},
            rf'\({DAMPING} = -1.0\): force.damping_rate',
        ),
        (
            {'factors': {'noise_estimator.rate': [250.0]}},
            r'\(.*\): noise_estimator.rate',
        ),
    ],
)
def test_bad_file_parameter_or_value_is_refused_before_anything_runs(
    read, changes, field
):
    with pytest.raises(ConfigError, match=f'{field}: expected ') as caught:
        plan_cells(read(**changes))
    assert '\n' not in str(caught.value)


def list_factors(cells, *names):
    """Return the values of some factors of each run."""
    pick = itemgetter(*names)
    return [pick(cell.factors) for cell in cells]


def test_cells_are_every_combination_with_every_seed_on_every_plant(read):
    cells = plan_cells(read(plants=['rigid', 'puma']))
    every = product(('rigid', 'puma'), (0, 2), ('fixed', 'lead_window'), (0, 1))
    assert list_factors(cells, 'plant', DELAY, ESTIMATOR, 'seed') == [*every]
    assert len({cell.key for cell in cells}) == 16
    for cell in cells:
        assert cell.key == cell.job.key()


def test_job_of_a_cell_has_its_factors_and_its_seed(read):
    setup = plan_cells(read())[5].job.setup()
    assert setup.plant.actuator_delay_ticks == 2
    assert setup.noise_estimator.estimator == 'fixed'
    assert setup.seed == 1


def test_parts_have_what_the_study_has_and_the_values_of_the_files_for_the_rest(read):
    ratio = {
        'values': [0.5],
        'sets': STIFFNESS,
        'multiples_of': 'controller.contacts.*.stiffness',
    }
    parts = {
        'grid': {},
        'one': {'factors': {DAMPING: [30.0], DELAY: [3]}, 'seeds': [7]},
        'never': {'where': {'plant.drives': 'flexible'}},
        'soft': {'factors': {'ratio': ratio}},
    }
    fixed = read_choices([f'{ESTIMATOR}=fixed'])
    cells = plan_cells(read(parts=parts), seed=(0,), **fixed)
    assert list_factors(cells, 'part', DELAY, DAMPING, 'ratio', 'seed') == [
        ('grid', 0, 100.0, 1.0, 0),
        ('grid', 2, 100.0, 1.0, 0),
        ('one', 3, 30.0, 1.0, 7),
        ('soft', 0, 100.0, 0.5, 0),
        ('soft', 2, 100.0, 0.5, 0),
    ]
    soft = cells[-1].job.setup()
    for name in ('table', 'board'):
        assert soft.plant.surfaces[name].stiffness == 3000.0
        assert soft.controller.contacts[name].stiffness == 6000.0


def test_adjustment_holds_where_its_condition_does(read):
    adjustment = {'where': {'plant.drives': 'rigid'}, 'values': {DAMPING: 30.0}}
    study = read(
        plants=['rigid', 'puma'], factors={}, seeds=1, adjustments=[adjustment]
    )
    setups = [cell.job.setup() for cell in plan_cells(study)]
    rates = [setup.controller.force.damping_rate for setup in setups]
    assert rates == [30.0, 100.0]


LEVELS = {'level': {'a': {DELAY: 0}, 'b': {DELAY: 2}}}


def test_user_chooses_plants_seeds_and_values(read):
    choices = read_choices(['level=b', f'{DAMPING}=20, 60'])
    choices['seed'] = (5,)
    study = read(factors=LEVELS)
    cells = plan_runs(apply_choices(study, choices, robot='panda'))
    assert list_factors(cells, 'level', DAMPING, 'plant', 'seed') == [
        ('b', 20.0, 'panda/rigid', 5),
        ('b', 60.0, 'panda/rigid', 5),
    ]


@pytest.mark.parametrize(('factor', 'known'), [('level', 'a, b'), ('part', '')])
def test_choice_that_the_study_does_not_have_is_refused(read, factor, known):
    study = read(factors=LEVELS)
    with pytest.raises(ConfigError, match=f'^{factor}: expected some of {known}'):
        apply_choices(study, {factor: ['c']})


@pytest.mark.parametrize('text', ['level', '=3', 'level=', 'level=]'])
def test_choice_that_is_no_factor_with_values_is_refused(text):
    with pytest.raises(ConfigError, match='^--set'):
        read_choices([text])
