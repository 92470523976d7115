"""
Force laws and noise estimators by name, each with the place of what implements it.

A new one of the package is a file and one line here. One of another package is an entry point of
that package, in the group `multicontact_control.force_laws` or
`multicontact_control.noise_estimators`; every process knows it. One of a program of one file is
registered by that program, and known in its process. The configuration, the command line and the
studies take the names from here, in this order, without importing what they stand for: the
configuration lies below the force laws, and the command line prints its help before numpy is
loaded.

Robots, scenarios, presets and studies are files. Another package brings them in a folder like
``config/``, by an entry point in the group `multicontact_control.config` that names the package.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from importlib.util import find_spec
import logging
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from multicontact_control.errors import ConfigError

# The place is a module and an object in it, as `pkgutil.resolve_name` reads it.
FORCE_LAWS = {
    'aob': 'multicontact_control.force.laws.aob:LAW',
    'pi': 'multicontact_control.force.laws.pi:LAW',
    'dob': 'multicontact_control.force.laws.dob:LAW',
    'lqg': 'multicontact_control.force.laws.lqg:LAW',
    'admittance': 'multicontact_control.force.laws.admittance:LAW',
    'impedance': 'multicontact_control.force.laws.impedance:LAW',
    'feedforward': 'multicontact_control.force.laws.feedforward:LAW',
}
NOISE_ESTIMATORS = {
    'lead_window': 'multicontact_control.force.noise.window:LeadWindowEstimator',
    'hf_window': 'multicontact_control.force.noise.window:HfWindowEstimator',
    'window': 'multicontact_control.force.noise.window:WindowEstimator',
    'fixed': 'multicontact_control.force.noise.fixed:Fixed',
    'innovation': 'multicontact_control.force.noise.innovation:InnovationWindow',
    'sage_husa': 'multicontact_control.force.noise.sage_husa:SageHusa',
    'variational_bayes': 'multicontact_control.force.noise.variational_bayes:VariationalBayes',
}

# Folders like ``config/`` of other packages, by name.
CONFIG_FOLDERS: dict[str, str] = {}


def register_force_law(name: str, place: str) -> None:
    """
    Let a force law of your own be known by a name, in this process.

    Parameters
    ----------
    name
        What `force.law` chooses it by.
    place
        Module and object of its `LawDesign`, e.g. ``my_laws:LAW``; ``__main__:LAW`` in a program
        that is run. It is imported when the law is first needed.

    Raises
    ------
    ConfigError
        If the name stands for another place.

    """
    _register(FORCE_LAWS, f'force law {name}', name, place)


def register_noise_estimator(name: str, place: str) -> None:
    """
    Let a noise estimator of your own be known by a name, in this process.

    As `register_force_law`, with a subclass of `NoiseEstimator` for `noise_estimator.estimator`.
    """
    _register(NOISE_ESTIMATORS, f'noise estimator {name}', name, place)


def register_config_folder(name: str, folder: str) -> None:
    """
    Let the files of a folder be found by their names, in this process.

    Parameters
    ----------
    name
        Of the folder, by which it is registered once.
    folder
        Path of a folder with ``robots/``, ``scenarios/``, ``presets/`` or ``studies/``, as
        ``config/`` has them. A file of this package goes before one of the same name.

    Raises
    ------
    ConfigError
        If there is no such folder, or the name stands for another one.

    """
    title = f'configuration folder {name}'
    if not Path(folder).is_dir():
        raise ConfigError(title, 'a folder', folder)
    _register(CONFIG_FOLDERS, title, name, folder)


def _register_config_package(name: str, package: str) -> None:
    """Register the folder ``config`` of a package of the top level, which is not imported."""
    spec = find_spec(package) if package.isidentifier() else None
    if spec is None or not spec.submodule_search_locations:
        raise ConfigError(
            f'configuration folder {name}', 'a package of the top level', package
        )
    register_config_folder(
        name, str(Path(spec.submodule_search_locations[0], 'config'))
    )


def _register(registry: dict[str, str], title: str, name: str, place: str) -> None:
    taken = registry.setdefault(name, place)
    if taken != place:
        raise ConfigError(
            title, 'a name that is not taken', f'{place} beside {taken}, which has it'
        )


def import_registered(title: str, place: str) -> Any:
    """
    Return the object at a place; ConfigError, with what it is for, if it cannot be imported.

    An error of any kind in a module of another package is one line here; its cause is kept.
    """
    try:
        return resolve_name(place)
    except Exception as error:
        raise ConfigError(
            title,
            'a module and an object that can be imported',
            f'{place}: {type(error).__name__}: {error}',
        ) from error


def _register_installed() -> None:
    """Register what installed packages bring, by name; what cannot be is logged and left out."""
    for kind, register in (
        ('force_laws', register_force_law),
        ('noise_estimators', register_noise_estimator),
        ('config', _register_config_package),
    ):
        installed = entry_points(group=f'multicontact_control.{kind}')
        for entry in sorted(installed, key=lambda each: (each.name, each.value)):
            try:
                register(entry.name, entry.value)
            except ConfigError as error:
                logging.getLogger(__name__).warning('%s; it is left out', error)


_register_installed()
