"""Where the files that come with the package are: in a checkout or where it is installed."""

from __future__ import annotations

from functools import cache
import os
from pathlib import Path
import sys

from multicontact_control.errors import ConfigError

PACKAGE = 'multicontact_control'


def config_dir() -> Path:
    """
    Return the folder of the configuration files that come with the package.

    Raises
    ------
    ConfigError
        Naming the folders looked in, if none of them exists.

    """
    return _config_dir(sys.prefix, os.environ.get('AMENT_PREFIX_PATH', ''))


@cache
def _config_dir(*_searched: str) -> Path:
    # A study asks for it a dozen times for each of its jobs.
    return find_config_dir(Path(__file__).resolve().parent)


def find_config_dir(package_dir: Path) -> Path:
    """
    Return the configuration folder that belongs to the package in `package_dir`.

    A checkout goes first, since what is edited there is what should run. An installed package
    has it in the share folder of its prefix, of the environment, or of an ament workspace.

    Raises
    ------
    ConfigError
        Naming the folders looked in, if none of them exists.

    """
    root = package_dir.parent
    candidates = [root / 'config'] if (root / 'package.xml').is_file() else []
    # <prefix>/lib/pythonX.Y/site-packages/multicontact_control
    prefixes = [str(prefix) for prefix in package_dir.parents[3:4]] + [sys.prefix]
    prefixes += filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep))
    candidates += [Path(prefix) / 'share' / PACKAGE / 'config' for prefix in prefixes]
    for candidate in candidates:
        if candidate.is_dir():
            return candidate
    looked_in = ', '.join(dict.fromkeys(str(candidate) for candidate in candidates))
    raise ConfigError(
        'config', 'the configuration folder of the package', f'none of {looked_in}')


def named_file(kind: str, folder: str, name: str) -> Path:
    """
    Return a file that is given by its name in a folder of the configuration, or by a path.

    Parameters
    ----------
    kind
        What it holds, for an error.
    folder
        Folder in config/.
    name
        Name of a YAML file there, without its suffix, or a path.

    Raises
    ------
    ConfigError
        If there is neither.

    """
    there = config_dir() / folder
    named = there / f'{name}.yaml'
    if named.is_file():
        return named
    path = Path(name)
    if path.is_file():
        return path
    known = ', '.join(sorted(file.stem for file in there.glob('*.yaml')))
    raise ConfigError(kind, f'one of {known}, or a path', f"'{name}'")
