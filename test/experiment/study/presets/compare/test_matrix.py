from typing import get_args

from multicontact_control.config import NoiseEstimatorConfig
from multicontact_control.experiment.study.presets.compare.matrix import (
    AOB,
    beside_the_matrix,
    comparison_matrix,
    LABELS,
    MATCHED,
    PLAIN,
    RESCALED,
    rescaling,
)
from multicontact_control.experiment.study.presets.compare.study import ComparisonStudy
import pytest


def test_matrix_covers_every_estimator_plant_observer_and_seed():
    entries = comparison_matrix()
    names = get_args(NoiseEstimatorConfig.model_fields['estimator'].annotation)
    assert set(LABELS) == {*names, RESCALED, MATCHED}
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


def test_matched_observer_has_the_gain_of_the_papers_at_rest():
    lead, matched = (comparison_matrix(('puma',), (label,), 1, plain=False)[0].job.setup()
                     for label in ('lead_window', MATCHED))
    assert matched.noise_estimator.estimator == 'innovation'
    assert lead.controller.force.process_noise / matched.controller.force.process_noise == (
        pytest.approx(268.65, abs=0.01))


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


def test_other_presets_are_not_varied_over_their_damping():
    study = ComparisonStudy(('rigid',), ('fixed',), 1, quick=True, preset='best')
    assert {entry.job.setup().controller.force.damping_rate for entry in study.entries()} == {
        100.0}


def test_matrix_compensates_no_friction_where_there_is_none():
    rigid, puma = (comparison_matrix((plant,), ('fixed',), 1)[0].job.setup()
                   for plant in ('rigid', 'puma'))
    assert rigid.controller.friction.coulomb == ()
    assert puma.controller.friction.coulomb != ()


def test_quick_matrix_covers_both_plants_and_the_estimators_that_decide():
    entries = ComparisonStudy(quick=True).entries()
    assert {(entry.job.plant, entry.label) for entry in entries if entry.kind == AOB} == {
        (plant, label) for plant in ('rigid', 'puma')
        for label in ('lead_window', 'fixed', RESCALED, MATCHED)}
    rates = {entry.job.setup().controller.force.damping_rate for entry in entries}
    assert rates >= {20.0, 60.0, 100.0}
    assert len(entries) < 48


def test_causes_are_looked_for_only_with_flexible_drives():
    assert not [entry for entry in beside_the_matrix(('rigid',), 1) if entry.kind == 'cause']
    smooth = next(entry for entry in beside_the_matrix(('puma',), 1) if 'noise' in entry.label)
    plant = smooth.job.setup().plant
    assert not plant.sensor.noise
    assert all(surface.roughness_std == 0.0 for surface in plant.surfaces.values())
