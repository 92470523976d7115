"""The table of a comparison and the sentences beside it."""

from multicontact_control.experiment.study.presets.compare.matrix import AOB, CAUSE
from multicontact_control.experiment.study.presets.compare.results import (
    comparison_listing,
    findings,
)
import pytest


def row(label, kind=AOB, *, seed=0, stable=True, push=0.25, plant='puma'):
    return {'label': label, 'kind': kind, 'plant': plant, 'damping_rate': 20.0, 'seed': seed,
            'evidence': {'drives': 'flexible', 'plant': plant, 'damping_rate': 20.0},
            'contacts': {}, 'key': f'{label}{seed}', 'stable': stable,
            'unstable_after_motion_s': None if stable else 1.5 + seed,
            'oscillation_hz': None if stable else 31.0,
            'rest_rms_n': 0.1 * (1 + seed), 'moving_rms_n': 2.0, 'moving_lost': 0.5,
            'rest_variance_n2': None, 'moving_variance_n2': 50.0, 'torque_max_fraction': 0.2,
            'pushes': [{'moving': False, 'duration_s': 0.1, 'recovery_s': push},
                       {'moving': True, 'duration_s': 0.1, 'recovery_s': 9.0}]}


def test_findings_are_counts_and_figures_of_the_rows():
    text = ' '.join(findings([
        row('fixed', stable=False), row('fixed', seed=1, stable=False), row('fixed', seed=2),
        row('fixed at 2 N²', CAUSE), row('fixed', plant='rigid')]))
    assert 'Plant puma, flexible drives: fixed: unstable in 2 of 3 runs, 1.5-2.5 s' in text
    assert '31 Hz' in text
    assert 'fixed at 2 N²: unstable in 0 of 1 runs' in text
    assert 'Plant rigid, flexible drives: fixed: unstable in 0 of 1 runs.' in text


def test_line_is_the_median_over_the_seeds_of_one_plant():
    rows = [row('fixed', seed=seed, stable=not seed, push=push)
            for seed, push in enumerate((0.25, None, None))]
    listing = comparison_listing([*rows, row('lead'), row('lead', plant='rigid')], 'puma')
    assert [(line.cells[0], line.cells[1], line.good) for line in listing.lines] == [
        ('fixed', '1/3', False), ('lead', '1/1', True)]
    assert listing.lines[0].cells[2:] == [
        '2.5-3.5', '0.200', '2.00', '50.00', '-', '50.0', 'never', '-', '20']
    assert len(listing.lines[0].cells) == len(listing.columns)
    assert 'data-keys="fixed0 fixed1 fixed2"' in listing.lines[0].html_attributes


@pytest.mark.parametrize('kinds', [(CAUSE, AOB), (AOB, CAUSE)])
def test_lines_of_a_kind_stand_together_in_the_order_of_kinds(kinds):
    listing = comparison_listing([row('fixed', kind) for kind in kinds], 'puma')
    assert [line.group for line in listing.lines] == [AOB, CAUSE]
