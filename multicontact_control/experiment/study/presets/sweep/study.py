"""`multicontact sweep`: parameters times seeds, from a study's file to a table of summaries."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from multicontact_control import __version__
from multicontact_control.arrays import Vector
from multicontact_control.errors import counted
from multicontact_control.experiment.judge import HELD
from multicontact_control.experiment.overrides import EVERY
from multicontact_control.experiment.page import COLOURS
from multicontact_control.experiment.study.execute import JobRun
from multicontact_control.experiment.study.jobs import RunJob
from multicontact_control.experiment.study.measure import summarise_run
from multicontact_control.experiment.study.page import Page, Section
from multicontact_control.experiment.study.presets.sweep.config import (
    plan_sweep,
    read_study,
    study_path,
    SweepPlan,
)
from multicontact_control.experiment.study.study import Study
from multicontact_control.experiment.study.table import Column, Line, Listing, short_names
import numpy as np
import pyarrow as pa

SHOWN = 40  # lines of the table over the seeds that still fit a terminal
NOTE = ('Every line stands for the runs that differ in their seed only: how many were stable, and '
        'the median of the stable ones; a star is the worst contact. Every single run is in '
        'sweep.parquet.')
# Of summary.json: what is told elsewhere in the row, is no result, or depends on the machine.
LEFT_OUT = ('claims', 'ended_early', 'instabilities', 'kept_real_time', 'mode',
            'noise_estimator', 'plant', 'scenario', 'schema', 'seed', 'stable', 'supervised',
            'timing', 'trajectory_sha256', 'verdict')
SUFFIX_UNITS = {
    '_n2': 'N^2', '_n': 'N', '_s': 's', '_m': 'm', '_rad': 'rad', '_hz': 'Hz', '_percent': '%',
    '_fraction': '1', '_fraction_of_limit': '1'}
# Texts even where all of them are null.
TEXTS = ('verdict', 'unjudged', 'error', 'instabilities', 'trajectory_sha256')
STABLE = 'stable'
CHOICE = (  # of metrics to show
    STABLE, 'contacts.*.step_rise_63_s', 'contacts.*.rest.true_error_rms_n',
    'contacts.*.moving.true_error_rms_n')
WIDE_RANGE = 20.0  # largest over smallest, from which an axis is logarithmic


@dataclass(frozen=True)
class SweepStudy(Study[RunJob, pa.Table]):
    """The runs of a study's file; made by `sweep_study`."""

    plan: SweepPlan

    title = 'sweep'
    name = 'sweep'
    measure = staticmethod(summarise_run)

    def folder(self) -> Path:
        """Return a folder that is called like the study."""
        return Path('runs') / f'sweep-{self.plan.study.name}'

    def headline(self) -> str:
        """Return how many combinations and seeds there are."""
        study, seeds = self.plan.study, len(self.plan.study.seeds)
        return (f'study {study.name}: {counted(len(self.plan.runs) // seeds, "combinations")} '
                f'with {counted(seeds, "seeds")}')

    def grid(self) -> Mapping[str, Sequence[Any]]:
        """Return plants, seeds, and the values of every parameter that is swept."""
        return {'plants': self.plan.study.plants, 'seeds': self.plan.study.seeds, **{
            f'{name} [{unit}]' if unit else name:
            list(dict.fromkeys(run.values[name] for run in self.plan.runs))
            for name, unit in self.plan.units.items()}}

    def jobs(self) -> list[RunJob]:
        """Return the runs."""
        return [run.job for run in self.plan.runs]

    def content(self, run: JobRun[RunJob]) -> pa.Table:
        """Return the table: a row for each run, also for those that failed."""
        return sweep_table(self.plan, [
            row_of(run.metrics(job), run.keys[job]) for job in self.jobs()])

    def tables(self, content: pa.Table, run: JobRun[RunJob]) -> Mapping[str, Any]:
        """Return the table and the study."""
        return {'sweep.parquet': content, 'study.yaml': self.plan.study.model_dump(mode='json')}

    def page(self, content: pa.Table, folder: Path) -> Page:
        """Return the medians over the seeds, and the picture of them."""
        study = self.plan.study
        metrics, missing = chosen_metrics(content, study.figures)
        listing = sweep_listing(self.plan, content, metrics)
        return Page(
            f'Sweep {study.name}',
            [Section(f'{study.name}: stable runs and their medians over the seeds', listing,
                     in_terminal=len(listing.lines) <= SHOWN,
                     before=f'<p class=note>{NOTE}</p>')],
            introduction=[study.description,
                          f'{counted(len(self.plan.runs), "runs")} of the scenario '
                          f'{study.scenario}, '
                          f'{len(study.seeds)} with each combination.'],
            warnings=[f'figures: the table has no numbers under {name}' for name in missing],
            findings=[_counts(content)],
            figure=draw_sweep(self.plan, content, metrics) if metrics else None)


def sweep_study(
    name: str, seeds: tuple[int, ...] | None = None, robot: str = '',
) -> SweepStudy:
    """Return the study of a file in config/studies, or of a path; see `read_study`."""
    path = study_path(name)
    return SweepStudy(plan_sweep(read_study(path, seeds=seeds, robot=robot), str(path)))


def _counts(table: pa.Table) -> str:
    stable = sum(table['stable'].to_pylist())
    ended = sum(error is not None for error in table['error'].to_pylist())
    held = table['verdict'].to_pylist().count(HELD)
    return (f'{counted(table.num_rows, "runs")}: {stable} stable, {table.num_rows - stable} not, '
            f'of which {ended} ended early and {held} were held by the supervisor')


def row_of(metrics: Mapping[str, Any], key: str) -> dict[str, Any]:
    """Return what `summarise_run` gave under a key as flat columns."""
    summary = metrics['summary'] or {}
    return {
        STABLE: bool(summary.get(STABLE, False)), 'verdict': summary.get('verdict'),
        'error': metrics['error'],
        'instabilities': '; '.join(summary.get('instabilities', ())) or None,
        **dict(_flat({name: value for name, value in summary.items() if name not in LEFT_OUT})),
        'trajectory_sha256': summary.get('trajectory_sha256'), 'key': key}


def _flat(values: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the scalars of nested mappings by dotted names; lists are left out."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f'{prefix}{name}.')
        elif not isinstance(value, list):
            yield f'{prefix}{name}', value


def sweep_table(plan: SweepPlan, results: Sequence[dict[str, Any]]) -> pa.Table:
    """
    Return the table, the same whatever ran the jobs.

    Columns `run`, `plant`, `seed`, every swept parameter by its dotted name, and what `row_of`
    gave. Units are in the metadata of the fields, the study in that of the table.
    """
    names = list(dict.fromkeys(name for row in results for name in row if row.get('ticks')))
    names = names or list(results[0])
    rows = [{'run': run.number, 'plant': run.job.plant, 'seed': run.job.seed, **run.values,
             **{name: row.get(name) for name in names}}
            for run, row in zip(plan.runs, results)]
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    fields = [pa.field(name, pa.string() if name in TEXTS else _type(values),
                       metadata=_metadata(name, plan.units))
              for name, values in columns.items()]
    return pa.Table.from_pydict(columns, schema=pa.schema(fields, metadata={
        'study': json.dumps(plan.study.model_dump(mode='json')), 'version': __version__}))


def _type(values: Sequence[Any]) -> pa.DataType:
    kinds = {type(value) for value in values if value is not None}
    if kinds == {bool}:
        return pa.bool_()
    if kinds == {int}:
        return pa.int64()
    return pa.float64() if kinds <= {int, float} else pa.string()


def _metadata(name: str, units: Mapping[str, str]) -> dict[str, str] | None:
    unit = units.get(name, '')
    if name not in units:
        unit = next((unit for suffix, unit in SUFFIX_UNITS.items() if name.endswith(suffix)), '')
    return {'unit': unit} if unit else None


def metric_values(table: pa.Table, name: str) -> Vector:
    """
    Return a metric of every run, shape (m,), NaN where a run has none.

    With ``*`` in its name the largest of all columns that fit; shape (0,) if there is no such
    column of numbers.
    """
    head, star, tail = name.partition(EVERY)
    columns = [table[column] for column in table.column_names if column == name or (
        star and column.startswith(head) and column.endswith(tail)
        and EVERY not in column and '.' not in column[len(head):len(column) - len(tail)])]
    if not columns or any(pa.types.is_string(column.type) for column in columns):
        return np.empty(0)
    values: Vector = np.fmax.reduce(
        [column.cast(pa.float64()).to_numpy() for column in columns], axis=0)
    return values


def judged(table: pa.Table, name: str) -> Vector:
    """Return a metric of the stable runs, NaN for the others; `stable` itself of all."""
    values = metric_values(table, name)
    return values if name == STABLE else np.where(
        metric_values(table, STABLE) == 1.0, values, np.nan)


def chosen_metrics(table: pa.Table, wanted: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the metrics to show, and those that were wanted but are not there."""
    if wanted:
        missing = [name for name in wanted if not metric_values(table, name).size]
        return [name for name in wanted if name not in missing], missing
    return [name for name in CHOICE if np.isfinite(metric_values(table, name)).any()], []


def sweep_listing(plan: SweepPlan, table: pa.Table, metrics: Sequence[str]) -> Listing:
    """Return how many runs of each combination were stable, and the medians of those."""
    names = [name for name in metrics if name != STABLE]
    seeds = len(plan.study.seeds)  # the runs of a combination follow each other
    stable, *series = (judged(table, name).reshape(-1, seeds) for name in (STABLE, *names))
    lines = [Line([
        run.job.plant, *(_text(run.values[name]) for name in plan.units),
        f'{int(stable[i].sum())}/{seeds}', *(_text(_spread(values[i])[1]) for values in series)])
        for i, run in enumerate(plan.runs[::seeds])]
    head = ['plant', *plan.units, STABLE, *names]
    return Listing([Column(name, short, number=i > len(plan.units))
                    for i, (name, short) in enumerate(zip(head, short_names(head)))], lines)


def _text(value: Any) -> str:
    if value is None or value != value:
        return '-'
    return f'{value:.4g}' if isinstance(value, float) else str(value)


def _spread(values: Vector, metric: str = '') -> tuple[float, float, float]:
    """Return smallest, median and largest of what is finite; of `stable` three times the share."""
    known = values[np.isfinite(values)]
    if not known.size:
        return np.nan, np.nan, np.nan
    if metric == STABLE:
        return (float(known.mean()),) * 3
    return float(known.min()), float(np.median(known)), float(known.max())


def draw_sweep(plan: SweepPlan, table: pa.Table, metrics: Sequence[str]) -> Figure:
    """
    Return the picture of a sweep: metrics against its first parameter, grouped by its second.

    A column for each plant, a row for each metric. Lines are medians, bands go from the smallest
    to the largest over seeds and whatever else is swept, both of the stable runs; `stable` is
    their share.
    """
    plants, names = plan.study.plants, list(plan.units)
    figure = Figure(figsize=(4.6 * len(plants) + 1.0, 2.4 * len(metrics) + 1.0),
                    layout='constrained')
    grid = figure.subplots(len(metrics), len(plants), sharex=True, sharey='row', squeeze=False)
    for column, plant in enumerate(plants):
        for axes, metric in zip(grid[:, column], metrics):
            _panel(axes, plan, judged(table, metric), plant, metric)
            if column == 0:
                axes.set_ylabel('share of stable runs' if metric == STABLE else '\n'.join(
                    metric.replace(EVERY, 'worst').rsplit('.', 1)), fontsize=8)
        grid[0, column].set_title(f'plant {plant}', fontsize=9)
        if names:
            unit = plan.units[names[0]]
            grid[-1, column].set_xlabel(f'{names[0]} [{unit}]' if unit else names[0], fontsize=8)
    if len(names) > 1:
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc='outside lower center', ncols=4, fontsize=8,
                      title=names[1], title_fontsize=8)
    return figure


def _panel(axes: Axes, plan: SweepPlan, values: Vector, plant: str, metric: str) -> None:
    runs: dict[tuple[Any, Any], list[int]] = {}  # by the first and the second parameter
    for run in plan.runs:
        if run.job.plant == plant:
            first, second = [*(run.values[name] for name in plan.units), '', ''][:2]
            runs.setdefault((first, second), []).append(run.number)
    across, lines = (_ordered([place[i] for place in runs]) for i in (0, 1))
    numeric = all(_is_number(value) for value in across)
    places = across if numeric else list(range(len(across)))
    for number, line in enumerate(lines):
        low, mid, high = np.transpose(
            [_spread(values[runs.get((value, line), [])], metric) for value in across])
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(places, mid, 'o-', markersize=3, linewidth=1.2, color=colour, label=str(line))
        axes.fill_between(places, low, high, color=colour, alpha=0.15, linewidth=0)
    if numeric and min(across) > 0.0 and max(across) / min(across) >= WIDE_RANGE:
        axes.set_xscale('log')
    if not numeric:
        axes.set_xticks(places, [str(value) for value in across], fontsize=8)
    if metric == STABLE:
        axes.set_ylim(-0.05, 1.05)
    axes.grid(alpha=0.3)


def _ordered(values: Sequence[Any]) -> list[Any]:
    """Return each value once, numbers by size."""
    found = list(dict.fromkeys(values))
    return sorted(found) if all(_is_number(value) for value in found) else found


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
