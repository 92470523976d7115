"""Slides on surfaces whose tilt nothing has told the controller, pressed all the while."""

from multicontact_control.algebra import quintic_blend
from multicontact_control.control.tasks import MotionReading
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

FORCE, DURATION = 10.0, 1.5  # N, s


def slide(robot, plant, degrees, axis, way, seed):
    """Return forces and states of a slide on a table that is tilted about a world axis."""

    def table(setup):
        return np.array(setup.controller.contacts['table'].normal_world)

    turn = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)['xyz'.index(axis)])
    normal = turn.apply(table(resolve('quick', robot=robot, plant=plant)))
    loop = ClosedLoop(
        resolve(
            'quick',
            robot=robot,
            plant=plant,
            seed=seed,
            plant_overrides={'surfaces': {'table': {'normal_world': normal.tolist()}}},
        ),
        commanded=True,
    )
    period, forces, states = loop.setup.controller.period, [], set()
    loop.advance()
    loop.control.set_forces({'table': FORCE})
    for _ in range(round(2.5 / period)):
        loop.advance()
    start = loop.control.output.pose_des
    place, quaternion = start.position_world.copy(), start.quaternion_xyzw.copy()
    for tick in range(round((DURATION + 0.5) / period)):
        s, ds, dds = quintic_blend(tick * period, DURATION)
        twist, acceleration = np.zeros((2, 6))
        twist[:3], acceleration[:3] = ds * np.array(way), dds * np.array(way)
        loop.control.set_motion(
            MotionReading(place + s * np.array(way), quaternion, twist, acceleration)
        )
        loop.advance()
        forces.append(loop.sample.contact_force[0])
        states.add(
            (loop.control.status.reaction, loop.control.status.contact_states[0])
        )
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
    forces, states = slide(robot, plant, degrees, axis, way, seed)
    assert states == {('none', 'holding')}
    assert forces.max() < FORCE + 20.0
    assert np.mean(forces[-100:]) == pytest.approx(FORCE, abs=0.5)
