"""The table of robots, engines and scenarios."""

from multicontact_control.experiment.study.presets.robots.study import figures_of, RobotStudy


def summary_of(lost, torque=0.5, path=1e-3):
    contacts = {name: {window: {'true_error_rms_n': 0.1, 'contact_loss_fraction': share}
                       for window in ('rest', 'moving')} for name, share in lost.items()}
    return {'error': None, 'summary': {
        'stable': True, 'instabilities': [], 'contacts': contacts,
        'torque': {'max_fraction_of_limit': torque}, 'motion': {'moving_position_rms_m': path}}}


def test_figures_are_those_of_the_worst_contact_and_unknown_ones_stay_open(tmp_path):
    row = figures_of(summary_of({'edge': 0.02, 'edge/along': None, 'board': 0.01}))
    assert (row['loss_percent'], row['torque_percent'], row['path_mm']) == (2.0, 50.0, 1.0)
    row = figures_of(summary_of({'edge': None}, torque=None, path=None))
    assert row['loss_percent'] is row['torque_percent'] is row['path_mm'] is None
    page = RobotStudy(('puma',), ('pybullet',), ('quick',)).page(
        [{'robot': 'puma', 'engine': 'pybullet', 'scenario': 'quick', 'seed': 0, **row}], tmp_path)
    assert page.sections[0].listing.lines[0].cells[6:] == ['-', '-', '-']
    failed = figures_of({'summary': None, 'error': 'tick 3: singular'})
    assert failed['stable'] is False and failed['why'] == 'tick 3: singular'
