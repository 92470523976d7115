"""Where the configuration files are found."""

from pathlib import Path
import sys

from multicontact_control.errors import ConfigError
from multicontact_control.paths import config_dir
import pytest

SHARE = Path('share', 'multicontact_control', 'config')


@pytest.fixture
def bare(monkeypatch, tmp_path):
    """Hide the environment the tests run in."""
    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'environment'))
    monkeypatch.delenv('AMENT_PREFIX_PATH', raising=False)
    return tmp_path


def test_config_dir_prefers_the_checkout(bare):
    for folder in ('checkout/config', Path('environment') / SHARE, 'site-packages/config'):
        (bare / folder).mkdir(parents=True)
    (bare / 'checkout/package.xml').touch()
    assert config_dir(bare / 'checkout/multicontact_control') == bare / 'checkout/config'
    # A folder of that name beside an installed package is no checkout's.
    assert config_dir(bare / 'site-packages/multicontact_control') == (
        bare / 'environment' / SHARE)
    assert (config_dir() / 'scenarios').is_dir()


def test_config_dir_is_in_the_prefix_or_in_an_ament_prefix(bare, monkeypatch):
    package = bare / 'prefix/lib/python3.11/site-packages/multicontact_control'
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{bare}/nothing:{bare}/workspace')
    with pytest.raises(ConfigError, match=f'{bare}/environment/share.*{bare}/workspace/share'):
        config_dir(package)
    for prefix in ('workspace', 'prefix'):
        (bare / prefix / SHARE).mkdir(parents=True)
        assert config_dir(package) == bare / prefix / SHARE
