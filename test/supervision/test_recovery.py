"""Gaps are bridged, reactions do not alternate, and contacts given up come back."""

from contextlib import closing

from multicontact_control.config import WatchdogConfig
from multicontact_control.control.tasks import MotionReading
from multicontact_control.errors import CommandError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
from multicontact_control.supervision.reactions import RECOVERING, Recovery
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

HOLDING = ('holding',) * 2
H = 0.002
SETTLED = {'rigid': 1.8, 'puma': 2.4}  # s, twice what it takes to be within 0.5 N of 15 N
on_both_plants = pytest.mark.parametrize('plant', list(SETTLED))


def pressing(plant, force=15.0, forces=None, **changes):
    """Return a commanded loop that presses on both surfaces, at rest, to be closed."""
    loop = ClosedLoop(resolve('quick', plant=plant, **changes), commanded=True)
    loop.advance()
    loop.control.set_forces(forces or {'table': force, 'board': force})
    advance(loop, SETTLED[plant])
    assert set(loop.status.contact_states) <= {'holding', 'free'}
    return closing(loop)


def advance(loop, seconds, corrupt=None, each=None):
    """Advance, and return the true forces, shape (ticks, contacts), and the statuses."""
    forces, statuses = [], []
    for k in range(round(seconds / H)):
        if each is not None:
            each((k + 1) * H)
        loop.advance(corrupt)
        forces.append(loop.true_forces.copy())
        statuses.append(loop.status)
    return np.array(forces), statuses


def move(loop, start, offset, velocity=(0.0, 0.0, 0.0)):
    """Command a place beside a pose, in its orientation."""
    loop.control.set_motion(MotionReading(
        start.position_world + offset, start.quaternion_xyzw, np.concatenate(
            [velocity, np.zeros(3)]), np.zeros(6)))


def no_wrench(inputs):
    return inputs._replace(wrench=None)


def reactions_change(statuses):
    return sum(a.reaction != b.reaction for a, b in zip(statuses, statuses[1:]))


@pytest.mark.parametrize(('cause', 'soon'), [
    ('wrench_stale', 1.0), ('joints_invalid', 1.0), ('clock_rate', 1.0), ('collision_joint2', 5.0),
    ('motion_joint_speed', 5.0), ('law_not_finite', 5.0), ('wrench_sideways', 5.0)])
def test_recovery_waits_longer_after_each_relapse_and_latches_physical_causes(
        cause, soon):
    """From 50 ms up to 2 s; a reaction is a relapse within `soon` after control has resumed."""
    recovery, tick = Recovery(WatchdogConfig().recovery_time, H), 0

    def stop(after):
        """Return the wait after some seconds of control [s]; None for ever."""
        nonlocal tick
        tick += round(after / H)
        recovery.stopped((cause,), tick)
        waits = [k * H for k in range(2000) if recovery.missing(k) == ()]
        recovery.resumed_at = tick
        return waits[0] if waits else None

    waits = [0.05, 0.15, 0.45, 1.35, 2.0, 2.0]
    if soon == 5.0:
        waits[3:] = [None] * 3
    assert [stop(0.5 * soon) for _ in waits] == pytest.approx(waits, abs=1.01 * H)
    recovery.allow()
    assert recovery.missing(2000) == ()
    assert stop(1.1 * soon) == pytest.approx(0.05)
    assert recovery.missing(0) == (RECOVERING,)


@on_both_plants
def test_gaps_of_the_wrench_are_bridged_and_long_ones_held_with_the_force(plant):
    with pressing(plant) as loop:
        for gap in (1, 2, 5, 10, 20, 50):
            before, _ = advance(loop, 0.2)
            during, statuses = advance(loop, gap * H, no_wrench)
            after, later = advance(loop, 0.5)
            error = np.abs(np.concatenate([during, after]) - before.mean(axis=0))
            bridged = gap <= 10
            assert ('hold' in {status.reaction for status in statuses + later}) != bridged
            assert {status.contact_states for status in statuses + later} == {HOLDING}
            assert error.max() < (0.5 if bridged else 4.0)
            assert error[-1].max() < 0.5


@on_both_plants
@pytest.mark.parametrize('silent', [True, False])
def test_emergency_stop_in_contact_is_recovered_from(plant, silent):
    """Brakes hold the arm for 2 s: nothing comes of it, or its torques have no effect."""
    def stopped(inputs):
        return inputs._replace(joints=None, wrench=None) if silent else inputs._replace(
            joints=inputs.joints._replace(qd=np.zeros(6)),
            wrench=inputs.wrench._replace(wrench=inputs.wrench.wrench + 1e-3 * np.sin(loop.tick)))

    with pressing(plant) as loop:
        before = loop.command
        for _ in range(1000):
            loop.answer(stopped)
            loop.tick += 1
            assert np.abs(loop.command - before).max() < 20.0
        speeds = []
        forces, statuses = advance(
            loop, 2.0, each=lambda time: speeds.append(np.abs(loop.sample.qd).max()))
    assert forces.max() < 20.0 and max(speeds) < 0.5
    assert np.abs(forces[-1] - 15.0).max() < 0.5 and statuses[-1].contact_states == HOLDING


@pytest.mark.parametrize(('plant', 'turn', 'least', 'most'), [
    ('puma', 0.9, 4.0, 16.0), ('rigid', 1.5, 1.0, 20.0)])
def test_turning_about_the_wrist_with_the_board_held_loses_nothing(plant, turn, least, most):
    """The speed of the tip counts, and not that of the wrist."""
    axis, w = np.array([0.0, 1.0, 0.0]), np.pi  # the normal: the tip stays on the board
    with pressing(plant, forces={'table': 0.0, 'board': 10.0}) as loop:
        start = loop.control.output.pose

        def rotate(time):
            rotation = Rotation.from_rotvec(turn / w * np.sin(w * time) * axis).as_matrix()
            loop.control.set_motion(MotionReading(
                start.position_world, Rotation.from_matrix(
                    rotation @ start.rotation_world).as_quat(),
                np.concatenate([np.zeros(3), turn * np.cos(w * time) * axis]), np.zeros(6)))
        forces, statuses = advance(loop, 2.0, each=rotate)  # a whole turn, to either side
    assert {status.contact_states[1] for status in statuses} == {'holding'}
    assert least < forces[:, 1].min() and forces[:, 1].max() < most


WALL = {'obstacle_names': ['wall'], 'surfaces': {'wall': {
    'tip_link': 'tip_table', 'point_world': [0.03, 0.55, 0.42], 'normal_world': [1.0, 0.0, 0.0],
    'stiffness': 3000.0, 'roughness_std': 0.0}}}


@on_both_plants
def test_side_wall_latches_after_a_few_relapses_and_the_operator_can_retreat(plant):
    with pressing(plant, plant_overrides=WALL) as loop:
        start = loop.control.output.pose
        forces, statuses = advance(
            loop, 3.5, each=lambda time: move(loop, start, [min(0.1 * time, 0.08), 0.0, 0.0]))
        assert reactions_change(statuses) <= 7
        assert statuses[-1].causes == ('latched',)
        assert forces.max() < 40.0
        move(loop, start, [-0.03, 0.0, 0.0])
        assert loop.control.retry() == 'trying again'
        _, statuses = advance(loop, 2.0)
        assert (statuses[-1].reaction, statuses[-1].contact_states) == ('none', HOLDING)
        assert loop.control.output.pose.position_world[0] < start.position_world[0] - 0.02


@pytest.mark.parametrize('way', ['command', 'service', 'timer'])
def test_contact_that_was_given_up_comes_back(way):
    with closing(ClosedLoop(resolve('quick', plant='rigid', controller={'contact_state': {
            'approach_distance': 0.02, 'retry_time': 2.0 if way == 'timer' else 0.0}}),
            commanded=True)) as loop:
        loop.advance()
        loop.plant.contacts.shift(1, 0.1)
        loop.control.set_forces({'table': 10.0, 'board': 10.0})
        _, statuses = advance(loop, 2.5)
        assert statuses[-1].contact_states == ('holding', 'given up')
        loop.plant.contacts.shift(1, -0.1)
        loop.control.set_forces({'table': 10.0, 'board': 10.0})  # as before: nothing new
        loop.advance()
        assert loop.status.contact_states == ('holding', 'given up')
        if way == 'command':
            loop.control.set_forces({'board': 12.0})
        elif way == 'service':
            assert loop.control.retry() == 'trying again'
        forces, statuses = advance(loop, 2.5)
        assert statuses[-1].contact_states == HOLDING
        assert abs(forces[-100:, 1].mean() - (12.0 if way == 'command' else 10.0)) < 0.5
        with pytest.raises(CommandError, match='expected contacts that were given up'):
            loop.control.retry()


@on_both_plants
def test_smallest_force_holds_while_sliding_and_through_a_large_step(plant):
    smallest = resolve('quick', plant=plant).controller.contact_state.smallest_force
    w = 2.0 * np.pi / 4.0
    with pressing(plant, force=smallest) as loop:
        start = loop.control.output.pose
        _, statuses = advance(loop, 4.0, each=lambda time: move(  # there and back
            loop, start, [0.05 * (1.0 - np.cos(w * time)), 0.0, 0.0],
            [0.05 * w * np.sin(w * time), 0.0, 0.0]))
        loop.control.set_forces({'table': 25.0, 'board': 25.0})
        forces, later = advance(loop, 1.0)
    assert {status.contact_states for status in statuses + later} == {HOLDING}
    assert np.abs(forces[-1] - 25.0).max() < 0.5


@on_both_plants
def test_joint_at_its_limit_does_not_wind_the_observers_up(plant):
    """Torques just beyond those of 8 N, and 25 N wanted."""
    with pressing(plant, force=8.0) as loop:
        needed = np.maximum(np.abs(loop.command) + 0.7, 2.0)
        most = np.minimum(loop.setup.controller.torque_limit, needed)
    with pressing(plant, force=8.0, controller={'torque_limit': most.tolist()}) as loop:
        loop.control.set_forces({'table': 25.0, 'board': 25.0})
        forces, statuses = advance(loop, 2.0)
        assert 'torque' in statuses[-1].limits
        assert forces.max() < 35.0
        loop.control.set_forces({'table': 8.0, 'board': 8.0})
        forces, statuses = advance(loop, 3.0)
    assert {status.contact_states for status in statuses} == {HOLDING}
    assert np.abs(forces[-100:] - 8.0).max() < 0.5


@on_both_plants
def test_surface_that_vanishes_for_a_moment_leaves_the_other_force(plant):
    """In means over 12 ms."""
    with pressing(plant) as loop:
        loop.plant.contacts.shift(1, 0.05)
        gone, _ = advance(loop, 0.3)
        loop.plant.contacts.shift(1, -0.05)
        back, statuses = advance(loop, 1.5)
    error = np.concatenate([gone, back])[:, 0] - 15.0
    assert np.abs(np.convolve(error, np.full(6, 1.0 / 6.0), 'valid')).max() < (
        1.0 if plant == 'rigid' else 2.6)
    assert statuses[-1].contact_states == HOLDING
