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
    """Return the arrows of the table and the board."""
    nothing = make_empty_answer(6, len(NORMALS))
    contacts = nothing.contacts.copy()
    contacts['alpha_meas'] = forces
    contacts['answer']['active'] = active
    contacts['normal'] = NORMALS
    controls = nothing.controls.copy()
    controls['frame']['position'] = POSE.position_world
    controls['frame']['rotation'] = POSE.rotation_world
    output = nothing._replace(memory=controls.tobytes() + contacts.tobytes())
    return build_contact_arrows(CONFIG, STAMP, output).markers


def coordinates(point):
    return np.array([point.x, point.y, point.z])


def test_arrows_are_as_long_as_the_measured_forces_and_end_at_the_tips():
    arrows = arrows_of(FORCES, [True, True])
    for arrow, name, force, normal in zip(
        arrows, CONFIG.contact_names, FORCES, NORMALS
    ):
        tail, tip = map(coordinates, arrow.points)
        point = CONFIG.contacts[name].point_operational
        expected = POSE.position_world + POSE.rotation_world @ point
        np.testing.assert_allclose(tip, expected)
        np.testing.assert_allclose(tip - tail, 0.01 * force * normal, atol=1e-12)
        assert arrow.header.frame_id == 'world'
        assert arrow.header.stamp.sec == STAMP // 10**9


def test_arrow_of_a_contact_without_a_force_is_taken_away():
    pressed, light = arrows_of(FORCES, [True, False])
    assert (pressed.action, light.action) == (Marker.ADD, Marker.DELETE)
    assert pressed.id != light.id
    assert pressed.color != light.color  # active, and not


def test_number_that_is_not_finite_is_not_drawn():
    with pytest.raises(MessageError):
        arrows_of(np.nan * FORCES, [True, True])
