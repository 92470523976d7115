"""Simulated arms recover: gaps, collisions, wrong sensors, surfaces that go and come."""

from contextlib import closing

from campaign.velocities import Cell, FARTHEST, FASTER, LARGEST_FORCE, run
from multicontact_control.config.supervision import WatchdogConfig
from multicontact_control.control.tasks import MotionReading
from multicontact_control.errors import CommandError, ConfigError
from multicontact_control.faults.fault_run import resolve_with_obstacles
from multicontact_control.faults.vocabulary import ELBOW_WALL, FAR
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
from multicontact_control.supervision.reactions import RECOVERING, RecoveryPolicy
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

HOLDING = ('holding',) * 2
H = 0.002
SETTLED = {
    'rigid': 1.8,
    'puma': 2.4,
}  # s, twice what it takes to be within 0.5 N of 15 N
on_both_plants = pytest.mark.parametrize('plant', list(SETTLED))


def pressing(plant, force=15.0, forces=None, **changes):
    """Return a commanded loop that presses on both surfaces, at rest, to be closed."""
    loop = ClosedLoop(resolve('quick', plant=plant, **changes), commanded=True)
    loop.advance()
    loop.control.set_forces(forces or {'table': force, 'board': force})
    advance(loop, SETTLED[plant])
    assert set(loop.status.contact_states) <= {'holding', 'free'}
    return closing(loop)


def advance(loop, seconds, corrupt=None, each=None, felt=None):
    """Advance; return the true forces, shape (ticks, contacts), or others, and the statuses."""
    forces, statuses = [], []
    for k in range(round(seconds / H)):
        if each is not None:
            each((k + 1) * H)
        loop.advance(corrupt)
        forces.append(felt() if felt else loop.sample.contact_force.copy())
        statuses.append(loop.status)
    return np.array(forces), statuses


def move(loop, start, offset, velocity=(0.0, 0.0, 0.0)):
    """Command a place beside a pose, in its orientation."""
    loop.control.set_motion(
        MotionReading(
            start.position_world + offset,
            start.quaternion_xyzw,
            np.concatenate([velocity, np.zeros(3)]),
            np.zeros(6),
        )
    )


@pytest.mark.parametrize(
    ('cause', 'soon'),
    [
        ('wrench_stale', 1.0),
        ('collision_joint2', 5.0),
        ('motion_joint_speed', 5.0),
        ('law_not_finite', 5.0),
        ('wrench_sideways', 5.0),
    ],
)
def test_recovery_waits_longer_after_each_relapse_and_latches_physical_causes(
    cause, soon
):
    """From 50 ms up to 2 s; a reaction is a relapse within `soon` after control has resumed."""
    recovery = RecoveryPolicy(WatchdogConfig().recovery_time, H)
    tick = 0

    def stop(after):
        """Return the wait after some seconds of control [s]; None for ever."""
        nonlocal tick
        tick += round(after / H)
        recovery.note_reaction((cause,), tick)
        waits = [k * H for k in range(2000) if recovery.waiting_causes(k) == ()]
        recovery.resumed_at = tick
        return waits[0] if waits else None

    waits = [0.05, 0.15, 0.45, 1.35, 2.0, 2.0]
    if soon == 5.0:
        waits[3:] = [None] * 3
    assert [stop(0.5 * soon) for _ in waits] == pytest.approx(waits, abs=1.01 * H)
    recovery.unlatch_control()
    assert recovery.waiting_causes(2000) == ()
    assert stop(1.1 * soon) == pytest.approx(0.05)
    assert recovery.waiting_causes(0) == (RECOVERING,)


@on_both_plants
def test_gaps_of_the_wrench_are_bridged_and_long_ones_held_with_the_force(plant):
    with pressing(plant) as loop:
        for gap in (1, 2, 5, 10, 20, 50):
            before, _ = advance(loop, 0.2)
            during, statuses = advance(
                loop, gap * H, lambda inputs: inputs._replace(wrench=None)
            )
            after, later = advance(loop, 0.5)
            error = np.abs(np.concatenate([during, after]) - before.mean(axis=0))
            bridged = gap <= 10
            assert (
                'hold' in {status.reaction for status in statuses + later}
            ) != bridged
            assert {status.contact_states for status in statuses + later} == {HOLDING}
            assert error.max() < (0.5 if bridged else 4.0)
            assert error[-1].max() < 0.5
        advance(loop, 0.1, lambda inputs: inputs._replace(wrench=None))
        with pytest.raises(CommandError, match='wait: a reaction still presses'):
            loop.control.tare()
        loop.control.hold(True)
        forces, statuses = advance(loop, 1.0)
        assert (statuses[-1].reaction, statuses[-1].contact_states) == ('none', HOLDING)
        assert loop.control.held and np.abs(forces[-1] - 15.0).max() < 0.5


@on_both_plants
@pytest.mark.parametrize('silent', [True, False])
def test_emergency_stop_in_contact_is_recovered_from(plant, silent):
    """Brakes hold the arm for 2 s: nothing comes of it, or its torques have no effect."""

    def stopped(inputs):
        return (
            inputs._replace(joints=None, wrench=None)
            if silent
            else inputs._replace(
                joints=inputs.joints._replace(qd=np.zeros(6)),
                wrench=inputs.wrench._replace(
                    wrench=inputs.wrench.wrench + 1e-3 * np.sin(loop.tick)
                ),
            )
        )

    with pressing(plant) as loop:
        before = loop.command
        for _ in range(1000):
            loop.answer(stopped)
            loop.tick += 1
            assert np.abs(loop.command - before).max() < 20.0
        speeds = []
        forces, statuses = advance(
            loop, 2.0, each=lambda time: speeds.append(np.abs(loop.sample.qd).max())
        )
    assert forces.max() < 20.0 and max(speeds) < 0.5
    assert (
        np.abs(forces[-1] - 15.0).max() < 0.5 and statuses[-1].contact_states == HOLDING
    )


@pytest.mark.parametrize(
    ('plant', 'turn', 'least', 'most'),
    [('puma', 0.9, 4.0, 16.0), ('rigid', 1.5, 1.0, 20.0)],
)
def test_turning_about_the_wrist_with_the_board_held_loses_nothing(
    plant, turn, least, most
):
    """The speed of the tip counts, and not that of the wrist."""
    axis, w = np.array([0.0, 1.0, 0.0]), np.pi  # the normal: the tip stays on the board
    with pressing(plant, forces={'table': 0.0, 'board': 10.0}) as loop:
        start = loop.control.output.pose

        def rotate(time):
            rotation = Rotation.from_rotvec(
                turn / w * np.sin(w * time) * axis
            ).as_matrix()
            loop.control.set_motion(
                MotionReading(
                    start.position_world,
                    Rotation.from_matrix(rotation @ start.rotation_world).as_quat(),
                    np.concatenate([np.zeros(3), turn * np.cos(w * time) * axis]),
                    np.zeros(6),
                )
            )

        forces, statuses = advance(
            loop, 2.0, each=rotate
        )  # a whole turn, to either side
    assert {status.contact_states[1] for status in statuses} == {'holding'}
    assert least < forces[:, 1].min() and forces[:, 1].max() < most


WALL = {
    'obstacle_names': ['wall'],
    'surfaces': {
        'wall': {
            'tip_link': 'tip_table',
            'point_world': [0.03, 0.55, 0.42],
            'normal_world': [1.0, 0.0, 0.0],
            'stiffness': 3000.0,
            'roughness_std': 0.0,
        }
    },
}


@on_both_plants
def test_side_wall_latches_after_a_few_relapses_and_the_operator_can_retreat(plant):
    with pressing(plant, plant_overrides=WALL) as loop:
        start = loop.control.output.pose
        forces, statuses = advance(
            loop,
            3.5,
            each=lambda time: move(loop, start, [min(0.1 * time, 0.08), 0.0, 0.0]),
        )
        assert (
            sum(a.reaction != b.reaction for a, b in zip(statuses, statuses[1:])) <= 7
        )
        assert statuses[-1].causes == ('latched',)
        assert forces.max() < 40.0
        move(loop, start, [-0.03, 0.0, 0.0])
        assert loop.control.retry() == 'trying again'
        _, statuses = advance(loop, 2.0)
        assert (statuses[-1].reaction, statuses[-1].contact_states) == ('none', HOLDING)
        assert (
            loop.control.output.pose.position_world[0] < start.position_world[0] - 0.02
        )


@pytest.mark.parametrize('way', ['command', 'service', 'timer'])
def test_contact_that_was_given_up_comes_back(way):
    with closing(
        ClosedLoop(
            resolve(
                'quick',
                plant='rigid',
                controller={
                    'contact_state': {
                        'approach_distance': 0.02,
                        'retry_time': 2.0 if way == 'timer' else 0.0,
                    }
                },
            ),
            commanded=True,
        )
    ) as loop:
        loop.advance()
        loop.plant.contacts.shift_surface(1, 0.1)
        loop.control.set_forces({'table': 10.0, 'board': 10.0})
        # A stream of commands seeks nothing anew, one after a while does.
        advance(
            loop,
            2.5,
            each=lambda time: loop.control.set_forces(
                {'table': 10.0 + 0.1 * np.sin(time)}
            ),
        )
        loop.plant.contacts.shift_surface(1, -0.1)
        loop.control.set_forces({'board': 10.0})  # as before: nothing new
        loop.advance()
        assert loop.status.contact_states == ('holding', 'given up')
        if way == 'command':
            advance(loop, 1.1)
            loop.control.set_forces({'board': 12.0})
        elif way == 'service':
            loop.control.retry()
        forces, statuses = advance(loop, 2.5)
        assert statuses[-1].contact_states == HOLDING
        assert abs(forces[-100:, 1].mean() - (12.0 if way == 'command' else 10.0)) < 0.5
        with pytest.raises(CommandError, match='nothing to resume'):
            loop.control.retry()


@on_both_plants
def test_smallest_force_holds_while_sliding_and_through_a_large_step(plant):
    smallest = resolve('quick', plant=plant).controller.contact_state.smallest_force
    w = 2.0 * np.pi / 4.0
    with pressing(plant, force=smallest) as loop:
        start = loop.control.output.pose
        _, statuses = advance(
            loop,
            4.0,
            each=lambda time: move(  # there and back
                loop,
                start,
                [0.05 * (1.0 - np.cos(w * time)), 0.0, 0.0],
                [0.05 * w * np.sin(w * time), 0.0, 0.0],
            ),
        )
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
        loop.plant.contacts.shift_surface(1, 0.05)
        gone, _ = advance(loop, 0.3)
        loop.plant.contacts.shift_surface(1, -0.05)
        back, statuses = advance(loop, 1.5)
    error = np.concatenate([gone, back])[:, 0] - 15.0
    assert np.abs(np.convolve(error, np.full(6, 1.0 / 6.0), 'valid')).max() < (
        1.0 if plant == 'rigid' else 2.6
    )
    assert statuses[-1].contact_states == HOLDING


DEPTH = 2.5e-3  # m, at once: 15 N on the obstacle of 6000 N/m


def standing(plant, ticks=150, *, commanded=True, **controller):
    """Return a loop that stands still, an obstacle far from its elbow, to be closed."""
    overrides = resolve_with_obstacles('quick', plant, 0).plant.model_dump(
        include={'obstacle_names', 'surfaces'}
    )
    loop = ClosedLoop(
        resolve('quick', plant=plant, plant_overrides=overrides, controller=controller),
        commanded=commanded,
    )
    elbow_forces(loop, ticks)
    assert not loop.control.events.collisions
    return closing(loop)


def elbow_forces(loop, ticks, corrupt=None):
    """Advance; return the forces on the obstacle and the statuses."""
    return advance(
        loop, ticks * H, corrupt, felt=lambda: loop.plant.contacts.pressed[ELBOW_WALL]
    )


def with_effort(change):
    return lambda inputs: inputs._replace(
        joints=inputs.joints._replace(effort=change(inputs.joints.effort))
    )


@pytest.mark.parametrize(
    ('plant', 'corrupt', 'joints'),
    [
        ('rigid', None, ('joint1', 'joint2')),
        ('rigid', with_effort(lambda effort: None), ('joint1', 'joint2')),
        ('panda/rigid', None, ('panda_joint2',)),
        ('iiwa/rigid', None, ('lbr_iiwa_joint_2',)),
    ],
)
def test_collision_of_15_newtons_is_seen_within_20_ms_and_held_against(
    plant, corrupt, joints
):
    """On rigid drives, from measured torques and from commanded ones."""
    with standing(plant, collision={'command_delay': 1}) as loop:
        elbow_forces(loop, 10, corrupt)
        loop.plant.contacts.put_before_tip(ELBOW_WALL, -DEPTH)
        forces, statuses = elbow_forces(loop, 300, corrupt)
        seen = [bool(status.causes) for status in statuses].index(True)
        assert 10.0 < forces[0] <= 15.0
        assert seen <= 10
        # What is on the elbow's axis loads the joints before it alone.
        assert {cause for status in statuses for cause in status.causes} <= {
            *(f'collision_{joint}' for joint in joints),
            'recovering',
        }
        assert statuses[seen].reaction == 'hold'
        assert forces.max() < 20.0
        assert loop.control.events.collisions.total() >= 1
        loop.plant.contacts.shift_surface(ELBOW_WALL, FAR)
        _, statuses = elbow_forces(loop, 1500, corrupt)
    assert (statuses[-1].reaction, statuses[-1].causes) == ('none', ())


def test_forces_are_controlled_without_a_wrist_sensor():
    """
    10 N on both surfaces, by the joint torques alone, on rigid drives without friction.

    Without torques it is held: their last estimate does not pass for a measurement.
    """
    with pressing(
        'rigid',
        10.0,
        controller={'wrench_input': 'momentum', 'robot': {'sensor_frame': ''}},
    ) as loop:
        forces, statuses = advance(loop, 2.0)
        for missing in (None, np.zeros(6), np.full(6, np.nan)):
            _, stale = advance(loop, 0.08, with_effort(lambda effort, x=missing: x))
            assert stale[-1].causes == ('wrench_stale',)
            _, after = advance(loop, 1.1)
            assert after[-1].reaction == 'none'
        with pytest.raises(CommandError, match='a tare needs a wrist sensor'):
            loop.control.tare()
    assert statuses[-1].contact_states == HOLDING
    np.testing.assert_allclose(np.mean(forces[-500:], axis=0), 10.0, atol=0.3)
    assert np.std(forces[-500:], axis=0).max() < 0.5
    for changes in ({'wrench_input': 'momentum'}, {'robot': {'sensor_frame': ''}}):
        with pytest.raises(ConfigError, match='robot.sensor_frame'):  # both, or neither
            resolve('quick', controller=changes)


@pytest.mark.parametrize(
    'cell',
    [
        Cell('panda', False, True, 'joints:in_degrees_qd'),
        Cell('puma', True, False, 'joints:sign_flipped_qd_of_one', 1),
        Cell('panda', False, True, 'wrench:biased_by_50%', 2),
        Cell('puma', False, False, 'wrench:biased_by_50%', 2),
    ],
)
def test_wrong_speeds_and_an_unproven_sensor_are_named_and_move_nothing(cell):
    """From the first sample on; unchecked: 24 rad/s and 1100 N, and 0.3 m within 10 s."""
    result = run(cell)
    if cell.fault.startswith('wrench'):
        assert result['way'] < FARTHEST and result['causes']
    else:
        right = run(Cell(*cell[:3]))
        assert (result['speed'] - right['speed']).max() < FASTER
        assert result['force'] < LARGEST_FORCE and 'joints_velocity' in result['causes']
