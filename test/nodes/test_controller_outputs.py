"""Contact forces as arrows."""

from multicontact_control.config import ControllerConfig, read_parameters, validate
from multicontact_control.dynamics.pose import Pose
from multicontact_control.errors import MessageError
from multicontact_control.nodes.controller_outputs import ContactMarkers
from multicontact_control.paths import config_dir
import numpy as np
import pytest
from visualization_msgs.msg import Marker

STAMP = 1_795_000_000_000_000_000
QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture
def config():
    path = config_dir() / 'controller.yaml'
    return validate(ControllerConfig, read_parameters(path), str(path))


def as_array(point):
    return np.array([point.x, point.y, point.z])


def normals(config):
    return np.array([config.contacts[name].normal_world for name in config.contact_names])


def arrows_of(config, *sample):
    return ContactMarkers(config, rate=25.0, scale=0.01).message(*sample)


def test_arrows_end_at_the_tips_and_are_as_long_as_their_force(config):
    pose = Pose(np.array([0.5, 0.1, 0.7]), QUARTER_TURN)
    alpha = np.array([10.0, 4.0])
    found = np.array([[0.0, 0.6, -0.8], [0.6, 0.8, 0.0]])  # normals, not those of the file
    message = arrows_of(
        config, STAMP, pose, (alpha, alpha + 1.0, alpha + 2.0), [True, False], found)
    assert len(message.markers) == 6
    for marker, name, force, normal in zip(message.markers, config.contact_names, alpha, found):
        contact = config.contacts[name]
        tail, tip = (as_array(point) for point in marker.points)
        np.testing.assert_allclose(
            tip, pose.position_world + QUARTER_TURN @ contact.point_operational)
        np.testing.assert_allclose(tip - tail, 0.01 * force * normal)
        assert (marker.header.frame_id, marker.type) == ('world', Marker.ARROW)
        assert marker.action == Marker.ADD
    assert message.markers[0].color != message.markers[1].color
    assert len({(marker.ns, marker.id) for marker in message.markers}) == 6


def test_estimated_and_desired_force_stand_beside_the_measured_one(config):
    forces = np.array([10.0, 4.0]), np.array([9.0, 5.0]), np.array([8.0, 0.0])
    markers = arrows_of(
        config, STAMP, Pose(np.zeros(3), np.eye(3)), forces, [True, True],
        normals(config)).markers
    assert [marker.ns.rpartition('/')[2] for marker in markers[::2]] == [
        'table', 'estimated', 'desired']
    assert markers[5].action == Marker.DELETE and len({str(x.color) for x in markers}) == 3
    for k, name in enumerate(config.contact_names):
        normal = np.array(config.contacts[name].normal_world)
        tips = [as_array(marker.points[1]) for marker in markers[k::2]]
        for marker, tip, force in zip(markers[k::2], tips, forces):
            np.testing.assert_allclose(tip - as_array(marker.points[0]), 0.01 * force[k] * normal)
        for tip in tips[1:]:
            assert (tip - tips[0]) @ normal == pytest.approx(0.0, abs=1e-12)
        assert all(np.linalg.norm(one - other) > 0.02 for one, other in zip(tips, tips[1:]))


def test_contact_without_force_has_no_arrow(config):
    message = arrows_of(
        config, STAMP, Pose(np.zeros(3), np.eye(3)), [np.array([0.0, -3.0])] * 3, [False, False],
        normals(config))
    assert [marker.action for marker in message.markers] == [Marker.DELETE] * 6


def test_arrows_of_a_sample_owe_nothing_to_those_before(config):
    at, same = Pose(np.zeros(3), np.eye(3)), ContactMarkers(config, rate=25.0, scale=0.01)
    samples = [
        (STAMP, at, [np.array([10.0, 4.0])] * 3, [True, False], normals(config)),
        (STAMP + 40_000_000, Pose(np.array([0.1, 0.2, 0.3]), QUARTER_TURN),
         [np.array([0.0, -3.0]), np.array([5.0, 6.0]), np.zeros(2)], [False, True],
         -normals(config)),
        (0, at, [np.ones(2)] * 3, [False, False], normals(config))]
    for sample in samples:
        found = same.message(*sample)
        assert found == arrows_of(config, *sample)
        assert {(marker.header.stamp.sec, marker.header.stamp.nanosec)
                for marker in found.markers} == {divmod(sample[0], 10 ** 9)}
        assert [marker.color.r > 0.9 for marker in found.markers[:2]] == sample[3]


def test_number_that_is_not_finite_is_not_drawn(config):
    with pytest.raises(MessageError):
        arrows_of(config, STAMP, Pose(np.zeros(3), np.eye(3)), [np.array([np.nan, 4.0])] * 3,
                  [True, True], normals(config))


@pytest.mark.parametrize(('rate', 'count'), [(25.0, 25), (0.0, 0), (1000.0, 500)])
def test_markers_are_due_at_their_rate(config, rate, count):
    markers = ContactMarkers(config, rate=rate, scale=0.01)
    assert sum(markers.due(tick) for tick in range(500)) == count
