from multicontact_control.experiment.study.presets.compare.listing import comparison_listing
import pytest


def row(label, kind='AOB', *, seed=0, stable=True, push=0.25):
    return {'label': label, 'kind': kind, 'plant': 'puma', 'seed': seed, 'key': f'{label}{seed}',
            'stable': stable, 'unstable_after_motion_s': None if stable else 1.5 + seed,
            'rest_rms_n': 0.1 * (1 + seed), 'moving_rms_n': 2.0, 'moving_lost': 0.5,
            'rest_variance_n2': None, 'moving_variance_n2': 50.0, 'torque_max_fraction': 0.2,
            'pushes': [{'moving': False, 'duration_s': 0.1, 'recovery_s': push},
                       {'moving': True, 'duration_s': 0.1, 'recovery_s': 9.0}]}


def test_line_is_the_median_over_the_seeds_of_one_plant():
    rows = [row('fixed', seed=seed, stable=not seed, push=push)
            for seed, push in enumerate((0.25, None, None))]
    listing = comparison_listing([*rows, row('lead'), {**row('lead'), 'plant': 'rigid'}], 'puma')
    assert [(line.cells[0], line.cells[1], line.good) for line in listing.lines] == [
        ('fixed', '1/3', False), ('lead', '1/1', True)]
    assert listing.lines[0].cells[2:] == [
        '2.5-3.5', '0.200', '2.00', '50.00', '-', '50.0', 'never', '-', '20']
    assert len(listing.lines[0].cells) == len(listing.columns)
    assert 'data-keys="fixed0 fixed1 fixed2"' in listing.lines[0].html_attributes


@pytest.mark.parametrize('kinds', [('cause', 'AOB'), ('AOB', 'cause')])
def test_lines_of_a_kind_stand_together_in_the_order_of_kinds(kinds):
    listing = comparison_listing([row('fixed', kind) for kind in kinds], 'puma')
    assert [line.group for line in listing.lines] == ['AOB', 'cause']
