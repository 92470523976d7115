"""One run from its configuration to its folder: in process, or on the ROS 2 graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
import signal
from typing import Any, TYPE_CHECKING

from multicontact_control.compiled import count_compilations
from multicontact_control.config import validate
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.files import replace_json_file, replace_nonfinite_numbers
from multicontact_control.judging import results
from multicontact_control.judging.claims import claims_of
from multicontact_control.judging.display import print_summary, progress_bar
from multicontact_control.judging.figures import draw_figures
from multicontact_control.judging.verdict import (
    EXTERNAL_RUN,
    INTERRUPTED,
    LOCKSTEP,
    REAL_TIME,
)
from multicontact_control.runs.closed_loop import run_in_process
from multicontact_control.runs.compilation import ensure_compiled
from multicontact_control.runs.recording import BagContent, read_bag, RunData
from multicontact_control.runs.scenario import (
    flatten_parameters,
    Setup,
    SHORTEST,
)
from rich.console import Console
from rich.markup import escape

if TYPE_CHECKING:
    from multicontact_control.runs.graph.run import GraphResult
    from multicontact_control.runs.graph.spec import GraphSpec

# Periods: a robot moves on while its samples are late, the simulated one has stood still, and a
# busy machine is no fault of its sensors.
SIMULATION_PATIENCE = 25.0
Ending = tuple[dict[str, Any] | None, int | None]  # a summary, and a signal
CONSOLE = Console(highlight=False, soft_wrap=True)


def run_simulate(
    setup: Setup, folder: Path, *, supervised: bool = True
) -> dict[str, Any]:
    """
    Run a scenario in this process, leave its results in a folder, and return its summary.

    Without supervision there are no contact states, watchdogs and limits around the control law.
    """
    refuse_push_test(setup)
    ensure_compiled()
    setup.write(folder / results.CONFIG_FOLDER)
    with progress_bar(
        f'simulate {setup.scenario.name}', setup.scenario.duration, CONSOLE
    ) as show:
        result = run_in_process(
            setup,
            lambda time, alpha: show(
                time, dict(zip(setup.controller.contact_names, alpha))
            ),
            supervised=supervised,
        )
        show(setup.scenario.duration, {})
    if not result.data.ticks:
        raise RunError(f'the run ended at once: {result.ended_early}')
    result.data.save(folder)
    summary = results.summarise(
        result.data,
        setup,
        mode='in_process',
        timing={'kernels_compiled': count_compilations()},
        ended_early=result.ended_early,
        events=result.events if supervised else None,
    )
    return _finish(result.data, setup, folder, summary)


def simulation_parameters(setup: Setup) -> dict[str, dict[str, Any]]:
    """Return the parameters of the nodes of a simulated graph that belong to no file."""
    from multicontact_control.runs.graph.spec import CONTROLLER, ESTIMATOR, SIM

    return {
        CONTROLLER: {
            'patience': SIMULATION_PATIENCE,
            **setup.node_parameters('controller'),
        },
        ESTIMATOR: setup.node_parameters('noise_estimator'),
        SIM: setup.node_parameters('plant'),
    }


def run_on_graph(
    setup: Setup,
    folder: Path,
    *,
    supervised: bool = True,
    **options: Any,
) -> Ending:
    """
    Run a scenario, or commands, on the ROS 2 graph, and leave recording and results in a folder.

    A setup that is `endless` is ended by a signal; where it is not `simulated`, the user's own
    robot is behind the topics. `options` are fields of `GraphSpec`. Returns the summary, None if
    no sample was answered or a Ctrl-C skipped the report, and the signal that ended the run early,
    if one did. Raises ConfigError if the scenario cannot begin by itself or a parameter of the
    node is not acceptable, RunError if ROS cannot be loaded or a node dies.
    """
    from multicontact_control.nodes.controller_node import ControllerNodeConfig
    from multicontact_control.runs.graph.robot import ExpectedRobot
    from multicontact_control.runs.graph.spec import CONTROLLER, GraphSpec

    config = folder / results.CONFIG_FOLDER
    if setup.simulated or not setup.commanded_by_topic:
        refuse_push_test(setup)
    parameters = simulation_parameters(setup)
    if not setup.simulated:
        of_node = setup.nodes.get('controller', {})
        parameters[CONTROLLER] = flatten_parameters(of_node)
        node = validate(ControllerNodeConfig, of_node, 'controller_node')
        options |= {
            'domain_id': options.get('domain_id') or 0,
            'robot': ExpectedRobot(
                setup.controller.robot.joint_names,
                setup.controller.wrench_input,
                node.effort_output_topic,
                duration=None if setup.endless else setup.scenario.duration,
            ),
        }
    parameters[CONTROLLER]['supervised'] = supervised
    ensure_compiled()
    spec = GraphSpec(
        out=folder,
        ticks=0 if setup.endless else setup.ticks,
        rate=setup.controller.rate,
        seed=setup.seed,
        parameter_files=setup.write(config),
        reference_file=None if setup.commanded_by_topic else config / 'reference.yaml',
        extra_parameters=parameters,
        **options,
    )
    result = _show_graph(spec, setup)
    if not result.controlled:
        CONSOLE.print(
            'ended before any sample was answered: there is nothing to report'
        )
        return None, next(iter(result.signals), None)
    try:
        if len(result.signals) > 1:
            raise KeyboardInterrupt
        return _report_graph(result, spec, setup)
    except (KeyboardInterrupt, SystemExit):
        CONSOLE.print(
            f'report skipped; to write it: multicontact report {escape(str(folder))}'
        )
        return None, signal.SIGINT


def _report_graph(result: GraphResult, spec: GraphSpec, setup: Setup) -> Ending:
    """Return the summary of a run on the graph, and the signal that ended it early."""
    from multicontact_control.runs.graph.spec import CONTROLLER

    content = read_bag(
        result.bag,
        setup.controller,
        namespace=spec.namespace,
        answered=spec.robot is not None,
    )
    data = content.data
    interrupted = result.signals[0] if result.signals and spec.ticks else None
    if not spec.ticks:  # it lasts as long as it has, in the files, too
        setup = replace(
            setup,
            scenario=setup.scenario.model_copy(
                update={'duration': max(SHORTEST, data.ticks / data.rate)}
            ),
        )
        setup.write(spec.out / results.CONFIG_FOLDER)
    mode = (
        EXTERNAL_RUN if spec.robot else (REAL_TIME if spec.free_running else LOCKSTEP)
    )
    summary = results.summarise(
        data,
        setup,
        mode=mode,
        timing=graph_timing(result.timing, content),
        ended_early=result.ended or (INTERRUPTED if interrupted else ''),
        events=result.timing[CONTROLLER].get('events', [])
        if (spec.extra_parameters[CONTROLLER]['supervised'])
        else None,
        missing=content.missing,
        remarks=content.remarks,
    )
    return _finish(data, setup, spec.out, summary), interrupted


def _show_graph(spec: GraphSpec, setup: Setup) -> GraphResult:
    """Run the graph and show how far it is."""
    from multicontact_control.runs.graph.run import run_graph

    tell = partial(CONSOLE.print, markup=False)
    duration = setup.scenario.duration if spec.ticks else None
    with progress_bar(
        f'run {setup.scenario.name}', duration, CONSOLE, 'starting the nodes'
    ) as show:
        result = run_graph(spec, lambda progress: show(*progress), tell)
        if duration is not None and not result.signals:
            show(duration, {})
    if result.ended:
        tell(f'ended: {result.ended}')
    return result


def refuse_push_test(setup: Setup) -> None:
    """Check that the scenario can begin without a push test; ConfigError if it cannot."""
    if setup.controller.sensor.require_push_test:
        raise ConfigError(
            'sensor.require_push_test',
            'false in a scenario, which begins without a push on the tool',
            True,
        )


def graph_timing(
    timing: Mapping[str, Mapping[str, Any]],
    content: BagContent,
) -> dict[str, Any]:
    """Return the `timing` of ``summary.json`` from what the nodes and the bag say."""
    sim, data = timing.get('sim_node', {}), content.data
    result = {
        'lost_messages': timing.get('recorder_node', {}).get('lost'),
        'unanswered_samples': content.unanswered,
        'kernels_compiled': sum(
            node.get('kernels_compiled', 0) for node in timing.values()
        ),
        'tick_us': timing.get('controller_node', {}).get('tick_us'),
    }
    if sim:
        result |= {
            name: sim[name]
            for name in ('deadline_misses', 'latency_us', 'latency_histogram')
        }
        result['realtime_factor'] = (
            data.ticks / data.rate / sim['wall_s'] if (sim['wall_s']) else None
        )
    return result


def _finish(
    data: RunData, setup: Setup, folder: Path, summary: dict[str, Any]
) -> dict[str, Any]:
    """Judge the claims, write figures and summary, show the table."""
    summary['claims'] = [claim._asdict() for claim in claims_of(data, setup, summary)]
    draw_figures(data, setup, summary, folder / results.FIGURE_FOLDER)
    replace_json_file(folder / results.SUMMARY_FILE, replace_nonfinite_numbers(summary))
    print_summary(CONSOLE, summary, folder)
    return summary
