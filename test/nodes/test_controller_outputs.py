"""Contact forces as arrows."""

from arms import controller_config
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import MessageError
from multicontact_control.nodes.contact_markers import ContactMarkers
from multicontact_control.supervision.report import no_answer
import numpy as np
import pytest
from visualization_msgs.msg import Marker

STAMP = 1_795_000_000_000_000_000
QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
ORIGIN = Pose(np.zeros(3), np.eye(3))
CONFIG = controller_config()
NORMALS = np.array([CONFIG.contacts[name].normal_world for name in CONFIG.contact_names])


def as_array(point):
    return np.array([point.x, point.y, point.z])


def arrows_of(stamp, pose, forces, active, normals, markers=None):
    output = no_answer(6, len(normals))
    for array, values in zip(
            (output.alpha_meas, output.alpha_est, output.alpha_des, output.active,
             output.contacts['normal'], output.pose.position_world, output.pose.rotation_world),
            (*forces, active, normals, *pose)):
        array[:] = values
    return (markers or ContactMarkers(CONFIG)).message(stamp, output)


def test_arrows_end_at_the_tips_and_are_as_long_as_their_force():
    pose = Pose(np.array([0.5, 0.1, 0.7]), QUARTER_TURN)
    alpha = np.array([10.0, 4.0])
    found = np.array([[0.0, 0.6, -0.8], [0.6, 0.8, 0.0]])  # normals, not those of the file
    message = arrows_of(STAMP, pose, (alpha, alpha + 1.0, alpha + 2.0), [True, False], found)
    assert len({(marker.ns, marker.id) for marker in message.markers}) == 6
    for marker, name, force, normal in zip(message.markers, CONFIG.contact_names, alpha, found):
        tail, tip = (as_array(point) for point in marker.points)
        np.testing.assert_allclose(
            tip, pose.position_world + QUARTER_TURN @ CONFIG.contacts[name].point_operational)
        np.testing.assert_allclose(tip - tail, 0.01 * force * normal)
        assert (marker.header.frame_id, marker.type, marker.action) == (
            'world', Marker.ARROW, Marker.ADD)
    assert message.markers[0].color != message.markers[1].color


def test_estimated_and_desired_force_stand_beside_the_measured_one():
    forces = np.array([10.0, 4.0]), np.array([9.0, 5.0]), np.array([8.0, -3.0])
    markers = arrows_of(STAMP, ORIGIN, forces, [True, True], NORMALS).markers
    assert [marker.ns.rpartition('/')[2] for marker in markers[::2]] == [
        'table', 'estimated', 'desired']
    assert markers[5].action == Marker.DELETE and len({str(x.color) for x in markers}) == 3
    for k, normal in enumerate(NORMALS):
        tips = [as_array(marker.points[1]) for marker in markers[k::2]]
        for marker, tip, force in zip(markers[k::2], tips, forces):
            np.testing.assert_allclose(tip - as_array(marker.points[0]), 0.01 * force[k] * normal)
        for tip in tips[1:]:
            assert (tip - tips[0]) @ normal == pytest.approx(0.0, abs=1e-12)
        assert all(np.linalg.norm(one - other) > 0.02 for one, other in zip(tips, tips[1:]))


def test_arrows_of_a_sample_owe_nothing_to_those_before():
    same = ContactMarkers(CONFIG)
    for sample in (
            (STAMP, ORIGIN, [np.array([10.0, 4.0])] * 3, [True, False], NORMALS),
            (STAMP + 40_000_000, Pose(np.array([0.1, 0.2, 0.3]), QUARTER_TURN),
             [np.array([0.0, -3.0]), np.array([5.0, 6.0]), np.zeros(2)], [False, True], -NORMALS),
            (0, ORIGIN, [np.ones(2)] * 3, [False, False], NORMALS)):
        found = arrows_of(*sample, same)
        assert found == arrows_of(*sample)
        assert {(marker.header.stamp.sec, marker.header.stamp.nanosec)
                for marker in found.markers} == {divmod(sample[0], 10 ** 9)}
        assert [marker.color.r > 0.9 for marker in found.markers[:2]] == sample[3]


def test_number_that_is_not_finite_is_not_drawn():
    with pytest.raises(MessageError):
        arrows_of(STAMP, ORIGIN, [np.array([np.nan, 4.0])] * 3, [True, True], NORMALS)


def test_markers_are_due_25_times_a_second():
    assert sum(ContactMarkers(CONFIG).due(tick) for tick in range(500)) == 25
