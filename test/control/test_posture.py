"""The posture of an arm of seven joints, of which its task needs six."""

from arms import run_loop, seven_joint_loop
import numpy as np
import pytest


@pytest.mark.slow
def test_pushed_elbow_comes_back_and_the_force_on_the_wall_stays(tmp_path):
    """8 N for a second left it 0.24 rad away for good, before there was a posture."""
    arm, loop = seven_joint_loop(tmp_path, collision={'reaction': 'none'})
    run_loop(arm, loop, 0.2)
    loop.set_forces({'wall': 10.0})
    run_loop(arm, loop, 2.0, first=100)
    start = arm.q.copy()
    arm.pushes['l3'] = np.array([0.0, 8.0, 0.0])
    pushed = run_loop(arm, loop, 1.0, first=1100, each=lambda: (
        arm.force, np.abs(arm.q - start).max()))
    del arm.pushes['l3']
    after = run_loop(arm, loop, 2.0, first=1600, each=lambda: (
        arm.force, np.abs(arm.q - start).max()))
    assert set(loop.events.reactions) <= {'none', 'inflate'}
    assert pushed[:, 1].max() > 0.05
    assert after[-1, 1] < 0.02
    forces = np.concatenate([pushed, after])[:, 0]
    np.testing.assert_allclose(forces, 10.0, atol=1.5)
    np.testing.assert_allclose(forces[-250:], 10.0, atol=0.5)
