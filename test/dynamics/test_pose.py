"""Poses and rotation errors against scipy."""

from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from multicontact_control.dynamics.rotations import Pose, rotation_vector
import numpy as np
from scipy.spatial.transform import Rotation


def rotation_error(rotation_des, rotation):
    vector = np.empty(3)
    rotation_vector(np.ascontiguousarray(rotation_des), np.ascontiguousarray(rotation), vector)
    return vector


rotation_vectors = arrays(float, (3,), elements=st.floats(-1.8, 1.8, allow_subnormal=False))


@settings(deadline=None)
@given(rotation_vectors, rotation_vectors)
def test_rotation_error_is_scipys_rotation_vector(a, b):
    R_des, R = Rotation.from_rotvec(a).as_matrix(), Rotation.from_rotvec(b).as_matrix()
    error = rotation_error(R_des, R)
    np.testing.assert_allclose(
        Rotation.from_rotvec(error).as_matrix() @ R, R_des, atol=1e-7)
    assert np.linalg.norm(error) <= np.pi + 1e-9


def test_pose_quaternion_makes_the_round_trip():
    R = Rotation.from_rotvec([0.3, -0.2, 1.0]).as_matrix()
    pose = Pose(np.array([1.0, 2.0, 3.0]), R)
    again = Pose.from_quaternion(pose.position_world, 2.0 * pose.quaternion_xyzw)
    np.testing.assert_allclose(again.rotation_world, R, atol=1e-12)
