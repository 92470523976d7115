"""The terms of the known arm, by formulas of their own, and a pinocchio that finds others."""

import subprocess
import sys
from xml.etree import ElementTree

from multicontact_control.dynamics import known_arm, robot
from multicontact_control.errors import PinocchioError
import numpy as np
from numpy.testing import assert_allclose
import pytest

STEP = 1e-30  # of complex numbers, by which a derivative is exact
X, Y, Z = np.eye(3)


def numbers(text):
    return np.array([float(number) for number in text.split()])


def cross_matrix(axis):
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def turn(axis, angle):
    """Return Rodrigues' rotation, also of a complex angle."""
    K = cross_matrix(axis)
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def read_origin(element):
    origin = element.find('origin')
    if origin is None:
        return np.zeros(3), np.eye(3)
    roll, pitch, yaw = numbers(origin.get('rpy', '0 0 0'))
    return numbers(origin.get('xyz')), turn(Z, yaw) @ turn(Y, pitch) @ turn(X, roll)


def read_inertia(element):
    six = {name: float(text) for name, text in element.find('inertia').items()}
    return np.array([[six['i' + ''.join(sorted(a + b))] for b in 'xyz'] for a in 'xyz'])


def place(q):
    """Return axes and origins of the joints, and bodies and the tip with their joint's number."""
    root = ElementTree.fromstring(known_arm.URDF)
    position, rotation = np.zeros(3), np.eye(3)
    axes, origins, bodies = [], [], []
    for joint in root.findall('joint'):
        way, turned = read_origin(joint)
        position = position + rotation @ way
        rotation = rotation @ turned
        if joint.get('type') == 'revolute':
            axis = numbers(joint.find('axis').get('xyz'))
            axes.append(rotation @ axis)
            origins.append(position)
            rotation = rotation @ turn(axis, q[len(axes) - 1])
        link = root.find(f'link[@name="{joint.find("child").get("link")}"]')
        inertial = link.find('inertial')
        if inertial is not None:
            com, com_rotation = read_origin(inertial)
            principal = rotation @ com_rotation
            mass = float(inertial.find('mass').get('value'))
            inertia = principal @ read_inertia(inertial) @ principal.T
            bodies.append((mass, inertia, position + rotation @ com, len(axes)))
    return axes, origins, bodies, position


def jacobian_at(point, carrier, axes, origins):
    J = np.zeros((6, len(axes)), dtype=complex)
    for joint in range(carrier):
        J[:3, joint] = np.cross(axes[joint], point - origins[joint])
        J[3:, joint] = axes[joint]
    return J


def mass_and_potential(q):
    axes, origins, bodies, _ = place(q)
    M = np.diag(known_arm.ARMATURE).astype(complex)
    potential = 0.0
    for mass, inertia, com, carrier in bodies:
        J = jacobian_at(com, carrier, axes, origins)
        M += mass * J[:3].T @ J[:3] + J[3:].T @ inertia @ J[3:]
        potential -= mass * np.dot(known_arm.GRAVITY, com)
    return M, potential


def tip_jacobian(q):
    axes, origins, _, tip = place(q)
    return jacobian_at(tip, len(axes), axes, origins)


def independent_terms():
    """Lagrange's equations with derivatives by complex steps, and Jacobians by hand."""
    q, v = known_arm.POSITIONS, known_arm.VELOCITIES
    M_rate = mass_and_potential(q + 1j * STEP * v)[0].imag / STEP
    bias = M_rate @ v
    for joint, direction in enumerate(np.eye(len(q))):
        M, potential = mass_and_potential(q + 1j * STEP * direction)
        bias[joint] += (potential - v @ M @ v / 2.0).imag / STEP
    return {
        'M': np.triu(mass_and_potential(q)[0].real),
        'C v + g': bias,
        'J': tip_jacobian(q).real,
        'dJ/dt': tip_jacobian(q + 1j * STEP * v).imag / STEP,
    }


def test_known_terms_are_those_of_lagranges_equations():
    terms = independent_terms()
    assert terms.keys() == known_arm.TERMS.keys()
    for name, value in terms.items():
        assert_allclose(
            known_arm.TERMS[name], value, rtol=0.0, atol=1e-11, err_msg=name
        )
        assert np.abs(value).max() > 0.1


@pytest.mark.parametrize('name', known_arm.TERMS)
@pytest.mark.parametrize('wrong', [1e-6, np.nan])
def test_a_term_that_differs_is_named(name, wrong):
    found = {key: value.copy() for key, value in known_arm.TERMS.items()}
    assert known_arm.list_differences(found) == []
    found[name].flat[-1] += wrong
    (difference,) = known_arm.list_differences(found)
    assert difference.startswith(name)


@pytest.fixture
def anew():
    """Let the terms be compared again, as in a new process."""
    robot.require_known_terms.cache_clear()
    yield
    robot.require_known_terms.cache_clear()


def test_pinocchio_without_armature_or_with_another_drift_is_refused(anew, monkeypatch):
    """As pinocchio 2.7: no armature in M, and J_ang x dp/dt missing in dJ/dt of a frame."""
    compute = robot.pin.computeAllTerms
    compute_rate = robot.pin.getFrameJacobianTimeVariation

    def compute_without_armature(model, data, q, v):
        model.armature = np.zeros(model.nv)
        compute(model, data, q, v)

    def compute_rate_of_a_still_point(model, data, frame, axes):
        rate = compute_rate(model, data, frame, axes)
        J = robot.pin.getFrameJacobian(model, data, frame, axes)
        rate[:3] -= np.cross(J[3:].T, J[:3] @ known_arm.VELOCITIES).T
        return rate

    robot.load_model(known_arm.URDF)
    robot.require_known_terms.cache_clear()
    with monkeypatch.context() as patch:
        patch.setattr(robot.pin, 'computeAllTerms', compute_without_armature)
        with pytest.raises(PinocchioError, match=r'got version .*: M\[') as refusal:
            robot.load_model(known_arm.URDF)
        assert 'dJ/dt' not in str(refusal.value)
    with monkeypatch.context() as patch:
        patch.setattr(
            robot.pin, 'getFrameJacobianTimeVariation', compute_rate_of_a_still_point
        )
        with pytest.raises(PinocchioError, match=r'got version .*: dJ/dt\['):
            robot.load_model(known_arm.URDF)
    robot.load_model(known_arm.URDF)


@pytest.mark.parametrize(
    'command',
    ['-m multicontact_control.cli simulate', '-c "import sim_bridge.kinematics"'],
)
def test_missing_pinocchio_ends_with_how_to_install_it(tmp_path, command):
    (tmp_path / 'pinocchio.py').write_text("raise ImportError('built for numpy 1')\n")
    done = subprocess.run(
        f'PYTHONPATH="{tmp_path}:$PYTHONPATH" {sys.executable} {command}',
        shell=True,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert 'built for numpy 1' in line and "pip install 'pin" in line
