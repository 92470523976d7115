"""The loop in one process is that of the graph: front end, source of the wrench, innovations."""

from multicontact_control.errors import RunError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.faults.in_process import run_fault
from multicontact_control.experiment.faults.vocabulary import faults_of, PROCESS
from multicontact_control.experiment.loop import run_in_process
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
