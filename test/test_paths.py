"""Where the configuration files are found."""

from pathlib import Path
import sys

from multicontact_control.errors import ConfigError
from multicontact_control.paths import config_dir, find_config_dir
import pytest

SHARE = Path('share', 'multicontact_control', 'config')


@pytest.fixture
def bare(monkeypatch, tmp_path):
    """Hide the environment the tests run in."""
    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'environment'))
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    return tmp_path


def make(path: Path) -> Path:
    path.mkdir(parents=True)
    return path


def test_config_dir_holds_the_scenarios():
    assert (config_dir() / 'scenarios').is_dir()


def test_config_dir_prefers_the_checkout(bare):
    checkout = make(bare / 'checkout' / 'config')
    make(bare / 'environment' / SHARE)
    (bare / 'checkout' / 'package.xml').touch()
    assert find_config_dir(bare / 'checkout' / 'multicontact_control') == checkout


def test_config_dir_ignores_a_config_folder_that_is_not_of_a_checkout(bare):
    make(bare / 'site-packages' / 'config')
    installed = make(bare / 'environment' / SHARE)
    assert find_config_dir(bare / 'site-packages' / 'multicontact_control') == installed


def test_config_dir_finds_the_prefix_it_is_installed_in(bare):
    installed = make(bare / 'prefix' / SHARE)
    package_dir = bare / 'prefix/lib/python3.11/site-packages/multicontact_control'
    assert find_config_dir(package_dir) == installed


def test_config_dir_finds_an_ament_prefix(bare, monkeypatch):
    installed = make(bare / 'workspace' / SHARE)
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{bare}/nothing:{bare}/workspace')
    assert find_config_dir(bare / 'elsewhere') == installed


def test_config_dir_names_where_it_looked(bare, monkeypatch):
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{bare}/workspace')
    with pytest.raises(ConfigError, match=f'{bare}/environment/share.*{bare}/workspace/share'):
        find_config_dir(bare / 'elsewhere')
