from multicontact_control.experiment.study.presets.compare.findings import findings
from multicontact_control.experiment.study.presets.compare.matrix import (
    AOB,
)


def row(label, stable, plant='puma', drives='flexible', kind=AOB):
    return {'label': label, 'kind': kind, 'plant': plant, 'stable': stable,
            'evidence': {'drives': drives}, 'unstable_after_motion_s': None if stable else 1.6,
            'oscillation_hz': None if stable else 42.0, 'rest_rms_n': 0.1, 'pushes': []}


CLEAN = 'fixed, no roughness, no sensor noise'


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
