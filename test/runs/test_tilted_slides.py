"""Slides on surfaces whose tilt nothing has told the controller, pressed all the while."""

from canonical_runs import run_of
from multicontact_control.algebra import quintic_blend
from multicontact_control.control.tasks import MotionReading
from multicontact_control.runs.closed_loop import ClosedLoop, run_in_process
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

FORCE, DURATION = 10.0, 1.5  # N, s


def tilted_setup(robot, plant, seed, tilt):
    """Return a setup whose table is tilted, which the controller is not told."""
    setup = resolve('quick', robot=robot, plant=plant)
    normal = tilt.apply(setup.controller.contacts['table'].normal_world)
    table = {'normal_world': normal.tolist()}
    return resolve(
        'quick',
        robot=robot,
        plant=plant,
        seed=seed,
        plant_overrides={'surfaces': {'table': table}},
    )


def slide(setup, way):
    """Return forces [N] and states of a slide along a way [m], shape (3,)."""
    loop = ClosedLoop(setup, commanded=True)
    period = setup.controller.period
    forces = []
    states = set()
    loop.advance()
    loop.control.set_forces({'table': FORCE})
    for _ in range(round(2.5 / period)):
        loop.advance()
    start = loop.control.output.pose_des
    place = start.position_world.copy()
    quaternion = start.quaternion_xyzw.copy()
    line = np.array([*way, 0.0, 0.0, 0.0])
    for tick in range(round((DURATION + 0.5) / period)):
        s, ds, dds = quintic_blend(tick * period, DURATION)
        motion = MotionReading(place + s * line[:3], quaternion, ds * line, dds * line)
        loop.control.set_motion(motion)
        loop.advance()
        status = loop.control.status
        forces.append(loop.sample.contact_force[0])
        states.add((status.reaction, status.contact_states[0]))
    loop.close()
    return np.array(forces), states


@pytest.mark.slow
@pytest.mark.parametrize(
    ('robot', 'plant', 'seed'),
    [
        ('puma', 'flexible', 0),
        ('puma', 'flexible', 1),
        ('puma', 'rigid', 0),
        ('panda', 'flexible', 0),
    ],
)
@pytest.mark.parametrize(
    ('degrees', 'axis', 'way'),
    [
        (6.0, 'y', (0.2, 0.0, 0.0)),
        (-6.0, 'y', (0.2, 0.0, 0.0)),
        (-6.0, 'y', (-0.2, 0.0, 0.0)),
        (6.0, 'x', (0.0, -0.15, 0.0)),
        (-6.0, 'x', (0.0, -0.15, 0.0)),
    ],
)
def test_slide_on_a_tilted_surface_presses_on(robot, plant, seed, degrees, axis, way):
    """R grew to hundreds of N^2 there, so that the law did not see the surface fall away."""
    tilt = Rotation.from_euler(axis, degrees, degrees=True)
    forces, states = slide(tilted_setup(robot, plant, seed, tilt), way)
    assert states == {('none', 'holding')}
    assert forces.max() < FORCE + 20.0
    assert np.mean(forces[-100:]) == pytest.approx(FORCE, abs=0.5)


def test_slide_on_a_tilted_surface_keeps_to_its_path():
    """20 degrees: along the estimated normal the tool would leave its path by 17 mm."""
    setup = resolve('tilt', plant='rigid', duration=9.5)
    data = run_in_process(setup, supervised=True).data
    moving = data.time > setup.scenario.reference.motion.start_time + 1.0
    error = (data.position_des - data.position)[moving, 0]
    assert np.abs(error).max() < 1e-3
    assert np.ptp(data.position[moving, 0]) > 0.05


TILT = np.radians(10.0)  # of the table of the scenario
MOVING = 8.5  # s, from when on its motion goes along the table


def turning_setup(limit, duration=12.0):
    """Return a setup whose tool may turn by an angle [rad] on a table tilted by 10 degrees."""
    table = {'table': {'tool_turn_limit': limit}}
    return resolve(
        'waypoints',
        plant='rigid',
        duration=duration,
        controller={'contacts': table},
    )


def tilt_of_tool(setup, rotations):
    """Return the angles between the tool and the normal of the table [rad]."""
    normal = np.array(setup.plant.surfaces['table'].normal_world)
    axes = rotations.apply([0.0, 0.0, 1.0])
    return np.arccos(np.clip(axes @ normal, -1.0, 1.0))


def tip_errors(setup, data):
    """Return how far the tip is from where it should be, along the table, (m, 3) [m]."""
    point = setup.controller.contacts['table'].point_operational
    normal = np.array(setup.plant.surfaces['table'].normal_world)
    rotation = Rotation.from_quat(data.quaternion)
    rotation_des = Rotation.from_quat(data.quaternion_des)
    error = data.position_des + rotation_des.apply(point)
    error -= data.position + rotation.apply(point)
    return error - np.outer(error @ normal, normal)


@pytest.mark.slow
@pytest.mark.parametrize('limit', [0.3, 0.1])
def test_tool_turns_with_the_estimated_normal_as_far_as_it_may(limit):
    setup = turning_setup(limit)
    data = run_of(setup).data
    plain = run_of(turning_setup(0.0)).data
    moving = data.time > MOVING
    angles = tilt_of_tool(setup, Rotation.from_quat(data.quaternion))
    assert angles[moving] == pytest.approx(max(TILT - limit, 0.0), abs=0.02)
    sliding = data.time > setup.scenario.reference.motion.start_time
    assert np.linalg.norm(tip_errors(setup, data)[sliding], axis=1).max() < 5e-4
    errors = (data.alpha_true - data.alpha_des)[moving]
    assert np.std(errors) < 1.1 * np.std((plain.alpha_true - plain.alpha_des)[moving])


class TurningTool:
    """The loop of a table that turns the tool, with what it desires and commands."""

    def __init__(self, limit, *, commanded=False):
        self.setup = turning_setup(limit)
        self.loop = ClosedLoop(self.setup, commanded=commanded)
        self.period = self.setup.controller.period
        self.outputs = []

    def advance(self, duration):
        """Go on for a time [s]; return the desired angle to the table at its end [rad]."""
        for _ in range(round(duration / self.period)):
            self.outputs.append(self.loop.advance())
        rotation = Rotation.from_matrix(self.outputs[-1].pose_des.rotation_world)
        return float(tilt_of_tool(self.setup, rotation))

    def steps(self, duration):
        """
        Return the largest steps of a tick in the last time [s].

        Of the desired place [m] and orientation [rad], and of a torque [N m].
        """
        newest = self.outputs[-round(duration / self.period) - 1 :]
        ways = np.array(
            [
                before.pose_des.displacement_to(after.pose_des)
                for before, after in zip(newest, newest[1:])
            ]
        )
        torques = np.diff([output.torque for output in newest], axis=0)
        place = np.linalg.norm(ways[:, :3], axis=1).max()
        turn = np.linalg.norm(ways[:, 3:], axis=1).max()
        return place, turn, np.abs(torques).max()


@pytest.mark.slow
def test_pauses_of_a_turned_tool_make_no_jump():
    """A hold keeps the turn; a lock, in which nothing is pressed, the arm with the tool."""
    turned, plain = TurningTool(0.3), TurningTool(0.0)
    for tool in turned, plain:
        tool.advance(MOVING + 1.0)
        tool.loop.control.hold(True)
        tool.advance(1.0)
        tool.loop.control.hold(False)
        tool.advance(1.0)
        tool.found = tool.steps(2.0)
    place, turn, torque = turned.found
    assert place < 0.2e-3
    assert turn < 1e-3
    assert torque < 1.1 * plain.found[2]
    held = [tilt_of_tool(turned.setup, rotation_of(x)) for x in turned.outputs[-1000:]]
    assert max(held) < 0.02
    supervisor = turned.loop.control.supervisor
    supervisor.gate.start_blend()
    supervisor.task.set_lock(True)
    turned.advance(0.2)
    place, turn, _ = turned.steps(0.2)
    assert place < 0.2e-3
    assert turn < 1e-3
    way = rotation_of(turned.outputs[-1]) * rotation_of(turned.outputs[-101]).inv()
    assert way.magnitude() < 1e-3
    turned.loop.close()
    plain.loop.close()


def rotation_of(output):
    return Rotation.from_matrix(output.pose_des.rotation_world)


@pytest.mark.slow
def test_limit_of_the_turn_changes_live_without_a_jump():
    tool = TurningTool(0.3)
    assert tool.advance(MOVING + 0.5) < 0.02
    control = tool.loop.control
    for limit, angle in ((0.0, TILT), (0.1, TILT - 0.1)):
        control.reconfigure(turning_setup(limit).controller)
        assert tool.advance(1.5) == pytest.approx(angle, abs=0.02)
        place, turn, torque = tool.steps(1.5)
        assert place < 0.5e-3
        assert turn < 1e-3
        assert torque < 1.5  # a motion that goes on after a hold makes 4 N m
    tool.loop.close()


@pytest.mark.slow
def test_tool_turns_once_and_back_where_it_presses_no_more():
    """What is commanded from where the tool has been turned to is no further turn."""
    tool = TurningTool(0.3, commanded=True)
    control = tool.loop.control
    tool.advance(0.2)
    drawn = tool.outputs[-1].pose_des
    turn = drawn.quaternion_xyzw.copy()
    control.set_forces({'table': FORCE})
    tool.advance(2.5)
    place = tool.outputs[-1].pose_des.position_world.copy()
    for pass_ in range(3):
        line = np.array([(-1) ** pass_ * 0.15, 0.0, 0.0, 0.0, 0.0, 0.0])
        for tick in range(round(DURATION / tool.period)):
            s, ds, dds = quintic_blend(tick * tool.period, DURATION)
            motion = MotionReading(place + s * line[:3], turn, ds * line, dds * line)
            control.set_motion(motion)
            tool.advance(tool.period)
        desired = tool.outputs[-1].pose_des
        place, turn = desired.position_world.copy(), desired.quaternion_xyzw.copy()
        assert tool.advance(0.0) < 0.03
    at_rest = np.zeros(6)
    drawn_again = MotionReading(place, drawn.quaternion_xyzw, at_rest, at_rest)
    control.set_motion(drawn_again)
    assert tool.advance(3.0) < 0.03
    control.set_forces({'table': 0.0})
    assert tool.advance(3.0) == pytest.approx(TILT, abs=1e-3)
    assert control.status.contact_states == ('free',)
    assert tool.steps(3.0)[1] < 1e-3
    tool.loop.close()
