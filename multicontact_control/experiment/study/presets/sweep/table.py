"""The table of a sweep: one row for each run, the same whatever ran it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import json
from typing import Any

from multicontact_control import __version__
from multicontact_control.experiment.study.presets.sweep.plan import SweepPlan
import pyarrow as pa

TABLE_FILE = 'sweep.parquet'
# Of summary.json: what is told elsewhere in the row, is no result, or depends on the machine.
LEFT_OUT = ('claims', 'ended_early', 'instabilities', 'kept_real_time', 'mode',
            'noise_estimator', 'plant', 'scenario', 'schema', 'seed', 'stable', 'supervised',
            'timing', 'trajectory_sha256', 'verdict')
SUFFIX_UNITS = {
    '_n2': 'N^2', '_n': 'N', '_s': 's', '_m': 'm', '_rad': 'rad', '_hz': 'Hz', '_percent': '%',
    '_fraction': '1', '_fraction_of_limit': '1'}
# Texts even where all of them are null.
TEXTS = ('verdict', 'error', 'instabilities', 'trajectory_sha256')

Row = dict[str, Any]


def row_of(metrics: Mapping[str, Any], lost: str = '') -> Row:
    """
    Return the results of one run as flat columns.

    Parameters
    ----------
    metrics
        Of `summarise_run`; empty for a run that was lost.
    lost
        Why it was.

    """
    summary = metrics.get('summary') or {}
    return {
        'stable': bool(summary.get('stable', False)), 'verdict': summary.get('verdict'),
        'error': lost or metrics.get('error'),
        'instabilities': '; '.join(summary.get('instabilities', ())) or None,
        **dict(_flat({name: value for name, value in summary.items() if name not in LEFT_OUT})),
        'trajectory_sha256': summary.get('trajectory_sha256')}


def _flat(values: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the scalars of nested mappings by dotted names; lists are left out."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f'{prefix}{name}.')
        elif not isinstance(value, list):
            yield f'{prefix}{name}', value


def sweep_table(plan: SweepPlan, results: Sequence[Row]) -> pa.Table:
    """
    Return the table.

    Parameters
    ----------
    plan
        The runs.
    results
        What `row_of` gave for each of them.

    Returns
    -------
    pyarrow.Table
        Columns `run`, `plant`, `seed`, every swept parameter by its dotted name, and the results.
        Units are in the metadata of the fields, the study in that of the table.

    """
    names = list(dict.fromkeys(name for row in results for name in row if row.get('ticks')))
    names = names or list(results[0])
    columns: dict[str, list[Any]] = {
        'run': [run.number for run in plan.runs], 'plant': [run.plant for run in plan.runs],
        'seed': [run.seed for run in plan.runs],
        **{name: [run.values[name] for run in plan.runs] for name in plan.units},
        **{name: [row.get(name) for row in results] for name in names}}
    fields = [pa.field(name, pa.string() if name in TEXTS else _type(values),
                       metadata=_metadata(name, plan.units))
              for name, values in columns.items()]
    arrays = [pa.array(values, type=field.type) for field, values in zip(
        fields, columns.values())]
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata={
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
