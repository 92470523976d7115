"""The matrix of `multicontact compare`: which estimator runs on which plant, and why."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, get_args, NamedTuple

from multicontact_control.config import merge, NoiseEstimatorConfig, validate
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.claims import (
    FIXED,
    MATCHED,
    MAYBECK,
    PAPER_ESTIMATOR,
    UNFILTERED,
)
from multicontact_control.experiment.scenario import plant_source, plants_of, Setup
from multicontact_control.experiment.study.jobs import job_of, RunJob
from multicontact_control.force.noise import lead_filter
from sim_bridge.config import PlantConfig

SCENARIO, PRESET = 'disturbance', 'paper'
RESCALED = UNFILTERED
ESTIMATORS: tuple[str, ...] = get_args(NoiseEstimatorConfig.model_fields['estimator'].annotation)
LABELS = (*ESTIMATORS, RESCALED, MATCHED)
QUICK_LABELS = (PAPER_ESTIMATOR, FIXED, RESCALED, MATCHED)
DAMPING_RATES = (20.0, 60.0, 100.0)  # 1/s, K_2 over which the claims are judged
AOB, PLAIN = 'AOB', 'no active state'
CAUSE, STIFFNESS = 'cause', 'stiffness'
KINDS = (AOB, PLAIN, STIFFNESS, CAUSE)


class Entry(NamedTuple):
    """A job and its place in the matrix."""

    label: str  # of the estimator, with what was changed besides
    kind: str  # AOB, PLAIN; CAUSE and STIFFNESS for the jobs beside the matrix
    job: RunJob


def rescaling(config: NoiseEstimatorConfig) -> float:
    """Return the lead filter's gain for the variance of white noise: R of `window` over it."""
    return lead_filter(
        config.zero_frequency, config.pole_frequency, config.rate).variance_factor()


def check_label(label: str) -> None:
    """Check that a label stands for an estimator; ConfigError if it does not."""
    if label not in LABELS:
        raise ConfigError('estimators', f'names among {", ".join(LABELS)}', f"'{label}'")


def estimator_values(label: str, base: Setup) -> dict[str, Any]:
    """Return the values of the noise estimator that a label stands for, beside those of a base."""
    if label == MATCHED:
        return {'estimator': MAYBECK}
    if label == RESCALED:
        config = base.noise_estimator
        return {'estimator': 'window', 'variance_scale': config.variance_scale * rescaling(config)}
    return {'estimator': label}


def observer_values(label: str, base: Setup) -> dict[str, Any]:
    """
    Return the values of the controller that a label stands for, beside those of a base.

    An observer's gain depends on Q over R alone. The innovations' R at rest is that of the raw
    force, so with so much less Q the observer is as fast there as with the paper's filter.
    """
    if label != MATCHED:
        return {}
    return {'force': {
        'process_noise': base.controller.force.process_noise / rescaling(base.noise_estimator)}}


def name_checks(
    plants: Sequence[str], labels: Sequence[str],
) -> list[Callable[[], object]]:
    """Return what checks the names of plants and estimators, one by one."""
    return [*(partial(plant_source, name) for name in plants),
            *(partial(check_label, label) for label in labels)]


def controller_values(plant: str) -> dict[str, Any]:
    """Return what is laid over the controller: no compensation of friction that is not there."""
    return {} if _plant(plant).joint_friction_scale > 0.0 else {
        'friction': {'coulomb': [], 'viscous': []}}


def _plant(name: str) -> PlantConfig:
    return validate(PlantConfig, plant_source(name).values(), name)


# Label, kind, and what is laid over the files of estimator, controller and plant.
Variant = tuple[str, str, dict[str, Any], dict[str, Any], dict[str, Any]]


def comparison_matrix(
    plants: Sequence[str] = (), labels: Sequence[str] = LABELS, seeds: int = 3, *,
    plain: bool = True, duration: float | None = None, preset: str = PRESET,
    damping_rates: Sequence[float] = (),
) -> list[Entry]:
    """
    Return the matrix of plants (none for all), estimators, observers and seeds.

    Seeds count from 0; `plain` runs every estimator without the active state too, and `duration`
    [s] goes before that of the scenario. The claims' estimators run with all `damping_rates`
    [1/s].
    """
    orders: dict[str, dict[str, Any]] = {AOB: {}}
    if plain:
        orders[PLAIN] = {'force': {'active_state_order': 0}}
    entries = []
    for plant in plants or plants_of():
        base = job_of(SCENARIO, plant, 0, preset=preset).setup()
        variants = [(label, kind, order) for label in labels for kind, order in orders.items()]
        variants += [(label, AOB, {'force': {'damping_rate': rate}})
                     for rate in damping_rates for label in labels if label in QUICK_LABELS]
        entries += _entries(plant, [
            (label, kind, estimator_values(label, base),
             merge(observer_values(label, base), values), {})
            for label, kind, values in variants], seeds, duration, preset)
    return entries


def beside_the_matrix(
    plants: Sequence[str] = (), seeds: int = 3, *, quick: bool = False,
    preset: str = PRESET, damping_rates: Sequence[float] = (),
) -> list[Entry]:
    """
    Return the runs that look for causes, with flexible drives, and those with a wrong stiffness.

    The latter with all `damping_rates`, too [1/s].
    """
    entries = []
    for plant in plants or plants_of():
        config = _plant(plant)
        controllers: list[dict[str, Any]] = [{}, *(
            {'force': {'damping_rate': rate}} for rate in damping_rates)]
        entries += _entries(plant, [
            (f'{PAPER_ESTIMATOR}, true stiffness x {ratio:g}', STIFFNESS,
             {'estimator': PAPER_ESTIMATOR}, controller,
             {'surfaces': {name: {'stiffness': ratio * surface.stiffness}
                           for name, surface in config.surfaces.items()}})
            for controller in controllers
            for ratio in ((0.5, 2.0) if quick else (0.2, 0.5, 2.0, 5.0))], 1, preset=preset)
        if config.drives == 'flexible':
            entries += _entries(plant, _cause_variants(config, quick), seeds, preset=preset)
    return entries


def _entries(
    plant: str, variants: Sequence[Variant], seeds: int, duration: float | None = None,
    preset: str = PRESET,
) -> list[Entry]:
    base = controller_values(plant)
    return [Entry(label, kind, job_of(
        SCENARIO, plant, seed, preset=preset, duration=duration, noise_estimator=estimator,
        controller={**base, **controller}, plant_overrides=overrides))
        for label, kind, estimator, controller, overrides in variants for seed in range(seeds)]


def _cause_variants(config: PlantConfig, quick: bool) -> list[Variant]:
    smooth = {'sensor': {'noise': False, 'quantise': False}, 'surfaces': {
        name: {'roughness_std': 0.0} for name in config.contact_names}}
    changes: list[tuple[str, dict[str, Any], dict[str, Any], dict[str, Any]]] = [
        (', no roughness, no sensor noise', {}, {}, smooth),
        *((f' at {variance:g} N²', {'fixed_variance': variance}, {}, {})
          for variance in ((2.0,) if quick else (2.0, 10.0, 100.0)))]
    if not quick:
        changes += [
            (', no actuator delay', {}, {}, {'actuator_delay_ticks': 0}),
            (', K_2 = 30 1/s', {}, {'force': {'damping_rate': 30.0}}, {}),
            (', T_d = 2 ms', {}, {'force': {'input_delay': 0.002}}, {})]
    return [(f'{FIXED}{name}', CAUSE, {'estimator': FIXED, **estimator}, controller, plant)
            for name, estimator, controller, plant in changes]
