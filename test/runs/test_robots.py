"""Robots in the loop: other arms, other rates, encoders with steps, a sensor mounted wrong."""

import itertools

from canonical_runs import run_of, summary_of
from multicontact_control.config.supervision import WatchdogConfig
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
from multicontact_control.sensor.push_test import PHASE_TIME, PushTestConfig
import numpy as np
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


@pytest.mark.parametrize(
    ('plant', 'name'),
    [
        *(pytest.param('', *name.values, marks=name.marks) for name in OTHERS),
        ('flexible', 'panda'),
        pytest.param('flexible', 'iiwa', marks=nightly),
    ],
)
def test_robot_presses_on_two_surfaces_and_slides_along_them(name, plant):
    """Noisy sensor, rough surfaces with friction, rigid or flexible drives: 15 N on each."""
    data, contacts = run(robot=name, plant=plant)
    assert data.q.shape[1] == len(find_robot(name).arm.links)
    for contact in contacts:
        assert contact['rest']['true_error_rms_n'] < (0.15 if plant else 0.03)
        assert contact['moving']['true_error_rms_n'] < 1.2
        assert contact['moving']['contact_loss_fraction'] == 0.0
        assert plant or contact['step_rise_63_s'] < 0.06


@needs_mujoco
def test_engines_agree_in_the_loop_and_on_their_own_contacts():
    """The same surfaces give the same errors to some mN; the engine's own are smooth."""
    same = {'plant_overrides': {'engine': 'mujoco'}}
    native = {'plant_overrides': {'engine': 'mujoco', 'contact': 'native'}}
    (here, one), (there, other), (_, smooth) = (
        run(robot='panda', **options) for options in ({}, same, native)
    )
    np.testing.assert_allclose(here.q, there.q, atol=1e-3)
    for a, b, c in zip(one, other, smooth):
        for window in ('rest', 'moving'):
            assert a[window]['true_error_rms_n'] == pytest.approx(
                b[window]['true_error_rms_n'], abs=0.02
            )
            assert c[window]['true_error_rms_n'] < 0.3


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
    loop.advance()
    loop.control.set_forces({'table': 10.0, 'board': 10.0})
    for _ in range(round(3.0 * rate)):
        loop.advance()
        forces.append(loop.sample.contact_force)
    np.testing.assert_allclose(
        np.mean(forces[-round(0.2 * rate) :], axis=0), 10.0, atol=0.5
    )
    loop.advance(
        lambda inputs: inputs._replace(wrench=inputs.wrench._replace(wrench=free))
    )
    for _ in range(round(0.5 * rate)):
        loop.advance()
    loop.close()
    assert set(loop.control.events.reaction_counts) == {'none'}
    assert loop.control.events.rejected_counts == {'wrench_outlier': 1}
    assert not [event for _, event in loop.control.events.events if 'lost' in event]


def test_encoder_with_steps_is_not_taken_for_a_frozen_one():
    """A joint that moves by less than a step in a period repeats itself."""
    step = 2.0 * np.pi / 2**16
    loop = ClosedLoop(
        resolve(
            'quick',
            plant='rigid',
            controller={
                'watchdog': {'frozen_joint_ticks': WatchdogConfig().frozen_joint_ticks}
            },
        )
    )
    for _ in range(700):
        loop.advance(
            lambda inputs: inputs._replace(
                joints=inputs.joints._replace(
                    q=step * np.round(inputs.joints.q / step),
                    qd=1e-3 * np.round(1e3 * inputs.joints.qd),
                )
            )
        )
    loop.close()
    assert set(loop.control.events.reaction_counts) == {'none'}


CONFIG = PushTestConfig()
LENGTH, GAP = 2.0 * PHASE_TIME + 0.2, 0.8  # s, of a push and between two


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
    pushes = dict(
        zip(
            (500 + round(500 * i * (LENGTH + GAP)) for i in itertools.count()),
            CONFIG.force * CONFIG.directions_world,
        )
    )
    loop = ClosedLoop(
        resolve(
            'quick',
            plant=plant,
            plant_overrides={
                'sensor': {
                    'mounting': np.ravel(mounting).tolist(),
                    'bias': [3.0, -2.0, 4.0, 0, 0.1, 0],
                }
            },
            controller={'sensor': {'require_push_test': True}},
        )
    )
    control, gate = loop.control, loop.control.push_gate
    for _ in range(150):
        loop.advance()
    tool = control.config.tool.model_copy(
        update={'bias_sensor': tuple(control.tare().tolist())}
    )
    control.reconfigure(control.config.model_copy(update={'tool': tool}))
    control.push_test(CONFIG)
    for tick in itertools.count(150):
        if gate.result is not None:
            break
        if tick in pushes:
            loop.plant.push(pushes[tick], LENGTH, tool=True)
        loop.advance()
    loop.close()
    assert verdict in gate.result.message
    assert gate.result.passed is (verdict == 'passed')
