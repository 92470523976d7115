"""Where the configuration files are found, and how files are written."""

import json
from pathlib import Path
import sys

from multicontact_control.errors import ConfigError
from multicontact_control.files import replace_json_file
from multicontact_control.paths import find_config_folder
import pytest

SHARE = Path('share', 'multicontact_control', 'config')


def test_config_dir_is_the_checkouts_or_in_a_prefix_or_in_an_ament_prefix(
    monkeypatch, tmp_path
):
    monkeypatch.setattr(sys, 'prefix', str(tmp_path / 'environment'))
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path}/nothing:{tmp_path}/workspace')
    (tmp_path / 'checkout/config').mkdir(parents=True)
    (tmp_path / 'checkout/package.xml').touch()
    assert (
        find_config_folder(tmp_path / 'checkout/multicontact_control')
        == tmp_path / 'checkout/config'
    )
    package = tmp_path / 'prefix/lib/python3.11/site-packages/multicontact_control'
    # A folder of that name beside an installed package is no checkout's.
    (package.parent / 'config').mkdir(parents=True)
    with pytest.raises(ConfigError, match='/environment/share.*/workspace/share'):
        find_config_folder(package)
    for prefix in ('workspace', 'environment', 'prefix'):
        (tmp_path / prefix / SHARE).mkdir(parents=True)
        assert find_config_folder(package) == tmp_path / prefix / SHARE
    assert (find_config_folder() / 'scenarios').is_dir()


def test_file_is_replaced_at_once_or_not_at_all(tmp_path):
    path = tmp_path / 'a.txt'
    replace_json_file(path, {'x': [1.5, None]})
    with pytest.raises(ValueError):
        replace_json_file(path, {'x': float('nan')})
    assert json.loads(path.read_text()) == {'x': [1.5, None]}
    assert list(tmp_path.iterdir()) == [path]
