"""What is wrong with an arm's URDF is refused or named, or does no harm."""

from xml.etree import ElementTree

from arms import controller_config, seven_joint_config, seven_joint_urdf
from multicontact_control.dynamics.robot import load_model, RobotModel
from multicontact_control.errors import ConfigError
from multicontact_control.loop import ControlLoop
from multicontact_control.paths import config_dir
from multicontact_control.supervision.command_limits import CommandLimits
import numpy as np
import pytest

MASS, INERTIA, COM = 'inertial/mass', 'inertial/inertia', 'inertial/origin'
MOMENTS = ('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz')


def scale(path, *names):
    """Return what multiplies all numbers of some attributes."""
    def apply(element, factor):
        for name in names:
            numbers = [factor * float(number) for number in element.find(path).get(name).split()]
            element.find(path).set(name, ' '.join(map(str, numbers)))
    return apply


def without(path):
    """Return what removes an element, or one of its attributes."""
    def apply(element, _):
        parent, _, name = path.rpartition('/')
        inside = element.find(parent) if parent else element
        if name in inside.attrib:
            del inside.attrib[name]
        else:
            inside.remove(inside.find(name))
    return apply


# What is done to a link or joint, and the factors that are tried.
OF_LINKS = [(scale(MASS, 'value'), (0.0, -1.0, 1e3)),
            (scale(INERTIA, *MOMENTS), (-1.0, 3.0, 10.0, 40.0, 1e3, 1e6, 1e9)),
            (scale(INERTIA, 'izz'), (-1.0, 30.0, 1e3)),
            (scale(COM, 'xyz'), (1e3,)), (without('inertial'), (0.0,))]
OF_JOINTS = [(scale('axis', 'xyz'), (0.0, 0.5, 2.0)),
             (scale('limit', 'lower', 'upper'), (0.0, -1.0, 180.0 / np.pi)),
             (scale('limit', 'effort'), (0.0, 0.01, 0.1)),
             (without('limit/effort'), (0.0,)), (without('limit/upper'), (0.0,)),
             (without('limit'), (0.0,))]


def make_seven(folder):
    """Return an arm of seven joints: its URDF and the configuration of its loop."""
    urdf = seven_joint_urdf(folder)
    return urdf, controller_config().model_copy(update={'robot': seven_joint_config(urdf)})


def make_puma(folder):
    """Return the PUMA likewise."""
    urdf = folder / 'puma.urdf'
    urdf.write_text((config_dir() / 'puma560.urdf').read_text())
    return urdf, controller_config(robot={'urdf': urdf.name})


def complaints(config, folder):
    """Return what the check of the model says, a line each, refused or not."""
    try:
        return list(RobotModel(config.robot, folder).warnings())
    except ConfigError as error:
        return [str(each) for each in error.errors]


def damaged(urdf, whole, random):
    """Write a URDF with one link or joint spoiled; return the names of the link and joint."""
    root = ElementTree.fromstring(whole)
    joints = [joint for joint in root.findall('joint') if joint.get('type') == 'revolute']
    joint = joints[random.integers(len(joints))]
    child = joint.find('child').get('link')
    link = next(link for link in root.findall('link') if link.get('name') == child)
    element, kinds = ((link, OF_LINKS), (joint, OF_JOINTS))[random.integers(2)]
    spoil, factors = kinds[random.integers(len(kinds))]
    spoil(element, random.choice(factors))
    urdf.write_text(ElementTree.tostring(root, encoding='unicode'))
    return child, joint.get('name')


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
    postures = random.uniform(-1.5, 1.5, (10, true.joint_count))
    harmless = 0
    for _ in range(80):
        names = damaged(urdf, whole, random)
        lines = complaints(config, tmp_path)
        if any(name in line for line in lines for name in names):
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


@pytest.mark.parametrize(('spoil', 'factor', 'words'), [
    (scale(MASS, 'value'), 1e3, ('masses in g',)),
    (scale(COM, 'xyz'), 1e3, ('l0', 'l3', 'l6', 'mm?')),
    (scale(INERTIA, *MOMENTS), 1e9, ('l0', 'l3', 'l6', 'g mm^2')),
    (without('inertial'), 0.0, ('l0', 'l3', 'l6', 'mass'))])
def test_loop_refuses_an_impossible_arm_and_names_all_links(tmp_path, spoil, factor, words):
    urdf, config = make_seven(tmp_path)
    root = ElementTree.fromstring(urdf.read_text())
    for link in root.findall('link'):
        if link.find('inertial') is not None:
            spoil(link, factor)
    urdf.write_text(ElementTree.tostring(root, encoding='unicode'))
    with pytest.raises(ConfigError) as caught:
        ControlLoop(config, None, CommandLimits(), tmp_path)
    assert all(word in str(caught.value) for word in words)


def test_model_warns_of_limits_in_degrees_and_of_a_missing_torque(tmp_path):
    urdf, config = make_seven(tmp_path)
    root = ElementTree.fromstring(urdf.read_text())
    joints = root.findall('joint')
    scale('limit', 'lower', 'upper')(joints[2], 180.0 / np.pi)
    without('limit/effort')(joints[4], 0.0)
    urdf.write_text(ElementTree.tostring(root, encoding='unicode'))
    degrees, torque = RobotModel(config.robot, tmp_path).warnings()
    assert 'j2' in degrees and 'degrees?' in degrees and 'j4.effort' in torque
    assert RobotModel(config.robot, tmp_path).warnings([100.0] * 7) == (degrees,)


def test_model_needs_no_mass_between_crossing_axes(tmp_path):
    """But a link between two places does, and so does the last one."""
    root = ElementTree.fromstring(seven_joint_urdf(tmp_path).read_text())
    link, joint = root.findall('link')[4], root.findall('joint')[4]
    without('inertial')(link, 0.0)
    with pytest.raises(ConfigError, match='l3.mass'):
        load_model(ElementTree.tostring(root, encoding='unicode'))
    joint.find('origin').set('xyz', '0 0 0')
    load_model(ElementTree.tostring(root, encoding='unicode'))
