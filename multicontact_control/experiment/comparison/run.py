"""What the command `compare` does, from its options to its files."""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.experiment.comparison.findings import findings
from multicontact_control.experiment.comparison.matrix import (
    beside_the_matrix,
    comparison_matrix,
    Entry,
    LABELS,
    QUICK_LABELS,
)
from multicontact_control.experiment.comparison.page import write_comparison_page
from multicontact_control.experiment.comparison.rows import run_comparison
from multicontact_control.experiment.comparison.table import comparison_table
from multicontact_control.experiment.matrix_request import MatrixRequest
from rich.console import Console
from rich.markup import escape

WIDE = 110  # columns of a terminal that takes the whole table


@dataclass(frozen=True)
class ComparisonRequest(MatrixRequest):
    """
    The options of `multicontact compare`.

    Attributes
    ----------
    seeds
        How many; None for 3, or 1 of the quick matrix.

    """

    seeds: int | None

    def entries(self) -> list[Entry]:
        """Return the cells asked for."""
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
    executor = request.begin([entry.cell for entry in entries], console)
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
