"""What `multicontact study sanding` has beside its file: tilts, published results, a figure."""

from __future__ import annotations

from html import escape
from numbers import Real
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from multicontact_control.errors import ConfigError
from multicontact_control.judging.page import render_table
from multicontact_control.judging.panels import choose_colour
from multicontact_control.paths import find_config_folder
from multicontact_control.runs.scenario import resolve
from multicontact_control.study.cells import Cell, plan_runs
from multicontact_control.study.config import FactorConfig, PartConfig
from multicontact_control.study.sanding_job import SandingJob
from multicontact_control.study.study import Metrics, Results, Study
from multicontact_control.study.table import MARKERS
import pandas as pd
from scipy.spatial.transform import Rotation

TILT = 'tilt'  # factor: degrees about world x, by which the surfaces are turned
LOOP = 'plant.actuation.torque_loop'
PUBLISHED_FILE = 'sanding_published.csv'
COMPARED_PARTS = ('along z', 'normal estimated')  # beside the published results
DRAWN_PARTS = (*COMPARED_PARTS, 'second contact')
MEASURES = {  # columns: what they are called, digits, and what they are multiplied by
    'force_n': ('mean force error [N]', 2, 1.0),
    'position_m': ('mean position error [mm]', 2, 1000.0),
}


def read_published() -> pd.DataFrame:
    """
    Return the published results, a row for each torque loop, tilt and controller.

    Means over the ten published seeds, and their extremes: `force_n`, `least_force_n`,
    `largest_force_n`, the same of `position_m`, and `without_contact`. The columns of the torque
    loop and the tilt are called as the study's factors.
    """
    path = find_config_folder() / 'studies' / PUBLISHED_FILE
    published = pd.read_csv(path, comment='#')
    return published.rename(columns={'torque_loop': LOOP})


class SandingStudy(Study):
    """
    The public sanding benchmark: drives that err by a seed, on surfaces tilted by the factor tilt.

    Its results stand beside the published ones of the same tilt.
    """

    def plan_cells(self) -> list[Cell]:
        """
        Return the runs with every tilt as normals of the plant's surfaces.

        Raises
        ------
        ConfigError
            If a tilt is no number, or a run is not acceptable.

        """
        parts = {}
        for title, part in self.config.parts.items():
            factors = {**part.factors, TILT: _turn_surfaces(part)}
            parts[title] = part.model_copy(update={'factors': factors})
        cells = []
        for cell in plan_runs(self.config.model_copy(update={'parts': parts})):
            run: Any = cell.job  # a `RunJob`
            job = SandingJob(run.arguments)
            labels = {**cell.factors, TILT: float(cell.factors[TILT])}
            cells.append(Cell(labels, job, job.key()))
        return cells

    def table_rows(self, metrics: Metrics) -> list[dict[str, Any]]:
        """Return the row of a run: what `measure_sanding` gave."""
        return [dict(metrics)]

    def describe_findings(self, results: Results) -> list[str]:
        """
        Return for each part, with and without torque loop, how many runs hold and the errors.

        Errors are means over the seeds, at the worst tilt, and of the worst run. Where there are
        published force errors, the sentence says how many times as large the best of them is.
        """
        sentences = []
        for (part, loop), runs in results.frame.groupby(['part', LOOP], sort=False):
            means = runs.groupby(TILT)[list(MEASURES)].mean().max()
            worst = runs[list(MEASURES)].max()
            sentence = (
                f'{part}, {_name_loop(loop)}: {int(runs["holds"].sum())} of {len(runs)} runs '
                f'hold, contacts are lost {runs["losses"].sum():.0f} times; the error at the '
                f'worst tilt, a mean over the seeds, is {means["force_n"]:.2f} N and '
                f'{1000.0 * means["position_m"]:.2f} mm, that of the worst run '
                f'{worst["force_n"]:.2f} N and {1000.0 * worst["position_m"]:.2f} mm'
            )
            if part in COMPARED_PARTS:
                ratios = compare_with_published(runs, 'force_n')['ratio']
                if len(ratios):
                    sentence += (
                        f'; the best published force error of the same tilt is '
                        f'{ratios.min():.1f} to {ratios.max():.1f} times as large'
                    )
            sentences.append(f'{sentence}.')
        return sentences

    def further_sections(self, results: Results) -> dict[str, str]:
        """
        Return a table of each compared part and measure beside the published results.

        There is a line for each torque loop and tilt that is published, with means over the seeds,
        and the best published mean over ours.
        """
        sections = {}
        for part in COMPARED_PARTS:
            runs = results.frame[results.frame['part'] == part]
            for measure, (name, digits, scale) in MEASURES.items():
                table = compare_with_published(runs, measure)
                rows = []
                for (loop, tilt), line in table.iterrows():
                    numbers = scale * line.drop('ratio')
                    cells = [f'{number:.{digits}f}' for number in numbers]
                    ratio = f'{line["ratio"]:.1f}'
                    rows.append([_name_loop(loop), f'{tilt:g}', *cells, ratio])
                if rows:
                    head = ['torque loop', 'tilt [degrees]', *table.columns]
                    heading = f'{part}, beside the published results: {name}'
                    sections[heading] = render_table(
                        list(map(escape, head)), rows, numbers_from=1
                    )
        return sections

    def draw_figure(self, results: Results) -> Figure:
        """
        Return force and position errors over the tilt, with and without torque loop.

        Curves are means over the seeds, bands reach from the best seed to the worst.
        """
        loops = list(results.frame[LOOP].unique())
        figure = Figure(figsize=(9.2, 3.0 * len(loops) + 1.2), layout='constrained')
        grid = figure.subplots(
            len(loops), len(MEASURES), sharex=True, sharey='col', squeeze=False
        )
        published = read_published()
        for row, loop in zip(grid, loops):
            ours = results.frame[results.frame[LOOP] == loop]
            theirs = published[published[LOOP] == loop]
            for axes, (measure, (name, _, scale)) in zip(row, MEASURES.items()):
                _draw_published(axes, theirs, measure, scale)
                _draw_ours(axes, ours, measure, scale)
                axes.set_yscale('log')
                axes.yaxis.set_major_formatter('{x:g}')
                axes.set_xlabel('tilt [degrees]')
                axes.set_ylabel(name)
                axes.set_title(_name_loop(loop), fontsize=10)
                axes.grid(alpha=0.3, which='both')
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc='outside lower center', ncols=2, frameon=False
        )
        return figure


def _turn_surfaces(part: PartConfig) -> FactorConfig:
    """Return the factor tilt of a part as levels: the normals of its surfaces, by tilt."""
    base = resolve(part.scenario, plant=part.plants[0])
    levels = {}
    for tilt, _ in part.factors[TILT].settings(TILT):
        if not isinstance(tilt, Real):
            raise ConfigError(TILT, 'an angle in degrees', f"'{tilt}'")
        turn = Rotation.from_euler('x', float(tilt), degrees=True)
        normals = {}
        for name in base.plant.contact_names:
            normal = turn.apply(base.plant.surfaces[name].normal_world)
            normals[f'plant.surfaces.{name}.normal_world'] = normal.tolist()
        levels[str(tilt)] = normals
    return FactorConfig(levels=levels)


def compare_with_published(runs: pd.DataFrame, measure: str) -> pd.DataFrame:
    """
    Return the means of a measure beside the published ones, by torque loop and tilt.

    Parameters
    ----------
    runs
        Of one part; tilts that are not published are left out.
    measure
        `force_n` or `position_m`.

    Returns
    -------
    DataFrame
        `ours`, a column for each published controller, and `ratio`, the best of these over ours.

    """
    ours = runs.groupby([LOOP, TILT], sort=False)[measure].mean().rename('ours')
    published = read_published().astype({TILT: float})
    theirs = published.pivot(index=[LOOP, TILT], columns='controller', values=measure)
    table = ours.to_frame().join(theirs, how='inner')
    return table.assign(ratio=table[theirs.columns].min(axis=1) / table['ours'])


def _name_loop(loop: bool) -> str:
    if loop:
        return 'with torque loop'
    return 'without torque loop'


def _draw_published(axes: Axes, rows: pd.DataFrame, measure: str, scale: float) -> None:
    """Draw the published errors with one torque loop, dashed."""
    for number, (controller, line) in enumerate(
        rows.groupby('controller', sort=False), start=len(DRAWN_PARTS)
    ):
        errors = line.set_index(TILT)[
            [measure, f'least_{measure}', f'largest_{measure}']
        ]
        _draw_band(axes, scale * errors, f'published: {controller}', number, '--')


def _draw_ours(axes: Axes, runs: pd.DataFrame, measure: str, scale: float) -> None:
    """Draw our errors with one torque loop, a curve for each drawn part."""
    for number, part in enumerate(DRAWN_PARTS):
        of_part = runs[runs['part'] == part]
        if len(of_part):
            errors = of_part.groupby(TILT)[measure].agg(['mean', 'min', 'max'])
            _draw_band(axes, scale * errors, part, number, '-')


def _draw_band(
    axes: Axes, errors: pd.DataFrame, label: str, number: int, style: str
) -> None:
    """Draw mean, least and largest errors, in this order of columns, over their index."""
    mean, least, largest = (errors.sort_index()[name] for name in errors)
    colour = choose_colour(number)
    axes.fill_between(mean.index, least, largest, color=colour, alpha=0.15, linewidth=0)
    axes.plot(
        mean.index,
        mean,
        style,
        color=colour,
        marker=MARKERS[number],
        markersize=4,
        label=label,
    )
