"""The loop in one process is that of the graph: front end, source of the wrench, innovations."""

from multicontact_control.errors import RunError
from multicontact_control.experiment.closed_loop import ClosedLoop, run_in_process
from multicontact_control.experiment.faults.fault import PROCESS
from multicontact_control.experiment.faults.in_process import run_fault
from multicontact_control.experiment.faults.vocabulary import faults_of
from multicontact_control.experiment.figures import draw_figures, run_figures
from multicontact_control.experiment.judge import judge, NOT_STABLE
from multicontact_control.experiment.metrics import contact_summary
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.scenario import resolve
import numpy as np
import pytest

KINDS = faults_of(PROCESS)
LOW_PASS = {'sensor': {'filter_order': 2, 'filter_cutoff': 60.0}}
BLIND = {'frozen_samples': 0, 'wrench_full_scale': []}  # a watchdog that leaves it to the sensor's


def closed_loop(*, ticks=0, **changes):
    loop = ClosedLoop(resolve('quick', plant='rigid', **changes))
    for _ in range(ticks):
        loop.advance()
    return loop


@pytest.mark.parametrize('changes', [
    {'controller': LOW_PASS}, {'controller': {'wrench_input': 'filtered'}},
    {'noise_estimator': {'estimator': 'sage_husa'}}])
def test_faults_happen_in_the_loop_that_simulate_runs(changes):
    """Bit for bit, where it was another one: low-pass, filtered wrench, innovations."""
    setup = resolve('quick', plant='rigid', duration=1.5, **changes)
    data = run_in_process(setup, supervised=True).data
    assert data.alpha_true[-1].all()  # in contact, where all of that decides
    loop = ClosedLoop(setup)
    torques = [loop.advance().torque for _ in range(data.ticks)]
    np.testing.assert_array_equal(torques, data.torque)


@pytest.mark.parametrize(('kind', 'cause'), [
    ('frozen', 'wrench_frozen'), ('saturated', 'wrench_saturated')])
def test_fault_of_the_sensor_meets_the_monitor_of_the_front_end(kind, cause):
    """The watchdog looks for neither."""
    loop = closed_loop(ticks=330, controller={'watchdog': BLIND})
    row = run_fault(loop, KINDS[kind, 'wrench'], 1, 'approach')
    assert row.reaction == 'hold'
    assert any(cause in what for _, what in loop.control.events.events)


def test_command_acts_after_the_delay_of_the_actuators():
    torques = []
    for delay in (1, 3):
        loop = closed_loop(plant_overrides={'actuator_delay_ticks': delay})
        efforts = [loop.sample.effort]
        for _ in range(6):
            loop.advance()
            efforts.append(loop.sample.effort)
        torques.append(efforts)
        for k in range(1, delay + 1):
            np.testing.assert_array_equal(efforts[k], loop.plant.initial_torque)
    assert (torques[0][4] != torques[1][4]).any()


def test_what_happens_on_the_way_from_the_sensors_stays_out_of_the_history():
    loop = closed_loop(ticks=5)
    loop.advance(lambda inputs: inputs._replace(wrench=None))
    assert loop.history[-1].wrench is not None
    assert [inputs.time for inputs in loop.history] == pytest.approx(
        [0.002 * k for k in range(6)])
    assert loop.control.reactions == {'none': 6}  # one that is missing is bridged


def test_closed_loop_without_supervisor_has_nothing_to_say_of_one():
    loop = ClosedLoop(resolve('quick', plant='rigid'), supervised=False)
    loop.advance()
    with pytest.raises(RunError, match='expected a supervisor'):
        loop.status  # noqa: B018
    loop.control.safe = True
    with pytest.raises(RunError, match='found its safe behaviour'):
        loop.advance()


@pytest.fixture(scope='module')
def runs():
    """Run the scenario `quick` up to a second of motion, on both plants."""
    return {plant: (setup := resolve('quick', plant=plant, duration=9.5), run_in_process(setup))
            for plant in ('rigid', 'puma')}


@pytest.mark.parametrize('plant', ['rigid', 'puma'])
def test_quick_is_stable_and_holds_its_forces(runs, plant):
    """The paper's experiment in short."""
    setup, result = runs[plant]
    assert judge(result.data, setup, ended_early=result.ended_early).reasons == ()
    for i in range(2):
        summary = contact_summary(result.data, setup, i)
        assert summary['rest']['true_error_rms_n'] < 1.0
        assert summary['moving']['true_error_rms_n'] < 3.0
        assert summary['moving']['contact_loss_fraction'] == 0.0
        assert 0.3 < summary['rest']['noise_variance_median_n2'] < 1.2
        assert 0.02 <= summary['step_rise_63_s'] <= 0.06


def test_same_seed_same_run_other_seed_other_run():
    """Bit for bit (the torques' hash)."""
    hashes = [run_in_process(resolve('quick', duration=1.5, seed=seed)).data.trajectory_sha256()
              for seed in (3, 3, 4)]
    assert hashes[0] == hashes[1]
    assert hashes[0] != hashes[2]


def test_observer_sees_the_variance_of_the_tick_before():
    """R_k is estimated from samples up to k - 1 (paper notes 14): the first is the initial."""
    setup = resolve('quick', plant='rigid', duration=0.01,
                    noise_estimator={'estimator': 'fixed', 'fixed_variance': 7.0})
    result = run_in_process(setup)
    np.testing.assert_array_equal(result.data.noise_variance, 7.0)


@pytest.mark.parametrize('name', ['innovation', 'sage_husa', 'variational_bayes'])
def test_estimators_get_the_innovations_of_the_loop(name):
    """R moves away from its start once there is contact, not before, and stays in its limits."""
    setup = resolve('quick', plant='rigid', duration=2.5, noise_estimator={'estimator': name})
    data = run_in_process(setup).data
    for i in range(2):
        start = np.flatnonzero(data.innovation[:, i])[0]
        assert start > 100
        np.testing.assert_array_equal(data.noise_variance[:start, i], 0.6)
        assert len(np.unique(data.noise_variance[start + 50:, i])) > 20
    assert (data.noise_variance >= setup.noise_estimator.variance_floor).all()
    assert (data.noise_variance <= setup.noise_estimator.variance_ceiling).all()


def test_recording_without_innovations_is_read(runs, tmp_path):
    """One from before they were kept: the series is there, and empty."""
    runs['rigid'][1].data.save(tmp_path)
    file = tmp_path / 'samples.npz'
    with np.load(file) as data:
        values = {key: data[key] for key in data.files if key != 'innovation'}
    np.savez(file, **values)
    assert np.isnan(RunData.load(tmp_path).innovation).all()


def test_run_that_gets_out_of_hand_ends_with_a_reason():
    """A run that cannot go on ends early instead of raising."""
    setup = resolve('quick', plant='rigid', duration=4.0, controller={
        'contacts': {name: {'stiffness': 50.0} for name in ('table', 'board')}})
    result = run_in_process(setup)
    assert judge(result.data, setup, ended_early=result.ended_early).name == NOT_STABLE


def test_series_survive_saving_and_loading(runs, tmp_path):
    """What is drawn is what was recorded."""
    data = runs['rigid'][1].data
    data.save(tmp_path)
    again = RunData.load(tmp_path)
    assert again.trajectory_sha256() == data.trajectory_sha256()
    assert again.contact_names == data.contact_names
    np.testing.assert_array_equal(again.noise_variance, data.noise_variance)


def test_figures_are_drawn_for_every_contact(runs, tmp_path):
    """Figures 3-6, as PNG files."""
    setup, result = runs['puma']
    paths = draw_figures(result.data, setup, tmp_path)
    assert [path.stem for path in paths] == [
        'fig3_force_table', 'fig4_force_board', 'fig5_motion', 'fig6_noise_variance']
    assert [figure.file for figure in run_figures(result.data, setup)] == [
        path.stem for path in paths]
    for path in paths:
        assert path.read_bytes().startswith(b'\x89PNG')
        assert path.stat().st_size > 20000


@pytest.mark.parametrize('seed', [0, 1])
def test_limited_slew_of_the_variance_leaves_a_force_step_its_speed(seed):
    """A step lifts R, which slowed the board's steps to 88 to 148 ms on flexible drives."""
    rises = []
    for slew_time in (0.0, 0.03):
        setup = resolve('quick', plant='puma', seed=seed, duration=6.5, preset='paper',
                        noise_estimator={'slew_time': slew_time})
        data = run_in_process(setup, supervised=True).data
        rises.append([step['rise_63_s'] for step in contact_summary(data, setup, 1)['steps']])
    assert min(rises[0]) > 0.08
    assert max(rises[1]) < 0.08
