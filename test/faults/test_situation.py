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

TICKS = 500
H = 0.002
PANDA = {'scenario': 'one_contact', 'robot': 'panda', 'plant': 'rigid'}
X = np.eye(3)[0]
Y = np.eye(3)[1]
DOWN = -np.eye(3)[2]


def record_still_arm(setup, *, force=10.0, command=10.0, torque=0.0, **motion):
    """
    Return what is seen of an arm that presses [N], and how it moves beside its setpoint.

    It stands where it should, but for the series of its motion that are given.
    """
    n = len(setup.plant.home)
    forces = np.full((TICKS, 1), force)
    commands = np.full((TICKS, 1), command)
    wanted = commands > 0.0
    still = np.zeros((TICKS, 3))
    seen = Observation(
        torque=np.full((TICKS, n), torque),
        time=H * np.arange(TICKS),
        force=forces[:, 0],
        reaction='none',
        forces=forces,
        commands=commands,
    )
    trace = MotionTrace(
        direction=X,
        q=np.tile(setup.plant.home, (TICKS, 1)),
        qd=np.zeros((TICKS, n)),
        position=still,
        setpoint=still,
        tip=still[:, np.newaxis],
        tip_setpoint=still[:, np.newaxis],
        wanted=wanted,
        pressed=forces > 0.0,
        across=project_across_normals(DOWN[np.newaxis], wanted),
        states=[('holding',)] * TICKS,
    )
    return seen, trace._replace(**motion)


@pytest.fixture(scope='module', name='setup')
def fixture_setup():
    return resolve_situation(PANDA, SituationConfig())[0]


def on_the_way(direction, distance):
    """Return places that go evenly in a direction, shape (ticks, 3) [m]."""
    return np.linspace(0.0, distance, TICKS)[:, np.newaxis] * direction


def tip_going_down(distance):
    """Return places of the one tip that goes evenly down, shape (ticks, 1, 3) [m]."""
    return on_the_way(DOWN, distance)[:, np.newaxis]


AHEAD = on_the_way(X, 0.3)


@pytest.mark.parametrize(
    ('changes', 'expected'),
    [
        ({}, 0.0),
        # It falls short, comes behind, or is ahead: no motion that was not asked for.
        ({'setpoint': AHEAD}, 0.0),
        ({'setpoint': AHEAD, 'position': on_the_way(X, 0.1)}, 0.0),
        ({'setpoint': AHEAD, 'position': AHEAD + 0.002 * X}, 0.0),
        # A stop lets it go on askew, nearer to the setpoint.
        ({'setpoint': [0.2 * X] * TICKS, 'position': on_the_way(X + Y, 0.05)}, 0.0),
        # It is thrown sideways, goes beyond what has stopped, or the wrong way.
        ({'setpoint': AHEAD, 'position': AHEAD + on_the_way(Y, 0.02)}, 0.02),
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
        ({'setpoint': AHEAD, 'position': on_the_way(X, -0.03)}, 0.03),
        # Along the normal the contact leads it...
        ({'position': on_the_way(DOWN, 0.05), 'tip': tip_going_down(0.05)}, 0.0),
        # ...unless there is none yet: 0.02 m/s are asked for, ...
        ({'force': 0.0, 'tip': tip_going_down(0.02)}, 0.0),
        ({'force': 0.0, 'tip': tip_going_down(0.05)}, 0.03),
        # ...or nothing is asked for.
        ({'command': 0.0, 'position': on_the_way(DOWN, 0.03)}, 0.03),
    ],
)
def test_unasked_motion_is_what_nothing_asks_for(setup, changes, expected):
    _, trace = record_still_arm(setup, **changes)
    assert unasked_motion(setup, trace) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(('state', 'expected'), [('lost', 0.03), ('retracting', 0.0)])
def test_tip_that_leaves_its_surface_is_unasked_unless_on_purpose(
    setup, state, expected
):
    forces = np.zeros((TICKS, 1))
    forces[:100] = 10.0
    tip = np.zeros((TICKS, 1, 3))
    tip[100:, 0] = np.linspace(0.0, 0.03, TICKS - 100)[:, np.newaxis] * -DOWN
    states = [(state,)] * TICKS
    _, trace = record_still_arm(setup, force=forces, tip=tip, states=states)
    assert unasked_motion(setup, trace) == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize(
    ('problem', 'changes'),
    [
        ('', {}),
        ('', {'force': 29.0}),
        ('force above the command', {'force': 30.5}),
        ('force above the command', {'force': 20.5, 'command': 0.0}),
        ('joint too fast', {'qd': np.full((TICKS, 7), 2.5)}),
        ('joint beyond its stop', {'q': np.full((TICKS, 7), 0.0112)}),
        ('motion not asked for', {'position': on_the_way(Y, 0.006)}),
        ('command not finite', {'torque': np.nan}),
    ],
)
def test_judge_of_situations_names_what_is_beyond_a_limit(setup, problem, changes):
    """The Panda's joint 4 ends at 0 rad, its slowest joints go at 2.175 rad/s."""
    row = judge_situation('', setup, *record_still_arm(setup, **changes))
    assert row.problems == problem
    assert row.safe == (problem == '')


def test_course_goes_there_and_back_at_its_speed_without_a_jump():
    start = np.array([0.1, 0.5, 0.4])
    pose = Pose.from_quaternion(start, np.array([0.0, 0.0, 0.0, 1.0]))
    course = Course(pose, X, np.zeros(3), 0.3, 0.4, legs=2)
    ways = [course.way_at(H * k) for k in range(round(course.duration / H))]
    readings = course.setpoints(np.array(ways))
    places = np.array([reading.position_world for reading in readings])
    speeds = np.array([reading.twist_world[0] for reading in readings])
    accelerations = np.array([reading.acceleration_world[0] for reading in readings])
    np.testing.assert_allclose(places[0], start, atol=1e-12)
    np.testing.assert_allclose(places[-1], start, atol=1e-12)
    np.testing.assert_allclose(np.ptp(places, axis=0), [0.3, 0.0, 0.0])
    assert np.abs(speeds).max() == pytest.approx(0.4)
    slopes = np.gradient(places[:, 0], H)
    np.testing.assert_allclose(slopes[1:-1], speeds[1:-1], rtol=0.0, atol=4e-3)
    slopes = np.gradient(speeds, H)
    np.testing.assert_allclose(slopes[1:-1], accelerations[1:-1], rtol=0.0, atol=0.05)


@pytest.mark.parametrize(
    ('joint', 'side', 'force'),
    [(1, 'lower', 10.0), (4, 'upper', 10.0), (7, 'upper', 10.0), (2, 'lower', 0.0)],
)
def test_joint_is_led_beyond_its_stop_by_the_task(joint, side, force):
    """With the joints as the task wants them, without limits: from the Jacobian along the way."""
    situation = SituationConfig(
        stop_joint=joint, stop_side=side, stop_margin=0.1, force=force
    )
    setup, course = resolve_situation(PANDA, situation)
    robot = RobotModel(setup.controller.robot, setup.urdf_dir)
    q = np.array(setup.plant.home)
    sign = {'upper': 1.0, 'lower': -1.0}[side]
    stop = getattr(setup.controller.limits, f'joint_{side}')[joint - 1]
    assert stop == pytest.approx(q[joint - 1] + sign * 0.1)
    if force:
        assert course.direction @ DOWN == pytest.approx(0.0, abs=1e-9)
    way = course.distance * np.concatenate([course.direction, course.axis])
    for _ in range(100):
        state = robot.update(q, np.zeros(7))
        J = state.jacobian
        moved = np.linalg.solve(state.mass_matrix, J.T)
        q = q + moved @ np.linalg.solve(J @ moved, way / 100)
    assert sign * (q[joint - 1] - stop) > 0.02


@pytest.mark.parametrize('appears', [False, True])
def test_bias_reads_as_pressing_from_when_it_is_there(appears):
    """From the beginning, or from the approach on."""
    situation = SituationConfig(bias_along=4.0, bias_appears=appears, farther=0.05)
    setup, course = resolve_situation(PANDA, situation)
    run = SituationRun(setup, course, situation)
    readings = []
    with closing(run.loop):
        for _ in range(252):
            run.advance()
            readings.append(run.loop.control.output.contacts['alpha_meas'][0])
    if appears:
        np.testing.assert_allclose(readings[:50], 0.0, atol=0.4)
        assert readings[-1] == pytest.approx(4.0, abs=0.6)
    else:
        np.testing.assert_allclose(readings[:50], 4.0, atol=0.4)


def test_tilted_surface_leads_up_and_lies_before_the_tip_as_the_flat_one_does():
    situation = SituationConfig(tilt=6.0, direction_world=(1.0, 0.0, 0.0), distance=0.1)
    flat, _ = resolve_situation(PANDA, SituationConfig())
    tilted, _ = resolve_situation(PANDA, situation)
    surface = tilted.plant.surfaces['table']
    assert surface.point_world == flat.plant.surfaces['table'].point_world
    angle = np.radians(6.0)
    normal = np.sin(angle) * X + np.cos(angle) * DOWN
    np.testing.assert_allclose(surface.normal_world, normal)
    uphill = -normal[0] / normal[2]  # dz / dx
    assert uphill > 0.0


def run_panda(**values):
    """Return the row of a situation of the Panda."""
    situation = SituationConfig(**values)
    return run_situation('', *resolve_situation(PANDA, situation), situation)


def test_safe_slide_arrives_at_a_part_of_the_largest_speed():
    row = run_panda(direction_world=(1.0, 0.0, 0.0), distance=0.1, speed=0.2)
    assert row.safe
    assert row.off_n < 0.1
    assert row.short_mm < 1.0
    assert 0.0 < row.peak_over_n < 10.0
    assert 0.05 < row.speed_share < 0.5


def test_payload_reads_as_force_unless_it_is_told():
    assert run_panda(payload=0.5, told=True).off_n < 0.1
    untold = run_panda(payload=0.5, told=False)
    assert untold.off_n == pytest.approx(0.5 * 9.81, abs=0.2)


@needs_mujoco
def test_foreign_arm_is_one_of_new_robot_in_mujoco():
    situation = SituationConfig()
    setup, course = resolve_situation({**PANDA, 'robot': FOREIGN}, situation)
    assert setup.plant.engine == 'mujoco'
    assert len(setup.plant.home) == 6
    row = run_situation('press', setup, course, situation)
    assert row.safe
    assert row.off_n < 0.1


def test_arm_that_breaks_down_is_not_safe(monkeypatch):
    monkeypatch.setattr(ClosedLoop, 'act', lambda self: 1 / 0)
    row = run_panda()
    assert not row.safe
    assert 'ZeroDivisionError' in row.problems
