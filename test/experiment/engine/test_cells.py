import pickle

from multicontact_control.experiment.engine import cell_of, cells


def test_cell_key_does_not_depend_on_the_order_of_overrides():
    first = cell_of('quick', 'rigid', 0, controller={'force': {
        'damping_rate': 30.0, 'input_delay': 0.002}})
    second = cell_of('quick', 'rigid', 0, controller={'force': {
        'input_delay': 0.002, 'damping_rate': 30.0}})
    assert first == second and hash(first) == hash(second)
    assert first.key() == second.key() == pickle.loads(pickle.dumps(first)).key()


def test_cell_key_changes_with_all_that_changes_the_outcome():
    variants = [
        cell_of('quick', 'rigid', 0), cell_of('quick', 'rigid', 1), cell_of('quick', 'puma', 0),
        cell_of('disturbance', 'rigid', 0), cell_of('quick', 'rigid', 0, duration=5.0),
        cell_of('quick', 'rigid', 0, noise_estimator={'estimator': 'fixed'}),
        cell_of('quick', 'rigid', 0, controller={'force': {'damping_rate': 30.0}}),
        cell_of('quick', 'rigid', 0, plant_overrides={'actuator_delay_ticks': 2}),
        cell_of('quick', 'rigid', 0, scenario_overrides={'reference': {
            'approach': {'speed': 0.03}}}),
        cell_of('quick', 'rigid', 0, supervised=True)]
    assert len({cell.key() for cell in variants}) == len(variants)


def test_cell_key_is_that_of_the_values_not_of_how_they_were_given():
    given = cell_of('quick', 'rigid', 0, controller={'force': {'damping_rate': 20.0}})
    assert given.key() == cell_of('quick', 'rigid', 0).key()


def test_cell_key_changes_with_the_code(monkeypatch):
    """Nobody shall get yesterday's results from today's controller."""
    before = cell_of('quick', 'rigid', 0).key()
    monkeypatch.setattr(cells, 'code_stamp', lambda: 'other code')
    assert cell_of('quick', 'rigid', 0).key() != before
