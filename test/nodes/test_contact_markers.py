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
POSE = Pose(np.array([0.5, 0.1, 0.7]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
FORCES = np.array([[10.0, 4.0], [9.0, 5.0], [8.0, -3.0]])  # measured, estimated, desired [N]
NORMALS = np.array([[0.0, 0.6, -0.8], [0.6, 0.8, 0.0]])  # not those of the file
CONFIG = controller_config()


def arrows_of(forces, active, markers, stamp=STAMP):
    output = no_answer(6, len(NORMALS))
    contacts, answer, pose = output.contacts, output.answer, output.pose
    contacts['alpha_meas'], answer['alpha_est'], answer['alpha_des'] = forces
    answer['active'], contacts['normal'] = active, NORMALS
    pose.position_world[:], pose.rotation_world[:] = POSE
    return markers.message(stamp, output).markers


def ends(marker):
    return (np.array([point.x, point.y, point.z]) for point in marker.points)


def test_arrows_are_as_long_as_their_forces_and_the_measured_end_at_the_tips():
    markers = ContactMarkers(CONFIG)
    arrows_of(np.ones((3, 2)), [False, True], markers, 0)  # of which nothing is left
    arrows = arrows_of(FORCES, [True, False], markers)
    assert len({(marker.ns, marker.id) for marker in arrows}) == len(arrows) == 6
    assert len({str(marker.color) for marker in arrows[::2]}) == 3
    assert arrows[0].color != arrows[1].color  # of an active contact, and of one that is not
    assert arrows[5].action == Marker.DELETE
    for k, name in enumerate(CONFIG.contact_names):
        for marker, force in zip(arrows[k::2], FORCES[:, k]):
            tail, tip = ends(marker)
            np.testing.assert_allclose(tip - tail, 0.01 * force * NORMALS[k], atol=1e-12)
            assert (marker.header.frame_id, marker.header.stamp.sec) == (
                'world', STAMP // 10 ** 9)
        _, tip = ends(arrows[k])
        np.testing.assert_allclose(tip, POSE.position_world + POSE.rotation_world @ (
            CONFIG.contacts[name].point_operational))
    assert sum(markers.due(tick) for tick in range(500)) == 25  # a second


def test_number_that_is_not_finite_is_not_drawn():
    with pytest.raises(MessageError):
        arrows_of(np.nan * FORCES, [True, True], ContactMarkers(CONFIG))
