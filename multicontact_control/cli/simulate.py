"""`multicontact simulate`."""

from __future__ import annotations

from multicontact_control.cli import options
from multicontact_control.cli.exits import end_by_verdict, errors_in_one_line


def simulate(
    scenario: options.Scenario = 'paper', robot: options.Robot = '', plant: options.Plant = '',
    seed: options.Seed = 0, duration: options.Duration = None,
    noise_estimator: options.Estimator = None, out: options.Out = None,
    overwrite: options.Overwrite = False, bare: options.Bare = False,
    preset: options.Preset = 'best', law: options.Law = None, settings: options.Settings = None,
    engine: options.Engine = '',
) -> None:
    """
    Run a scenario in one process, without ROS, as fast as it goes.

    The same seed gives the same run, bit for bit. Exit code 0: stable, or not judged, as
    nothing was ever pressed; 1: not stable, or held by the supervisor; 2: bad input.
    """
    with errors_in_one_line():
        setup, folder = options.prepare(
            scenario, plant, seed, duration, noise_estimator, out, overwrite, preset=preset,
            law=law, settings=settings, robot=robot, engine=engine)
        # Only now: what is heavy is not loaded for the sake of an error.
        from multicontact_control.experiment.run import run_simulate

        summary = run_simulate(setup, folder, supervised=not bare)
    end_by_verdict(summary)
