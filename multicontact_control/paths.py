"""Where the files that come with the package are: in a checkout or where it is installed."""

from __future__ import annotations

import os
from pathlib import Path
import sys

from multicontact_control.errors import ConfigError

PACKAGE_DIR = Path(__file__).resolve().parent


def find_config_folder(package_dir: Path = PACKAGE_DIR) -> Path:
    """
    Return the folder of the configuration files; ConfigError if none exists.

    In a checkout it is ``config/``, so that edited files take effect. An installed package has it
    in the share folder of its prefix, of the environment, or of an ament workspace.
    """
    if (package_dir.parent / 'package.xml').is_file():
        return package_dir.parent / 'config'
    # <prefix>/lib/pythonX.Y/site-packages/multicontact_control
    prefixes = [
        *map(str, package_dir.parents[3:4]),
        sys.prefix,
        *os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep),
    ]
    folders = [
        Path(prefix, 'share/multicontact_control/config')
        for prefix in prefixes
        if prefix
    ]
    if folder := next(filter(Path.is_dir, folders), None):
        return folder
    raise ConfigError(
        'config',
        'the configuration folder of the package',
        f'none of {", ".join(map(str, folders))}',
    )


def find_named_file(kind: str, folder: str, name: str) -> Path:
    """Return a YAML file in a folder of ``config/`` by its name, or any file by its path."""
    there = find_config_folder() / folder
    for path in (there / f'{name}.yaml', Path(name)):
        if path.is_file():
            return path
    known = ', '.join(
        sorted(
            file.relative_to(there).with_suffix('').as_posix()
            for file in there.rglob('*.yaml')
        )
    )
    raise ConfigError(kind, f'one of {known}, or a path', f"'{name}'")
