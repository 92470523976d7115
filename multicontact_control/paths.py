"""Where the files that come with the package are: in a checkout or where it is installed."""

from __future__ import annotations

import os
from pathlib import Path
import sys

from multicontact_control.errors import ConfigError
from multicontact_control.registry import CONFIG_FOLDERS

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
    prefixes = [str(folder) for folder in package_dir.parents[3:4]]
    prefixes.append(sys.prefix)
    prefixes += os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    searched = []
    for prefix in filter(None, prefixes):
        folder = Path(prefix, 'share/multicontact_control/config')
        if folder.is_dir():
            return folder
        searched.append(str(folder))
    raise ConfigError(
        'config',
        'the configuration folder of the package',
        f'none of {", ".join(searched)}',
    )


def list_named_files(folder: str) -> dict[str, Path]:
    """
    Return the YAML files in a folder of ``config/``, and in those of other packages, by name.

    A name has the inner folder, as in laws/pi. Of two files with one name this package's is found.
    """
    files: dict[str, Path] = {}
    for parent in (find_config_folder(), *map(Path, CONFIG_FOLDERS.values())):
        there = parent / folder
        for path in sorted(there.rglob('*.yaml')):
            files.setdefault(path.relative_to(there).with_suffix('').as_posix(), path)
    return files


def find_named_file(kind: str, folder: str, name: str) -> Path:
    """
    Return a YAML file in a folder of ``config/`` by its name, or any file by its path.

    ConfigError if there is none, with the names of all; `kind` is what such a file is, e.g.
    ``scenario``.
    """
    named = list_named_files(folder)
    if name in named:
        return named[name]
    if Path(name).is_file():
        return Path(name)
    raise ConfigError(kind, f'one of {", ".join(named)}, or a path', f"'{name}'")
