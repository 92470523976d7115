"""Robots in the loop: other arms, other rates, encoders with steps, a sensor mounted wrong."""

from canonical_runs import run_of, summary_of
from multicontact_control.config.supervision import WatchdogConfig
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
from multicontact_control.sensor.push_test import PHASE_TIME, PushTestConfig
import numpy as np
from numpy.testing import assert_allclose
import pytest
from robots import needs_mujoco, OTHERS
from sim_bridge.robots import find_robot

DURATION = 9.5  # s, of `quick`, whose motion has been judged for 1 s then
nightly = pytest.mark.nightly


def run(**options):
    setup = resolve('quick', preset='best', duration=DURATION, **options)
    summary = summary_of(setup)
    assert summary['stable'], summary['instabilities']
    return run_of(setup).data, list(summary['contacts'].values())


def assert_pressed(contacts, rest_error):
    """Check the errors at rest and sliding [N], and that no contact was lost."""
    for contact in contacts:
        assert contact['rest']['true_error_rms_n'] < rest_error
        assert contact['moving']['true_error_rms_n'] < 1.2
        assert contact['moving']['contact_loss_fraction'] == 0.0


@pytest.mark.parametrize('name', OTHERS)
def test_robot_presses_on_two_surfaces_and_slides_along_them(name):
    """Noisy sensor, rough surfaces with friction: 15 N on each."""
    data, contacts = run(robot=name)
    assert data.q.shape[1] == len(find_robot(name).arm.links)
    assert_pressed(contacts, 0.03)
    assert max(contact['step_rise_63_s'] for contact in contacts) < 0.06


@pytest.mark.parametrize('name', ['panda', pytest.param('iiwa', marks=nightly)])
def test_robot_with_flexible_drives_presses_and_slides(name):
    _, contacts = run(robot=name, plant='flexible')
    assert_pressed(contacts, 0.15)


@needs_mujoco
def test_engines_agree_in_the_loop_and_on_their_own_contacts():
    """The same surfaces give the same errors to some mN; the engine's own are smooth."""
    same = {'engine': 'mujoco'}
    native = {'engine': 'mujoco', 'contact': 'native'}
    bullet_data, bullet = run(robot='panda')
    mujoco_data, mujoco = run(robot='panda', plant_overrides=same)
    _, smooth = run(robot='panda', plant_overrides=native)
    assert_allclose(bullet_data.q, mujoco_data.q, atol=1e-3)
    for contact in (0, 1):
        for window in ('rest', 'moving'):
            error = bullet[contact][window]['true_error_rms_n']
            other_error = mujoco[contact][window]['true_error_rms_n']
            assert error == pytest.approx(other_error, abs=0.02)
            assert smooth[contact][window]['true_error_rms_n'] < 0.3


@pytest.mark.parametrize(
    ('rate', 'force'),
    [
        (125.0, {'damping_rate': 40.0, 'input_delay': 0.012, 'time_constant': 0.05}),
        (1000.0, {}),
    ],
)
def test_a_robot_of_another_rate_presses_without_any_reaction(rate, force):
    """Ages, gaps and bounces are counted in periods: a single sample says nothing of a surface."""
    loop = ClosedLoop(
        resolve(
            'quick',
            plant='rigid',
            noise_estimator={'rate': rate},
            controller={
                'rate': rate,
                'force': force,
                'watchdog': {'frozen_joint_ticks': 0},
            },
        ),
        commanded=True,
    )
    forces = []
    free = loop.sample.wrench

    def outlier(inputs):
        return inputs._replace(wrench=inputs.wrench._replace(wrench=free))

    loop.advance()
    loop.control.set_forces({'table': 10.0, 'board': 10.0})
    for _ in range(round(3.0 * rate)):
        loop.advance()
        forces.append(loop.sample.contact_force)
    last = forces[-round(0.2 * rate) :]
    assert_allclose(np.mean(last, axis=0), 10.0, atol=0.5)
    loop.advance(outlier)
    for _ in range(round(0.5 * rate)):
        loop.advance()
    loop.close()
    events = loop.control.events
    assert set(events.reaction_counts) == {'none'}
    assert events.rejected_counts == {'wrench_outlier': 1}
    assert not any('lost' in event for _, event in events.events)


def test_encoder_with_steps_is_not_taken_for_a_frozen_one():
    """A joint that moves by less than a step in a period repeats itself."""
    step = 2.0 * np.pi / 2**16

    def encode(inputs):
        q = step * np.round(inputs.joints.q / step)
        qd = 1e-3 * np.round(1e3 * inputs.joints.qd)
        return inputs._replace(joints=inputs.joints._replace(q=q, qd=qd))

    watchdog = {'frozen_joint_ticks': WatchdogConfig().frozen_joint_ticks}
    setup = resolve('quick', plant='rigid', controller={'watchdog': watchdog})
    loop = ClosedLoop(setup)
    for _ in range(700):
        loop.advance(encode)
    loop.close()
    assert set(loop.control.events.reaction_counts) == {'none'}


CONFIG = PushTestConfig()
TARED = 150  # ticks, before the first push
LENGTH = 2.0 * PHASE_TIME + 0.2  # s, of a push
GAP = 0.8  # s, between two


@pytest.mark.parametrize(
    ('plant', 'mounting', 'verdict'),
    [
        ('puma', np.eye(3), 'passed'),
        (
            'rigid',
            [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
            'rotated by 90 deg about the axis (0, 1, 0)',
        ),
    ],
)
def test_push_test_names_the_fault_of_the_mounting(plant, mounting, verdict):
    """Tared first, so that nothing is wrong at rest."""
    pushes = {}
    for number, direction in enumerate(CONFIG.directions_world):
        tick = 500 + round(500 * number * (LENGTH + GAP))
        pushes[tick] = CONFIG.force * direction
    sensor = {
        'mounting': np.ravel(mounting).tolist(),
        'bias': [3.0, -2.0, 4.0, 0, 0.1, 0],
    }
    setup = resolve(
        'quick',
        plant=plant,
        plant_overrides={'sensor': sensor},
        controller={'sensor': {'require_push_test': True}},
    )
    loop = ClosedLoop(setup)
    control = loop.control
    gate = control.push_gate
    for _ in range(TARED):
        loop.advance()
    bias = tuple(control.tare().tolist())
    tool = control.config.tool.model_copy(update={'bias_sensor': bias})
    control.reconfigure(control.config.model_copy(update={'tool': tool}))
    control.push_test(CONFIG)
    tick = TARED
    while gate.result is None:
        if tick in pushes:
            loop.plant.push(pushes[tick], LENGTH, tool=True)
        loop.advance()
        tick += 1
    loop.close()
    assert verdict in gate.result.message
    assert gate.result.passed is (verdict == 'passed')
