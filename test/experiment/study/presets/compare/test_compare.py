"""`multicontact compare`: its matrix, its table and the sentences beside it."""

from multicontact_control.experiment.study.presets.compare.matrix import (
    AOB,
    CAUSE,
    comparison_matrix,
    ESTIMATORS,
    LABELS,
    MATCHED,
    PLAIN,
    RESCALED,
    rescaling,
)
from multicontact_control.experiment.study.presets.compare.results import (
    comparison_listing,
    findings,
)
import pytest


def test_matrix_covers_every_estimator_plant_observer_and_seed():
    entries = comparison_matrix()
    assert set(LABELS) == {*ESTIMATORS, RESCALED, MATCHED}
    found = {(entry.job.plant, entry.label, entry.kind, entry.job.seed) for entry in entries}
    assert found == {(plant, label, kind, seed) for plant in ('rigid', 'puma')
                     for label in LABELS for kind in (AOB, PLAIN) for seed in range(3)}
    assert len({entry.job.key() for entry in entries}) == len(entries)


def test_matrix_runs_each_cell_with_what_its_label_says():
    for entry in comparison_matrix(('puma',), ('fixed', RESCALED), 1):
        setup = entry.job.setup()
        assert setup.controller.force.active_state_order == (1 if entry.kind == AOB else 0)
        rescaled = entry.label == RESCALED
        assert setup.noise_estimator.estimator == ('window' if rescaled else 'fixed')
        assert setup.noise_estimator.variance_scale == pytest.approx(
            268.65 if rescaled else 1.0, abs=0.01)


def test_matched_and_rescaled_estimators_are_those_of_the_preset(tmp_path):
    path = tmp_path / 'mine.yaml'
    path.write_text(
        'controller_node:\n  ros__parameters: {force: {process_noise: 0.01}}\n'
        'noise_estimator_node:\n  ros__parameters: {zero_frequency: 6.0, variance_scale: 2.0}\n')
    lead, rescaled, matched = (entry.job.setup() for entry in comparison_matrix(
        ('puma',), ('lead_window', RESCALED, MATCHED), 1, plain=False, preset=str(path)))
    gain = rescaling(lead.noise_estimator)
    assert 60.0 < gain < 80.0  # it goes about with the inverse square of the zero
    assert rescaled.noise_estimator.variance_scale == pytest.approx(2.0 * gain)
    assert matched.controller.force.process_noise == pytest.approx(0.01 / gain)


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
