"""The whole benchmark, as one object and as a table."""

from __future__ import annotations

from typing import Any

from multicontact_control.experiment.bench.against_tsid import bench_tsid
from multicontact_control.experiment.bench.plant import (
    bench_cold_start,
    bench_in_process,
    bench_plant,
)
from multicontact_control.experiment.bench.scaling import bench_scaling
from multicontact_control.experiment.bench.tick import bench_laws, bench_tick
from multicontact_control.experiment.bench.timing import (
    Bystanders,
    describe_machine,
    share_notes,
    TOO_NOISY,
)
from multicontact_control.experiment.compilation import ensure_compiled
from multicontact_control.process import settle_process
from rich.console import Console
from rich.table import Table

TICKS, QUICK_TICKS = 20_000, 2_000
REPEATS, QUICK_REPEATS = 5, 3
NOT_TO_BE_BELIEVED = ': not to be believed, the machine was too noisy'


def run_bench(
    *, ticks: int | None = None, quick: bool = False, graph: bool = True,
    tsid_python: str | None = None,
) -> dict[str, Any]:
    """
    Measure everything against its floor: what `multicontact bench --json` prints.

    `ticks` are those of the controller per repeat, 20 000 by default, or 2 000 if `quick`, which
    is enough to see a ratio that is wrong by a factor. With a `tsid_python`, TSID is run there.
    """
    ensure_compiled()
    machine, bystanders = describe_machine(), Bystanders()
    settle_process()
    repeats = QUICK_REPEATS if quick else REPEATS
    count = ticks or (QUICK_TICKS if quick else TICKS)
    cold = bench_cold_start()
    tick = bench_tick(count, repeats, supervised=False)
    supervised_tick = bench_tick(count, repeats, supervised=True)
    laws = bench_laws(count)
    plant = bench_plant(min(count, 5_000))
    duration = 4.0 if quick else None
    in_process = bench_in_process(duration, repeats, supervised=False)
    supervised_run = bench_in_process(duration, repeats, supervised=True)
    over_ros, graph_note = _graph(5.0 if quick else 20.0) if graph else (None, 'graph: not asked')
    tsid, tsid_note = bench_tsid(tsid_python, count) if tsid_python else (None, '')
    scaling = bench_scaling(max(200, count // 10))
    others = bystanders.share()
    notes = [*tick.pop('notes'), *supervised_tick.pop('notes'), *share_notes(others),
             *filter(None, (graph_note, tsid_note))]
    return {
        'ratios': {
            'tick_to_dynamics': tick['ratio'],
            'supervised_tick_to_dynamics': supervised_tick['ratio'],
            'plant_to_pybullet': plant['ratio'],
            'latency_to_echo': over_ros['latency_to_echo'] if over_ros else None,
            'lockstep_to_floor': over_ros['lockstep_to_floor'] if over_ros else None,
            'law_to_tsid': tsid['ratio'] if tsid else None},
        'in_process_realtime_factor': in_process['realtime_factor'],
        'supervised_in_process_realtime_factor': supervised_run['realtime_factor'],
        'lockstep_realtime_factor': over_ros['lockstep_realtime_factor'] if over_ros else None,
        'tick_us': tick['tick_us'], 'supervised_tick_us': supervised_tick['tick_us'],
        'machine': {**machine, 'others_share': others, 'trustworthy': not any(
            note.startswith(TOO_NOISY) for note in notes)},
        'notes': notes, 'tick': tick, 'supervised_tick': supervised_tick, 'laws': laws,
        'plant': plant,
        'in_process': in_process, 'supervised_in_process': supervised_run,
        'scaling': scaling, 'cold_start': cold, 'graph': over_ros, 'tsid': tsid}


def _graph(duration: float) -> tuple[dict[str, Any] | None, str]:
    """Return what the graph takes, or why it was not measured."""
    try:
        from multicontact_control.experiment.bench.graph import bench_graph
    except ImportError as error:
        return None, f'graph: skipped, ROS 2 (rclpy) cannot be loaded: {error}'
    return bench_graph(duration), ''


def print_bench(result: dict[str, Any], console: Console) -> None:
    """Show a result as a table, doubts below it; first and last whether to believe it."""
    doubt = '' if result['machine']['trustworthy'] else NOT_TO_BE_BELIEVED
    table = Table('what', 'value', 'floor', 'ratio', title=f'multicontact bench{doubt}')
    tick, plant, graph = result['tick'], result['plant'], result['graph']
    supervised = result['supervised_tick']
    for title, part in (('bare tick', tick), ('supervised tick', supervised)):
        for name in ('p50', 'p99', 'p999', 'max'):
            table.add_row(f'{title} {name}', _us(part['tick_us'][name]),
                          _us(part['dynamics_us'][name]),
                          f"{part['ratio']:.2f} (spread {part['ratio_spread']:.0%})"
                          if name == 'p50' else '')
    table.add_row('plant step p50', _us(plant['plant_us']['p50']),
                  _us(plant['pybullet_us']['p50']), f"{plant['ratio']:.2f}")
    for title, key in (('in process', 'in_process'), ('supervised', 'supervised_in_process')):
        table.add_row(title, f"{result[f'{key}_realtime_factor']:.1f} x real time", '', '')
    if graph:
        table.add_row('graph latency p50', _us(graph['latency_us']['p50']),
                      _us(graph['echo_us']['p50']), f"{graph['latency_to_echo']:.2f}")
        table.add_row('the same, echo of bytes', '', _us(graph['raw_echo_us']['p50']), '')
        table.add_row('graph latency p99', _us(graph['latency_us']['p99']), 'period',
                      f"{graph['latency_p99_to_period']:.2f}")
        for name, ratio in graph['node_to_paced_in_process'].items():
            table.add_row(f'{name} in its node', _us(ratio * graph['paced_in_process_us'][name]),
                          _us(graph['paced_in_process_us'][name]), f'{ratio:.2f}')
        table.add_row('deadlines missed, of one process',
                      f"{graph['deadline_misses']}, {graph['composed_deadline_misses']}", '', '')
        table.add_row('lockstep', f"{graph['lockstep_realtime_factor']:.1f} x real time", '',
                      f"{graph['lockstep_to_floor']:.2f}")
        table.add_row('recorder', f"{graph['recorder_cpu_share']:.1%} of a core", '', '')
    if tsid := result['tsid']:
        table.add_row('law p50, against TSID', _us(tsid['law_us']['p50']),
                      _us(tsid['tsid_us']['p50']),
                      f"{tsid['ratio']:.2f} (spread {tsid['ratio_spread']:.0%})")
    table.add_row('cold start', f"{result['cold_start']['process_s']:.2f} s", '', '')
    console.print(table)
    for title, part in (('bare tick', tick), ('supervised tick', supervised)):
        console.print(f'share of the {title}: ' + ', '.join(
            f'{stage} {share:.0%}' for stage, share in part['shares'].items()))
    for name, times in result['scaling'].items():
        console.print(f'{name.removesuffix("_us")}: ' + ', '.join(
            f'{count}: {_us(time)}' for count, time in times.items()))
    console.print('law alone, over pinocchio: ' + ', '.join(
        f'{name} {law["ratio"]:.2f}' for name, law in result['laws'].items()))
    for note in result['notes']:
        console.print(note, style='yellow', highlight=False)
    if doubt:
        console.print(f'ratios{doubt}', style='red', highlight=False)


def _us(value: float) -> str:
    return f'{value:.1f} us'
