"""Force laws and noise estimators of others are known by name, in this process or in all."""

import json
import os
import re
import subprocess
import sys

from multicontact_control.errors import ConfigError
from multicontact_control.force.laws.design import find_law
from multicontact_control.force.noise import find_noise_estimator
from multicontact_control.registry import (
    FORCE_LAWS,
    NOISE_ESTIMATORS,
    register_force_law,
    register_noise_estimator,
)
from multicontact_control.runs.scenario import resolve
from multicontact_control.study.jobs import outcome_key
import pytest
from ros_graph import PATIENCE, ROOT

MODULE = """
from multicontact_control.force.laws.design import LawDesign
from multicontact_control.force.laws.linear import ALPHA_DES, ALPHA_MEAS, U, make_zero_law
from multicontact_control.force.noise import NoiseEstimator


def design_gain(model, config):
    law = make_zero_law(0)
    law.D[U, [ALPHA_MEAS, ALPHA_DES]] = -1e-3, 1e-3
    return law


LAW = LawDesign(design_gain, reads=(), speed_exponents={})
GREEDY = LawDesign(design_gain, reads=('my_gain',), speed_exponents={})


class Doubled(NoiseEstimator):
    def _forget(self):
        self._variance[:] *= 2.0

    def _take(self, innovation):
        return True
"""
ENTRY_POINTS = """
[multicontact_control.force_laws]
aob = my_laws:LAW
gain = my_laws:LAW
gone = my_laws.gone:LAW

[multicontact_control.noise_estimators]
doubled = my_laws:Doubled
gone = my_laws:Gone

[multicontact_control.config]
mine = my_files
nowhere = no_such_package
"""
CHOSEN = ('--law', 'gain', '--noise-estimator', 'doubled')
SHORT = ('--scenario', 'brief', '--robot', 'twin')


@pytest.fixture
def my_laws(tmp_path, monkeypatch, registries):
    """Return the file of a module of a user's, which this process can import."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, 'my_laws', raising=False)
    path = tmp_path / 'my_laws.py'
    path.write_text(MODULE)
    return path


@pytest.fixture(scope='module')
def installed(tmp_path_factory):
    """Return what calls `multicontact` where a package with that module is installed."""
    folder = tmp_path_factory.mktemp('installed')
    (folder / 'my_laws.py').write_text(MODULE)
    for kind, like, name in (
        ('robots', 'puma', 'twin'),
        ('scenarios', 'quick', 'brief'),
    ):
        text = (ROOT / f'config/{kind}/{like}.yaml').read_text(encoding='utf-8')
        file = folder / f'my_files/config/{kind}/{name}.yaml'
        file.parent.mkdir(parents=True)
        text = text.replace('urdf: ', f'urdf: {ROOT}/config/robots/')
        file.write_text(re.sub('duration: .*', 'duration: 2.0', text))
    described = folder / 'my_laws-1.0.dist-info'
    described.mkdir()
    (described / 'METADATA').write_text('Name: my-laws\nVersion: 1.0\n')
    (described / 'entry_points.txt').write_text(ENTRY_POINTS)
    path = os.pathsep.join(map(str, (folder, ROOT)))

    def call(*arguments):
        return subprocess.run(
            [sys.executable, '-m', 'multicontact_control.cli', *map(str, arguments)],
            cwd=folder,
            env={**os.environ, 'PYTHONPATH': path, 'COLUMNS': '200'},
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )

    return call


@pytest.mark.ros
@pytest.mark.slow
def test_law_and_estimator_of_an_installed_package_are_those_of_the_nodes(
    installed, tmp_path
):
    """Controller and estimator are other processes: their torques are those of this one."""
    hashes = []
    for command in (('simulate',), ('run', '--speed', '0')):
        out = tmp_path / command[0]
        done = installed(*command, *SHORT, *CHOSEN, '--out', out)
        assert done.returncode == 0, done.stderr
        hashes.append(
            json.loads((out / 'summary.json').read_text())['trajectory_sha256']
        )
        assert 'law: gain' in (out / 'config/controller.yaml').read_text()
        estimator = (out / 'config/noise_estimator.yaml').read_text()
        assert 'estimator: doubled' in estimator
    usual = tmp_path / 'usual'
    assert installed('simulate', *SHORT, '--out', usual).returncode == 0
    assert 'robot: twin' in (usual / 'config/plant.yaml').read_text()
    hashes.append(json.loads((usual / 'summary.json').read_text())['trajectory_sha256'])
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.slow
def test_installed_names_are_choices_and_one_that_is_taken_is_left_out(installed):
    done = installed('simulate', '--help')
    for names in (
        [*FORCE_LAWS, 'gain', 'gone'],
        [*NOISE_ESTIMATORS, 'doubled', 'gone'],
    ):
        assert '|'.join(names) in done.stdout.replace('\n', '')
    for name in ('twin', 'brief'):
        assert re.search(f'^ *{name} ', done.stdout, re.MULTILINE)
    assert done.stderr.splitlines() == [
        'force law aob: expected a name that is not taken, got my_laws:LAW beside '
        f'{FORCE_LAWS["aob"]}, which has it; it is left out',
        'configuration folder nowhere: expected a package of the top level, got '
        'no_such_package; it is left out',
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ('choice', 'message'),
    [
        (
            ('--law', 'gone'),
            'force law gone: expected a module and an object that can be imported, got '
            "my_laws.gone:LAW: ModuleNotFoundError: No module named 'my_laws.gone'; "
            "'my_laws' is not a package",
        ),
        (
            ('--noise-estimator', 'gone'),
            'noise estimator gone: expected a module and an object that can be imported, got '
            "my_laws:Gone: AttributeError: module 'my_laws' has no attribute 'Gone'",
        ),
        (
            ('--set', 'controller.contacts.table.law=lag'),
            'controller.yaml: contacts.table.law: expected '
            f"{', '.join(map(repr, FORCE_LAWS))}, 'gain', 'gone' or '', got 'lag'",
        ),
    ],
)
def test_what_cannot_be_imported_or_is_unknown_is_refused_in_one_line(
    installed, tmp_path, choice, message
):
    done = installed('simulate', *SHORT, *choice, '--out', tmp_path / 'run')
    assert done.returncode == 2
    assert done.stderr.splitlines()[2:] == [f'multicontact: {message}']
    assert list(tmp_path.iterdir()) == []


def test_name_that_is_taken_is_refused_and_keeps_what_it_stands_for(registries):
    for register, registry, name in (
        (register_force_law, FORCE_LAWS, 'aob'),
        (register_noise_estimator, NOISE_ESTIMATORS, 'fixed'),
    ):
        place = registry[name]
        register(name, place)  # as a cell of a notebook that is run again
        with pytest.raises(
            ConfigError, match=f'{name}: expected a name that is not taken'
        ):
            register(name, 'my_laws:OTHER')
        assert registry[name] == place


def test_name_counts_from_when_it_is_registered_on(my_laws):
    with pytest.raises(ConfigError, match="force.law: expected 'aob', .* got 'gain'"):
        resolve('quick', controller={'force': {'law': 'gain'}})
    register_force_law('gain', 'my_laws:LAW')
    setup = resolve('quick', controller={'force': {'law': 'gain'}})
    assert setup.controller.force.law == 'gain'
    assert find_law('gain').reads == ()


@pytest.mark.parametrize(
    ('register', 'find', 'place', 'message'),
    [
        (register_force_law, find_law, 'my_laws:design_gain', 'a LawDesign at my_laws'),
        (register_force_law, find_law, 'my_laws:GREEDY', r'reads: .* got my_gain'),
        (
            register_noise_estimator,
            find_noise_estimator,
            'my_laws:LAW',
            'a NoiseEstimator at my_laws:LAW',
        ),
    ],
)
def test_object_of_another_kind_is_refused(my_laws, register, find, place, message):
    register('mine', place)
    with pytest.raises(ConfigError, match=message):
        find('mine')


def test_finished_run_is_another_once_the_file_of_its_law_has_changed(my_laws):
    register_force_law('gain', 'my_laws:LAW')
    setup = resolve('quick', controller={'force': {'law': 'gain'}})
    usual = resolve('quick', controller={'force': {'law': 'pi'}})
    keys = [outcome_key('run', each) for each in (setup, usual)]
    my_laws.write_text(MODULE.replace('1e-3', '2e-3'))
    assert outcome_key('run', setup) != keys[0]
    assert outcome_key('run', usual) == keys[1]
