"""What is wrong with an arm's URDF is refused or named, or does no harm."""

from itertools import product
from xml.etree import ElementTree

from arms import controller_config, seven_joint_config, seven_joint_urdf
from multicontact_control.dynamics.robot import load_model, RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.loop import ControlLoop
from multicontact_control.paths import config_dir
from multicontact_control.supervision.command_limits import CommandLimits
import numpy as np
import pytest

MOMENTS = ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')
MASS, INERTIA = ('inertial/mass', 'value'), ('inertial/inertia', *MOMENTS)
COM, STOPS = ('inertial/origin', 'xyz'), ('limit', 'lower', 'upper')


def spoil(element, path, *names, factor=None):
    """Multiply all numbers of some attributes, or remove them, or the element without names."""
    if not names:
        element.remove(element.find(path))
    for name in names:
        attributes = element.find(path).attrib
        numbers = [float(number) for number in attributes.pop(name).split()]
        if factor is not None:
            attributes[name] = ' '.join(str(factor * number) for number in numbers)


# Of a link, and of a joint; the factor removes what it is None for.
LINK_FAULTS = [(MASS, 0.0), (MASS, -1.0), (MASS, 1e3), (INERTIA, -1.0), (INERTIA, 3.0),
               (INERTIA, 1e3), (INERTIA, 1e9), (INERTIA[::3], -1.0),
               (INERTIA[::3], 30.0), (COM, 1e3), (('inertial',), None)]
JOINT_FAULTS = [(('axis', 'xyz'), 0.0), (('axis', 'xyz'), 2.0), (STOPS, 0.0), (STOPS, -1.0),
                (STOPS, 180.0 / np.pi), (('limit', 'effort'), 0.01), (('limit', 'effort'), None),
                (('limit', 'upper'), None), (('limit',), None)]


def complaints(config, folder):
    """Return what the check of the model says, a line each, refused or not."""
    try:
        return list(RobotModel(config.robot, folder).warnings())
    except ConfigError as error:
        return [str(each) for each in error.errors]


def make_seven(folder):
    """Return an arm of seven joints: its URDF and the configuration of its loop."""
    urdf = seven_joint_urdf(folder)
    return urdf, controller_config().model_copy(update={'robot': seven_joint_config(urdf)})


def make_puma(folder):
    """Return the PUMA likewise."""
    urdf = folder / 'puma.urdf'
    urdf.write_text((config_dir() / 'puma560.urdf').read_text())
    return urdf, controller_config(robot={'urdf': urdf.name})


@pytest.mark.parametrize('make', [make_seven, make_puma])
def test_model_check_names_each_damage_or_it_does_no_harm(tmp_path, make):
    """
    No harm: the torque that carries the true arm is right to 3 % of the limits.

    And no direction has an inertia that is wrong by more than a factor of 2.
    """
    urdf, config = make(tmp_path)
    whole, random = urdf.read_text(), np.random.default_rng(7)
    true = RobotModel(config.robot, tmp_path)
    assert true.warnings() == ()
    zero, limit = np.zeros(true.joint_count), true.torque_limit
    postures, harmless = random.uniform(-1.5, 1.5, (10, true.joint_count)), 0
    for which, (kind, path, factor) in product(range(true.joint_count), [
            *(('link', *x) for x in LINK_FAULTS), *(('joint', *x) for x in JOINT_FAULTS)]):
        root = ElementTree.fromstring(whole)
        joint = [x for x in root.findall('joint') if x.get('type') == 'revolute'][which]
        child = joint.find('child').get('link')
        link, = (x for x in root.findall('link') if x.get('name') == child)
        spoil(link if kind == 'link' else joint, *path, factor=factor)
        urdf.write_text(ElementTree.tostring(root, encoding='unicode'))
        lines = complaints(config, tmp_path)
        if any(name in line for line in lines for name in (child, joint.get('name'))):
            continue
        harmless += 1
        model = RobotModel(config.robot, tmp_path)
        for q in postures:
            right, wrong = true.update(q, zero), model.update(q, zero)
            assert (np.abs(wrong.gravity - right.gravity) < 0.03 * limit).all()
            shares = np.linalg.eigvals(np.linalg.solve(right.mass_matrix, wrong.mass_matrix)).real
            assert 0.5 < shares.min() and shares.max() < 2.0
            assert (np.abs(right.gravity) <= model.torque_limit).all()
    assert harmless < 24


@pytest.mark.parametrize(('fault', 'factor', 'words'), [
    (MASS, 1e3, ('masses in g',)), (COM, 1e3, ('l0', 'l3', 'l6', 'mm?')),
    (INERTIA, 1e9, ('l0', 'l3', 'l6', 'g mm^2')), (('inertial',), None, ('l0', 'l3', 'l6'))])
def test_loop_refuses_an_impossible_arm_and_names_all_links(tmp_path, fault, factor, words):
    urdf, config = make_seven(tmp_path)
    root = ElementTree.fromstring(urdf.read_text())
    for link in root.findall('link'):
        if link.find('inertial') is not None:
            spoil(link, *fault, factor=factor)
    urdf.write_text(ElementTree.tostring(root, encoding='unicode'))
    with pytest.raises(ConfigError) as caught:
        ControlLoop(config, None, CommandLimits(), tmp_path)
    assert all(word in str(caught.value) for word in words)


def test_model_warns_of_limits_in_degrees_and_of_a_missing_torque(tmp_path):
    urdf, config = make_seven(tmp_path)
    root = ElementTree.fromstring(urdf.read_text())
    joints = root.findall('joint')
    spoil(joints[2], *STOPS, factor=180.0 / np.pi)
    spoil(joints[4], 'limit', 'effort')
    urdf.write_text(ElementTree.tostring(root, encoding='unicode'))
    degrees, torque = RobotModel(config.robot, tmp_path).warnings()
    assert 'j2' in degrees and 'degrees?' in degrees and 'j4.effort' in torque
    assert RobotModel(config.robot, tmp_path).warnings([100.0] * 7) == (degrees,)


def test_model_needs_no_mass_between_crossing_axes(tmp_path):
    root = ElementTree.fromstring(seven_joint_urdf(tmp_path).read_text())
    link, joint = root.findall('link')[4], root.findall('joint')[4]
    spoil(link, 'inertial')
    with pytest.raises(ConfigError, match='l3.mass'):
        load_model(ElementTree.tostring(root, encoding='unicode'))
    joint.find('origin').set('xyz', '0 0 0')
    load_model(ElementTree.tostring(root, encoding='unicode'))
