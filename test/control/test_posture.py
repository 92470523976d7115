"""What seven joints do with the one that their task does not need."""

from arms import run_loop, seven_joint_loop
import numpy as np
import pytest

REPORT_ONLY = {'reaction': 'none'}  # a hand on the elbow is a collision otherwise


@pytest.mark.slow
def test_pushed_elbow_comes_back_and_the_force_on_the_wall_stays(tmp_path):
    """8 N for a second left it 0.24 rad away for good, before there was a posture."""
    arm, loop = seven_joint_loop(tmp_path, collision=REPORT_ONLY)
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


@pytest.mark.slow
def test_joint_is_kept_off_its_stop(tmp_path):
    arm, loop = seven_joint_loop(tmp_path, collision=REPORT_ONLY)
    lower, upper = arm.q - 2.0, arm.q + 2.0
    upper[2] = arm.q[2] + 0.05  # within the margin of 0.1 rad
    arm, loop = seven_joint_loop(tmp_path, collision=REPORT_ONLY, limits={
        'joint_lower': lower.tolist(), 'joint_upper': upper.tolist()},
        posture={'joints': (arm.q + 0.5).tolist()})
    start = arm.wrist.translation.copy()
    way = run_loop(arm, loop, 3.0, each=lambda: upper[2] - arm.q[2])
    assert way.min() > 0.04
    assert way[-1] > 0.06
    np.testing.assert_allclose(arm.wrist.translation, start, atol=1e-3)
