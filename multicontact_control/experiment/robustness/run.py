"""What the command `map` does, from its options to its files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from multicontact_control.experiment.comparison.matrix import LABELS
from multicontact_control.experiment.estimate import begin_matrix
from multicontact_control.experiment.robustness.boundaries import ratios
from multicontact_control.experiment.robustness.mapping import (
    map_table,
    MapLayout,
    run_map,
    write_map,
)
from multicontact_control.experiment.scenario import PLANTS
from rich.console import Console


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
    executor = begin_matrix(layout.cells().values(), request.out, jobs=request.jobs,
                            overwrite=request.overwrite, console=console)
    content = run_map(layout, request.out, executor=executor, console=console)
    for plant in layout.plants:
        console.print(map_table(content, plant))
    for path in write_map(content, request.out):
        console.print(f'results in {path}', highlight=False)
