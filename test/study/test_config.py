"""A study's file: what it may say, what a user chooses of it, and the runs it makes."""

from multicontact_control.errors import ConfigError
from multicontact_control.study.cells import plan_runs
from multicontact_control.study.config import (
    apply_choices,
    read_choices,
    read_study,
)
import pytest
import yaml

STIFFNESS, DELAY = 'plant.surfaces.*.stiffness', 'plant.actuator_delay_ticks'
ESTIMATOR, DAMPING = 'noise_estimator.estimator', 'controller.force.damping_rate'
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


def test_ranges_are_even_and_levels_keep_their_labels(read):
    factors = (
        read(
            factors={
                'a': {'start': 0.1, 'stop': 0.5, 'count': 5},
                'e': [True, 'x'],
                'c': {'start': 1.0, 'stop': 1000.0, 'count': 4, 'spacing': 'log'},
                'ratio': {
                    'start': 1,
                    'stop': 2,
                    'count': 2,
                    'sets': 'p',
                    'multiples_of': 'q',
                },
                'level': {'plain': {}, 'soft': {'a.b': 1}},
            }
        )
        .parts['']
        .factors
    )
    assert [[value for value, _ in factors[name].settings(name)] for name in 'ace'] == [
        [0.1, 0.2, 0.3, 0.4, 0.5],
        [1.0, 10.0, 100.0, 1000.0],
        [True, 'x'],
    ]
    assert factors['ratio'].settings('ratio') == [(1.0, {'p': 1.0}), (2.0, {'p': 2.0})]
    assert factors['level'].settings('level') == [('plain', {}), ('soft', {'a.b': 1})]


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
        ({'columns': [{'aggregate': 'mean', 'name': 'x'}]}, 'columns.0.aggregate'),
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
        plan_runs(apply_choices(read(**changes), {}))
    assert '\n' not in str(caught.value)


def test_cells_are_every_combination_with_every_seed_on_every_plant(read):
    cells = plan_runs(apply_choices(read(plants=['rigid', 'puma']), {}))
    assert [
        tuple(cell.factors[name] for name in ('plant', DELAY, ESTIMATOR, 'seed'))
        for cell in cells
    ] == [
        (plant, ticks, estimator, seed)
        for plant in ('rigid', 'puma')
        for ticks in (0, 2)
        for estimator in ('fixed', 'lead_window')
        for seed in (0, 1)
    ]
    assert len({cell.key for cell in cells}) == 16
    assert all(cell.key == cell.job.key() for cell in cells)
    setup = cells[5].job.setup()
    assert (
        setup.plant.actuator_delay_ticks,
        setup.noise_estimator.estimator,
        setup.seed,
    ) == (2, 'fixed', 1)


def test_parts_have_what_the_study_has_and_the_values_of_the_files_for_the_rest(read):
    study = read(
        parts={
            'grid': {},
            'one': {'factors': {DAMPING: [30.0], DELAY: [3]}, 'seeds': [7]},
            'never': {'where': {'plant.drives': 'flexible'}},
            'soft': {
                'factors': {
                    'ratio': {
                        'values': [0.5],
                        'sets': STIFFNESS,
                        'multiples_of': 'controller.contacts.*.stiffness',
                    }
                }
            },
        }
    )
    cells = plan_runs(
        apply_choices(study, {'seed': (0,), **read_choices([f'{ESTIMATOR}=fixed'])})
    )
    rows = [
        tuple(cell.factors[name] for name in ('part', DELAY, DAMPING, 'ratio', 'seed'))
        for cell in cells
    ]
    assert rows == [
        ('grid', 0, 100.0, 1.0, 0),
        ('grid', 2, 100.0, 1.0, 0),
        ('one', 3, 30.0, 1.0, 7),
        ('soft', 0, 100.0, 0.5, 0),
        ('soft', 2, 100.0, 0.5, 0),
    ]
    soft = cells[-1].job.setup()
    assert {surface.stiffness for surface in soft.plant.surfaces.values()} == {3000.0}
    assert {contact.stiffness for contact in soft.controller.contacts.values()} == {
        6000.0
    }


def test_adjustment_holds_where_its_condition_does(read):
    cells = plan_runs(
        apply_choices(
            read(
                plants=['rigid', 'puma'],
                factors={},
                seeds=1,
                adjustments=[
                    {'where': {'plant.drives': 'rigid'}, 'values': {DAMPING: 30.0}}
                ],
            ),
            {},
        )
    )
    assert [cell.job.setup().controller.force.damping_rate for cell in cells] == [
        30.0,
        100.0,
    ]


def test_user_chooses_plants_seeds_and_values(read):
    study = read(factors={'level': {'a': {DELAY: 0}, 'b': {DELAY: 2}}})
    cells = plan_runs(
        apply_choices(
            study,
            {'seed': (5,), **read_choices(['level=b', f'{DAMPING}=20, 60'])},
            robot='panda',
        )
    )
    assert [(cell.factors['level'], cell.factors[DAMPING]) for cell in cells] == [
        ('b', 20.0),
        ('b', 60.0),
    ]
    assert {(cell.factors['plant'], cell.factors['seed']) for cell in cells} == {
        ('panda/rigid', 5)
    }
    with pytest.raises(ConfigError, match='^level: expected some of a, b, got'):
        apply_choices(study, {'level': ['c']})
    with pytest.raises(ConfigError, match='^part: expected some of'):
        apply_choices(study, {'part': ['c']})
    for text in ('level', '=3', 'level=', 'level=]'):
        with pytest.raises(ConfigError, match='^--set'):
            read_choices([text])
