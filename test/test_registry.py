"""A force law and a noise estimator of another package take a file and a line in a registry."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

PLUGIN = """
from multicontact_control.force.laws.design import LawDesign
from multicontact_control.force.laws.linear import ALPHA_DES, ALPHA_MEAS, U, make_zero_law
from multicontact_control.force.noise.base import NoiseEstimator


def design_gain(model, config):
    law = make_zero_law(0)
    law.D[U, [ALPHA_MEAS, ALPHA_DES]] = -1e-3, 1e-3
    return law


LAW = LawDesign(design_gain, reads=(), speed_exponents={})


class Doubled(NoiseEstimator):
    def _forget(self):
        self._variance[:] *= 2.0

    def _take(self, innovation):
        return True
"""
PROGRAM = """
import sys
from multicontact_control.registry import FORCE_LAWS, NOISE_ESTIMATORS

FORCE_LAWS['gain'] = 'plugin:LAW'
NOISE_ESTIMATORS['doubled'] = 'plugin:Doubled'

from multicontact_control.cli.application import app
from multicontact_control.study.config import read_study

assert 'doubled' in read_study('compare').parts['active state'].factors['estimator'].levels
app(sys.argv[1:])
"""


def run_with_plugin(folder, *arguments):
    """Return what the command line says in a process that registers the plug-in first."""
    (folder / 'plugin.py').write_text(PLUGIN)
    (folder / 'program.py').write_text(PROGRAM)
    return subprocess.run(
        [sys.executable, 'program.py', *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
    )


def test_registered_law_and_estimator_of_another_package_are_simulated(tmp_path):
    chosen = ('--law', 'gain', '--noise-estimator', 'doubled')
    result = run_with_plugin(
        tmp_path,
        *('simulate', '--scenario', 'quick', '--duration', '2', '--out', 'run'),
        *chosen,
    )
    assert result.returncode == 0, result.stderr
    for name, line in (
        ('controller', 'law: gain'),
        ('noise_estimator', 'estimator: doubled'),
    ):
        used = next((tmp_path / 'run').rglob(f'{name}.yaml')).read_text()
        assert line in used


def test_unknown_law_is_refused_with_the_registered_names(tmp_path):
    result = run_with_plugin(
        tmp_path, 'simulate', '--set', 'controller.contacts.table.law=lag'
    )
    assert result.returncode == 2
    assert (
        "contacts.table.law: expected 'aob', 'pi', 'dob', 'lqg', 'admittance', "
        "'impedance', 'feedforward', 'gain' or '', got 'lag'"
    ) in result.stderr
