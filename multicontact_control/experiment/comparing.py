"""What the commands `compare` and `map` do, from their options to their files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from multicontact_control.errors import ConfigError
from multicontact_control.experiment.comparison import (
    comparison_table,
    run_comparison,
)
from multicontact_control.experiment.comparison_page import write_comparison_page
from multicontact_control.experiment.engine import LocalExecutor, prepare_cell_folder
from multicontact_control.experiment.estimate import estimate_time
from multicontact_control.experiment.findings import findings
from multicontact_control.experiment.matrix import (
    beside_the_matrix,
    comparison_matrix,
    Entry,
    LABELS,
    QUICK_LABELS,
)
from multicontact_control.experiment.robustness import ratios
from multicontact_control.experiment.robustness_map import (
    map_table,
    MapLayout,
    run_map,
    write_map,
)
from multicontact_control.experiment.scenario import PLANTS
from rich.console import Console
from rich.markup import escape

WIDE = 110  # columns of a terminal that takes the whole table


@dataclass(frozen=True)
class ComparisonRequest:
    """
    The options of `multicontact compare`.

    Attributes
    ----------
    plants, estimators
        Names; no estimators for all, or those of the quick matrix.
    seeds
        How many; None for 3, or 1 of the quick matrix.
    jobs
        Runs at once, 0 for every core.
    quick, overwrite
        The reduced matrix; whether finished cells are run again.
    out
        Folder.

    """

    plants: tuple[str, ...]
    estimators: tuple[str, ...]
    seeds: int | None
    jobs: int
    quick: bool
    out: Path
    overwrite: bool

    def entries(self) -> list[Entry]:
        """Return the cells asked for."""
        if self.jobs < 0:
            raise ConfigError('jobs', 'a whole number >= 0', self.jobs)
        labels = self.estimators or (QUICK_LABELS if self.quick else LABELS)
        seeds = self.seeds if self.seeds is not None else (1 if self.quick else 3)
        return (comparison_matrix(self.plants, labels, seeds, plain=not self.quick)
                + beside_the_matrix(self.plants, seeds, quick=self.quick))


def compare_and_report(request: ComparisonRequest, console: Console | None = None) -> None:
    """
    Run a comparison, show its tables, write its files.

    Parameters
    ----------
    request
        What is asked for.
    console
        Where it is shown.

    """
    console = console or Console()
    entries = request.entries()
    prepare_cell_folder(request.out, overwrite=request.overwrite)
    executor = LocalExecutor(request.jobs)
    estimate = estimate_time((entry.cell for entry in entries), request.out, executor.jobs)
    console.print(estimate.sentence(executor.jobs))
    content = run_comparison(entries, request.out, executor=executor, console=console)
    for plant in request.plants:
        console.print(comparison_table(
            content['rows'], plant, narrow=console.width < WIDE))
    for text in findings(content['rows']):
        console.print(f'- {escape(text)}', highlight=False)
    for plant, claims in content['claims'].items():
        against = [claim['claim'] for claim in claims if claim['holds'] is False]
        for text in against:
            console.print(f'[red]does not hold on {escape(plant)}:[/red] {escape(text)}',
                          highlight=False)
    path = write_comparison_page(content, request.out)
    console.print(f'results in {path}')


@dataclass(frozen=True)
class MapRequest:
    """
    The options of `multicontact map`.

    Attributes
    ----------
    plants, estimators
        Names; none for all, or those of the quick map.
    jobs
        Runs at once, 0 for every core.
    quick, overwrite
        The coarse map; whether finished cells are run again.
    out
        Folder.

    """

    plants: tuple[str, ...]
    estimators: tuple[str, ...]
    jobs: int
    quick: bool
    out: Path
    overwrite: bool

    def layout(self) -> MapLayout:
        """Return the map asked for."""
        if self.jobs < 0:
            raise ConfigError('jobs', 'a whole number >= 0', self.jobs)
        plants = self.plants or (('rigid',) if self.quick else PLANTS)
        labels = self.estimators or (('lead_window', 'fixed') if self.quick else LABELS)
        return MapLayout(plants, labels, tuple(ratios(8 if self.quick else 13)))


def map_and_report(request: MapRequest, console: Console | None = None) -> None:
    """
    Run a robustness map, draw it, write its files.

    Parameters
    ----------
    request
        What is asked for.
    console
        Where it is shown.

    """
    console = console or Console()
    layout = request.layout()
    prepare_cell_folder(request.out, overwrite=request.overwrite)
    executor = LocalExecutor(request.jobs)
    estimate = estimate_time(layout.cells().values(), request.out, executor.jobs)
    console.print(estimate.sentence(executor.jobs))
    content = run_map(layout, request.out, executor=executor, console=console)
    for plant in layout.plants:
        console.print(map_table(content, plant))
    for path in write_map(content, request.out):
        console.print(f'results in {path}', highlight=False)
