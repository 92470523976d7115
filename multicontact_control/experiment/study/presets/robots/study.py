"""`multicontact robots`: every robot, on every engine, in every scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from multicontact_control.errors import check_all, ConfigError, counted
from multicontact_control.experiment.scenario import plant_source, resolve, scenario_path
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.jobs import job_of, RunJob
from multicontact_control.experiment.study.measure import largest_known, summarise_run
from multicontact_control.experiment.study.page import Page, Section
from multicontact_control.experiment.study.study import check_seeds, Study
from multicontact_control.experiment.study.table import Column, format_number, Line, Listing
from sim_bridge.robots import find_robot, has_urdf, robot_names

# What simulates, and what is laid over the plant for it.
ENGINES: Mapping[str, dict[str, Any]] = {
    'pybullet': {'engine': 'pybullet'},
    'mujoco': {'engine': 'mujoco'},
    'mujoco-native': {'engine': 'mujoco', 'contact': 'native'}}
SCENARIOS = ('quick', 'moving_surface', 'curved', 'tilt', 'edge', 'plane')
PRESET = 'best'
COLUMNS = (
    Column('robot', number=False), Column('engine', number=False),
    Column('scenario', number=False), Column('stable', number=False),
    Column('rest rms [N]', 'rest\n[N]'), Column('moving rms [N]', 'move\n[N]'),
    Column('losses [%]', 'lost\n[%]', spare=True), Column('torque [% of limit]', 'torque\n[%]'),
    Column('path rms [mm]', 'path\n[mm]', spare=True))
STABLE = 3  # place of that column
NOTE = ('True force errors (rms) of each contact at rest and in motion, of the first seed; losses '
        'are samples in motion without contact, of the worse contact. `mujoco-native` has the '
        "engine's own contacts, without roughness; the other two have the same surfaces.")


def known_engines() -> tuple[str, ...]:
    """Return the engines that are installed."""
    return tuple(name for name, values in ENGINES.items() if find_spec(values['engine']))


def known_robots() -> tuple[str, ...]:
    """Return the robots whose URDF is installed."""
    return tuple(name for name in robot_names() if has_urdf(find_robot(name)))


@dataclass(frozen=True)
class RobotStudy(Study[RunJob, list[dict[str, Any]]]):
    """Robots, engines, scenarios and seeds, the latter from 0, on one plant of each robot."""

    robots: tuple[str, ...] = field(default_factory=known_robots)
    engines: tuple[str, ...] = field(default_factory=known_engines)
    scenarios: tuple[str, ...] = SCENARIOS
    plant: str = 'rigid'
    seeds: int = 1

    title = 'robots'
    name = 'robots'
    measure = staticmethod(summarise_run)

    def check(self) -> None:
        """Check the names; ConfigError with all that are not acceptable."""
        check_all(*(partial(plant_source, self.plant, name) for name in self.robots),
                  *(partial(self._check_engine, name) for name in self.engines),
                  *(partial(scenario_path, name) for name in self.scenarios),
                  partial(check_seeds, self.seeds))

    def _check_engine(self, name: str) -> None:
        if name not in ENGINES:
            raise ConfigError('engines', f'some of {", ".join(ENGINES)}', f"'{name}'")

    def grid(self) -> Mapping[str, Sequence[Any]]:
        """Return robots, engines, scenarios and seeds."""
        return {'robots': self.robots, 'engines': self.engines, 'scenarios': self.scenarios,
                'seeds': range(self.seeds)}

    def cells(self) -> list[tuple[str, str, str]]:
        """Return robot, engine and scenario of each cell; native contacts only with planes."""
        planes = {(robot, scenario): all(
            surface.shape == 'plane' and surface.velocity == 0.0 for surface in resolve(
                scenario, robot=robot, plant=self.plant).plant.surfaces.values())
            for robot in self.robots for scenario in self.scenarios}
        return [(robot, engine, scenario) for robot in self.robots
                for scenario in self.scenarios for engine in self.engines
                if planes[robot, scenario] or ENGINES[engine].get('contact') != 'native']

    def job(self, cell: tuple[str, str, str], seed: int) -> RunJob:
        """Return the run of a cell."""
        robot, engine, scenario = cell
        return job_of(scenario, plant_source(self.plant, robot).name, seed, preset=PRESET,
                      plant_overrides=ENGINES[engine], supervised=True)

    def jobs(self) -> list[RunJob]:
        """Return the runs."""
        return [self.job(cell, seed) for cell in self.cells() for seed in range(self.seeds)]

    def content(self, run: JobRun[RunJob]) -> list[dict[str, Any]]:
        """Return a row for each run."""
        return [{**dict(zip(('robot', 'engine', 'scenario'), cell)), 'seed': seed,
                 **figures_of(run.metrics(self.job(cell, seed)))}
                for cell in self.cells() for seed in range(self.seeds)]

    def page(self, content: list[dict[str, Any]], folder: Path) -> Page:
        """Return one table of everything."""
        unstable = [row for row in content if not row['stable']]
        left_out = [name for name in robot_names() if name not in self.robots]
        return Page(
            'Robots, engines and scenarios',
            [Section('True force errors', _listing(content), before=f'<p class=note>{NOTE}</p>')],
            warnings=[f'{row["robot"]} on {row["engine"]}, {row["scenario"]}, seed {row["seed"]}: '
                      f'{row["why"]}' for row in unstable],
            findings=[f'{counted(len(content), "runs")}, {len(content) - len(unstable)} stable'
                      + (f'; without {", ".join(left_out)}' if left_out else ''),
                      *_agreement(content)])


def figures_of(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is shown of a run that `summarise_run` measured."""
    summary = metrics['summary']
    if summary is None:
        return {'stable': False, 'why': metrics['error'], **dict.fromkeys((
            'rest_rms_n', 'moving_rms_n', 'loss_percent', 'torque_percent', 'path_mm'))}
    contacts = list(summary['contacts'].values())
    lost = largest_known(contact['moving']['contact_loss_fraction'] for contact in contacts)
    return {
        'stable': summary['stable'], 'why': '; '.join(summary['instabilities']),
        'rest_rms_n': [contact['rest']['true_error_rms_n'] for contact in contacts],
        'moving_rms_n': [contact['moving']['true_error_rms_n'] for contact in contacts],
        'loss_percent': _scaled(lost, 100.0),
        'torque_percent': _scaled(summary['torque']['max_fraction_of_limit'], 100.0),
        'path_mm': _scaled(summary['motion']['moving_position_rms_m'], 1e3)}


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value


def _agreement(content: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return how far apart engines with the same surfaces are."""
    apart = []
    runs = {(row['robot'], row['scenario'], row['seed'], row['engine']): row for row in content}
    for (robot, scenario, seed, engine), row in runs.items():
        other = runs.get((robot, scenario, seed, 'mujoco'))
        if engine == 'pybullet' and other and row['moving_rms_n'] and other['moving_rms_n']:
            apart += [abs(a - b) for a, b in zip(row['moving_rms_n'], other['moving_rms_n'])
                      if a is not None and b is not None]
    return [f'with the same surfaces, the moving force errors of the engines differ by '
            f'{max(apart):.2g} N at most'] if apart else []


def _listing(content: Sequence[Mapping[str, Any]]) -> Listing:
    lines = [Line([
        row['robot'], row['engine'], row['scenario'], 'yes' if row['stable'] else 'NO',
        _numbers(row['rest_rms_n']), _numbers(row['moving_rms_n']),
        format_number(row['loss_percent'], 1), format_number(row['torque_percent'], 0),
        format_number(row['path_mm'], 2)], bool(row['stable']))
        for row in content if not row['seed']]
    return Listing(COLUMNS, lines, verdict=STABLE)


def _numbers(values: Sequence[float | None] | None) -> str:
    return ' / '.join(format_number(value, 3) for value in values) if values else '-'
