from multicontact_control.experiment.study.presets.compare.matrix import AOB
from multicontact_control.experiment.study.presets.compare.results import (
    CLEAN,
    comparison_listing,
    findings,
)
import pytest


def row(label, stable, plant='puma', drives='flexible', kind=AOB):
    return {'label': label, 'kind': kind, 'plant': plant, 'damping_rate': 20.0, 'stable': stable,
            'evidence': {'drives': drives, 'plant': plant, 'damping_rate': 20.0},
            'unstable_after_motion_s': None if stable else 1.6,
            'oscillation_hz': None if stable else 42.0, 'rest_rms_n': 0.1, 'pushes': []}


def test_findings_say_which_plant_breaks_the_claim_and_that_noise_is_not_the_cause():
    said = ' '.join(findings([
        row('fixed', True, 'rigid', 'rigid'), row('fixed', False), row('lead_window', True),
        row(CLEAN, False, kind='cause'), row('fixed at 2 N²', True, kind='cause')]))
    assert 'rigid drives (plant rigid) R fixed at 0.6 N² is NOT unstable' in said
    assert 'unstable in 1 of 1 runs, 1.60 s' in said and '42 Hz' in said
    assert 'The noise is not the cause' in said
    assert 'fixed at 2 N²: 1 of 1 stable' in said


def test_findings_turn_round_with_the_data():
    said = ' '.join(findings([
        row('fixed', False, 'rigid', 'rigid'), row(CLEAN, True, kind='cause'),
        row('fixed', False)]))
    assert 'NOT unstable' not in said
    assert 'here the noise is the cause' in said


def test_where_a_fixed_variance_is_stable_nothing_is_a_cause():
    said = ' '.join(findings([row('fixed', True), row(CLEAN, True, kind='cause')]))
    assert 'NOT unstable' in said and 'cause' not in said


def line_of(label, kind='AOB', *, seed=0, stable=True, push=0.25):
    return {'label': label, 'kind': kind, 'plant': 'puma', 'damping_rate': 20.0, 'seed': seed,
            'key': f'{label}{seed}',
            'stable': stable, 'unstable_after_motion_s': None if stable else 1.5 + seed,
            'rest_rms_n': 0.1 * (1 + seed), 'moving_rms_n': 2.0, 'moving_lost': 0.5,
            'rest_variance_n2': None, 'moving_variance_n2': 50.0, 'torque_max_fraction': 0.2,
            'pushes': [{'moving': False, 'duration_s': 0.1, 'recovery_s': push},
                       {'moving': True, 'duration_s': 0.1, 'recovery_s': 9.0}]}


def test_line_is_the_median_over_the_seeds_of_one_plant():
    rows = [line_of('fixed', seed=seed, stable=not seed, push=push)
            for seed, push in enumerate((0.25, None, None))]
    others = [line_of('lead'), {**line_of('lead'), 'plant': 'rigid'}]
    listing = comparison_listing([*rows, *others], 'puma')
    assert [(line.cells[0], line.cells[1], line.good) for line in listing.lines] == [
        ('fixed', '1/3', False), ('lead', '1/1', True)]
    assert listing.lines[0].cells[2:] == [
        '2.5-3.5', '0.200', '2.00', '50.00', '-', '50.0', 'never', '-', '20']
    assert len(listing.lines[0].cells) == len(listing.columns)
    assert 'data-keys="fixed0 fixed1 fixed2"' in listing.lines[0].html_attributes


@pytest.mark.parametrize('kinds', [('cause', 'AOB'), ('AOB', 'cause')])
def test_lines_of_a_kind_stand_together_in_the_order_of_kinds(kinds):
    listing = comparison_listing([line_of('fixed', kind) for kind in kinds], 'puma')
    assert [line.group for line in listing.lines] == ['AOB', 'cause']
