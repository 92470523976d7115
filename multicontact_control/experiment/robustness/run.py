"""What the command `map` does, from its options to its files."""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.experiment.comparison.matrix import LABELS
from multicontact_control.experiment.matrix_request import MatrixRequest
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
class MapRequest(MatrixRequest):
    """The options of `multicontact map`."""

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
    executor = request.begin(layout.cells().values(), console)
    content = run_map(layout, request.out, executor=executor, console=console)
    for plant in layout.plants:
        console.print(map_table(content, plant))
    for path in write_map(content, request.out):
        console.print(f'results in {path}', highlight=False)
