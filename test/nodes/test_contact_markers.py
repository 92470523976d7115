"""Contact forces as arrows."""

from arms import controller_config
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import MessageError
from multicontact_control.nodes.controller_topics import build_contact_arrows
from multicontact_control.supervision.report import make_empty_answer
import numpy as np
import pytest
from visualization_msgs.msg import Marker

STAMP = 1_795_000_000_000_000_000
POSE = Pose(np.array([0.5, 0.1, 0.7]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
FORCES = np.array([10.0, 0.1])  # N
NORMALS = np.array([[0.0, 0.6, -0.8], [0.6, 0.8, 0.0]])  # not those of the file
CONFIG = controller_config()


def arrows_of(forces, active):
    nothing = make_empty_answer(6, len(NORMALS))
    contacts, controls = nothing.contacts.copy(), nothing.controls.copy()
    contacts['alpha_meas'], contacts['answer']['active'] = forces, active
    contacts['normal'] = NORMALS
    controls['frame']['position'], controls['frame']['rotation'] = POSE
    output = nothing._replace(memory=controls.tobytes() + contacts.tobytes())
    return build_contact_arrows(CONFIG, STAMP, output).markers


def test_arrows_are_as_long_as_the_measured_forces_and_end_at_the_tips():
    arrows = arrows_of(FORCES, [True, False])
    assert [arrow.action for arrow in arrows] == [Marker.ADD, Marker.DELETE]
    assert len({arrow.id for arrow in arrows}) == 2
    assert (
        arrows[0].color != arrows[1].color
    )  # of an active contact, and of one that is not
    for arrow, name, force, normal in zip(
        arrows, CONFIG.contact_names, FORCES, NORMALS
    ):
        tail, tip = (np.array([point.x, point.y, point.z]) for point in arrow.points)
        np.testing.assert_allclose(tip - tail, 0.01 * force * normal, atol=1e-12)
        np.testing.assert_allclose(
            tip,
            POSE.position_world
            + POSE.rotation_world @ (CONFIG.contacts[name].point_operational),
        )
        assert (arrow.header.frame_id, arrow.header.stamp.sec) == (
            'world',
            STAMP // 10**9,
        )


def test_number_that_is_not_finite_is_not_drawn():
    with pytest.raises(MessageError):
        arrows_of(np.nan * FORCES, [True, True])
