"""Slides on surfaces whose tilt nothing has told the controller, pressed all the while."""

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
