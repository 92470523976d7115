"""Steps of a commanded motion are walked within the limits, without a hold."""

from multicontact_control.algebra import quintic_blend
from multicontact_control.control.tasks import MotionReading
from multicontact_control.runs.closed_loop import ClosedLoop
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest


@pytest.mark.slow
@pytest.mark.parametrize(
    ('robot', 'plant'),
    [
        ('puma', 'puma'),
        ('puma', 'rigid'),
        ('panda', 'rigid'),
        ('panda', 'flexible'),
        ('ur5', 'rigid'),
    ],
)
@pytest.mark.parametrize(
    ('way', 'duration'),
    [([0.1, 0.0, 0.0], 0.0), ([0.0, 0.0, 0.1], 0.0), ([0.1, 0.0, 0.0], 0.375)],
)
def test_arm_goes_where_it_is_told_within_its_limits_and_without_a_hold(
    robot, plant, way, duration
):
    """In one message, and in the shortest time that `move` accepts."""
    loop = ClosedLoop(resolve('quick', robot=robot, plant=plant), commanded=True)
    config = loop.setup.controller
    reactions = set()
    speeds = []
    for _ in range(100):
        loop.advance()
    start = loop.control.output.pose_des
    place = start.position_world.copy()
    turn = start.quaternion_xyzw.copy()
    step = np.array(way)
    zero = np.zeros(3)
    for tick in range(1500):
        s, ds, dds = (
            quintic_blend(tick * config.period, duration)
            if duration
            else (1.0, 0.0, 0.0)
        )
        if tick * config.period <= duration:
            loop.control.set_motion(
                MotionReading(
                    place + s * step,
                    turn,
                    np.append(ds * step, zero),
                    np.append(dds * step, zero),
                )
            )
        output = loop.advance()
        reactions.add(loop.control.status.reaction)
        speeds.append(np.linalg.norm(output.controls['frame']['twist'][0, :3]))
    assert reactions == {'none'}
    assert max(speeds) < 1.05 * config.limits.operational_speed
    np.testing.assert_allclose(output.pose.position_world, place + step, atol=5e-4)
    loop.close()
