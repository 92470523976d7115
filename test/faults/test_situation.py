"""Situations: that they are what they say, and that their judge sees what it must and no more."""

from contextlib import closing

from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.faults.course import Course
from multicontact_control.faults.outcomes import (
    judge_situation,
    Observation,
)
from multicontact_control.faults.situation import (
    FOREIGN,
    resolve_situation,
    SituationConfig,
)
from multicontact_control.faults.situation_run import (
    run_situation,
    SituationRun,
)
from multicontact_control.faults.unasked_motion import (
    MotionTrace,
    project_across_normals,
    unasked_motion,
)
from multicontact_control.runs.closed_loop import ClosedLoop
import numpy as np
import pytest
from robots import needs_mujoco

TICKS, H = 500, 0.002
PANDA = {'scenario': 'one_contact', 'robot': 'panda', 'plant': 'rigid'}
X, Y, DOWN = np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2]


def seen_and_way(setup, *, force=10.0, **changes):
    """Return what is seen of an arm that stands and presses with what is commanded."""
    n, still = len(setup.plant.home), np.zeros((TICKS, 3))
    forces = np.full((TICKS, 1), force)
    values = {
        'torque': np.zeros((TICKS, n)),
        'force': forces[:, 0],
        'forces': forces,
        'commands': np.full((TICKS, 1), 10.0),
        'q': np.tile(setup.plant.home, (TICKS, 1)),
        'qd': np.zeros((TICKS, n)),
        'position': still,
        'setpoint': still,
        'tip': still[:, np.newaxis],
        'tip_setpoint': still[:, np.newaxis],
        'states': [('holding',)] * TICKS,
        **changes,
    }
    seen = Observation(
        time=H * np.arange(TICKS),
        reaction='none',
        **{
            name: values.pop(name) for name in ('torque', 'force', 'forces', 'commands')
        },
    )
    wanted = seen.commands > 0.0
    return seen, MotionTrace(
        **{'direction': X, **values},
        wanted=wanted,
        pressed=seen.forces > 0.0,
        across=project_across_normals(DOWN[np.newaxis], wanted),
    )


@pytest.fixture(scope='module', name='setup')
def fixture_setup():
    return resolve_situation(PANDA, SituationConfig())[0]


def on_the_way(direction, distance):
    """Return places that go evenly in a direction, shape (ticks, 3) [m]."""
    return np.linspace(0.0, distance, TICKS)[:, np.newaxis] * direction


@pytest.mark.parametrize(
    ('changes', 'expected'),
    [
        ({}, 0.0),
        # It falls short, comes behind, or is ahead: no motion that was not asked for.
        ({'setpoint': on_the_way(X, 0.3)}, 0.0),
        ({'setpoint': on_the_way(X, 0.3), 'position': on_the_way(X, 0.1)}, 0.0),
        (
            {
                'setpoint': on_the_way(X, 0.3),
                'position': on_the_way(X, 0.3) + 0.002 * X,
            },
            0.0,
        ),
        # A stop lets it go on askew, nearer to the setpoint.
        (
            {
                'setpoint': on_the_way(X, 0.0) + 0.2 * X,
                'position': on_the_way(X + Y, 0.05),
            },
            0.0,
        ),
        # It is thrown sideways, goes beyond what has stopped, or the wrong way.
        (
            {
                'setpoint': on_the_way(X, 0.3),
                'position': on_the_way(X, 0.3) + on_the_way(Y, 0.02),
            },
            0.02,
        ),
        ({'position': on_the_way(X, 0.01)}, 0.01),
        ({'position': on_the_way(X, 0.01), 'direction': np.zeros(3)}, 0.01),
        # What has gone aside at a stop stays there while the setpoint comes back: no motion.
        (
            {
                'setpoint': 0.2 * X - on_the_way(X, 0.2),
                'position': np.minimum(0.05, 4.0 * on_the_way(X + Y, 0.05)),
            },
            0.0,
        ),
        ({'setpoint': on_the_way(X, 0.3), 'position': on_the_way(X, -0.03)}, 0.03),
        # Along the normal the contact leads it...
        (
            {
                'position': on_the_way(DOWN, 0.05),
                'tip': on_the_way(DOWN, 0.05)[:, np.newaxis],
            },
            0.0,
        ),
        # ...unless there is none yet: 0.02 m/s are asked for, ...
        ({'force': 0.0, 'tip': on_the_way(DOWN, 0.02)[:, np.newaxis]}, 0.0),
        ({'force': 0.0, 'tip': on_the_way(DOWN, 0.05)[:, np.newaxis]}, 0.03),
        # ...or nothing is asked for.
        ({'commands': np.zeros((TICKS, 1)), 'position': on_the_way(DOWN, 0.03)}, 0.03),
    ],
)
def test_unasked_motion_is_what_nothing_asks_for(setup, changes, expected):
    _, way = seen_and_way(setup, **changes)
    assert unasked_motion(setup, way) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(('state', 'expected'), [('lost', 0.03), ('retracting', 0.0)])
def test_tip_that_leaves_its_surface_is_unasked_unless_on_purpose(
    setup, state, expected
):
    forces = np.where(np.arange(TICKS) < 100, 10.0, 0.0)[:, np.newaxis]
    rising = np.clip(on_the_way(-DOWN, 0.0375) - 0.0075 * -DOWN, 0.0, None)[
        :, np.newaxis
    ]
    _, way = seen_and_way(setup, forces=forces, tip=rising, states=[(state,)] * TICKS)
    assert unasked_motion(setup, way) == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize(
    ('problem', 'changes'),
    [
        ('', {}),
        ('', {'force': 29.0}),
        ('force above the command', {'force': 30.5}),
        ('force above the command', {'force': 20.5, 'commands': np.zeros((TICKS, 1))}),
        ('joint too fast', {'qd': np.full((TICKS, 7), 2.5)}),
        ('joint beyond its stop', {'q': np.full((TICKS, 7), 0.0112)}),
        ('motion not asked for', {'position': on_the_way(Y, 0.006)}),
        ('command not finite', {'torque': np.full((TICKS, 7), np.nan)}),
    ],
)
def test_judge_of_situations_names_what_is_beyond_a_limit(setup, problem, changes):
    """The Panda's joint 4 ends at 0 rad, its slowest joints go at 2.175 rad/s."""
    row = judge_situation('', setup, *seen_and_way(setup, **changes))
    assert (row.problems, row.safe) == (problem, not problem)


def test_course_goes_there_and_back_at_its_speed_without_a_jump():
    pose = Pose.from_quaternion(
        np.array([0.1, 0.5, 0.4]), np.array([0.0, 0.0, 0.0, 1.0])
    )
    course = Course(pose, X, np.zeros(3), 0.3, 0.4, legs=2)
    ticks = range(round(course.duration / H))
    readings = course.setpoints(np.array([course.way_at(k * H) for k in ticks]))
    places = np.array([reading.position_world for reading in readings])
    twists = np.array([reading.twist_world[0] for reading in readings])
    np.testing.assert_allclose(
        places[[0, -1]], np.tile(pose.position_world, (2, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.ptp(places, axis=0), [0.3, 0.0, 0.0])
    assert np.abs(twists).max() == pytest.approx(0.4)
    np.testing.assert_allclose(
        np.gradient(places[:, 0], H)[1:-1], twists[1:-1], atol=4e-3
    )
    rates = [reading.acceleration_world[0] for reading in readings]
    np.testing.assert_allclose(np.gradient(twists, H)[1:-1], rates[1:-1], atol=0.05)


@pytest.mark.parametrize(
    ('joint', 'side', 'force'),
    [(1, 'lower', 10.0), (4, 'upper', 10.0), (7, 'upper', 10.0), (2, 'lower', 0.0)],
)
def test_joint_is_led_beyond_its_stop_by_the_task(joint, side, force):
    """With the joints as the task wants them, without limits: from the Jacobian along the way."""
    setup, course = resolve_situation(
        PANDA,
        SituationConfig(stop_joint=joint, stop_side=side, stop_margin=0.1, force=force),
    )
    robot, q = (
        RobotModel(setup.controller.robot, setup.urdf_dir),
        np.array(setup.plant.home),
    )
    sign = 1.0 if side == 'upper' else -1.0
    stop = getattr(setup.controller.limits, f'joint_{side}')[joint - 1]
    assert stop == pytest.approx(q[joint - 1] + sign * 0.1)
    if force:
        assert course.direction @ DOWN == pytest.approx(0.0, abs=1e-9)
    for _ in range(100):
        state = robot.update(q, np.zeros(7))
        moved = np.linalg.solve(state.mass_matrix, state.jacobian.T)
        twist = np.concatenate([course.direction, course.axis]) * course.distance / 100
        q = q + moved @ np.linalg.solve(state.jacobian @ moved, twist)
    assert sign * (q[joint - 1] - stop) > 0.02


@pytest.mark.parametrize('appears', [False, True])
def test_bias_reads_as_pressing_from_when_it_is_there(appears):
    situation = SituationConfig(bias_along=4.0, bias_appears=appears, farther=0.05)
    setup, course = resolve_situation(PANDA, situation)
    run = SituationRun(setup, course, situation)
    with closing(run.loop):
        for tick in range(252):
            run.advance()
            read = run.loop.control.output.contacts['alpha_meas'][0]
            if tick < 50:  # before the approach
                assert read == pytest.approx(0.0 if appears else 4.0, abs=0.4)
        if appears:
            assert read == pytest.approx(4.0, abs=0.6)


def test_tilted_surface_leads_up_and_lies_before_the_tip_as_the_flat_one_does():
    situation = SituationConfig(tilt=6.0, direction_world=(1.0, 0.0, 0.0), distance=0.1)
    flat, tilted = (
        resolve_situation(PANDA, case)[0].plant.surfaces['table']
        for case in (SituationConfig(), situation)
    )
    assert tilted.point_world == flat.point_world
    angle = np.radians(6.0)
    np.testing.assert_allclose(
        tilted.normal_world, np.sin(angle) * X + np.cos(angle) * DOWN
    )
    assert (
        -tilted.normal_world[0] / tilted.normal_world[2] > 0.0
    )  # dz / dx of the surface


def test_safe_situations_have_the_figures_of_what_is_asked_for():
    """A slide that arrives, one that falls short at a side of the box, and a payload."""
    slide = SituationConfig(direction_world=(1.0, 0.0, 0.0), distance=0.1, speed=0.2)
    row = run_situation('slide', *resolve_situation(PANDA, slide), slide)
    assert row.safe and row.off_n < 0.1 and row.short_mm < 1.0
    assert 0.0 < row.peak_over_n < 10.0 and 0.05 < row.speed_share < 0.5
    told, untold = (SituationConfig(payload=0.5, told=told) for told in (True, False))
    rows = [
        run_situation('payload', *resolve_situation(PANDA, case), case)
        for case in (told, untold)
    ]
    assert rows[0].off_n < 0.1
    assert rows[1].off_n == pytest.approx(0.5 * 9.81, abs=0.2)  # it reads as force


@needs_mujoco
def test_foreign_arm_is_one_of_new_robot_in_mujoco():
    setup, course = resolve_situation(
        {'scenario': 'one_contact', 'robot': FOREIGN, 'plant': 'rigid'},
        SituationConfig(),
    )
    assert setup.plant.engine == 'mujoco' and len(setup.plant.home) == 6
    row = run_situation('press', setup, course, SituationConfig())
    assert row.safe and row.off_n < 0.1


def test_arm_that_breaks_down_is_not_safe(monkeypatch):
    monkeypatch.setattr(ClosedLoop, 'act', lambda self: 1 / 0)
    row = run_situation(
        '', *resolve_situation(PANDA, SituationConfig()), SituationConfig()
    )
    assert not row.safe and 'ZeroDivisionError' in row.problems
