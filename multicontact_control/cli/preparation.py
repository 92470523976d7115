"""What `run` and `simulate` begin with."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multicontact_control.experiment.scenario import Setup


def prepare(
    scenario: str, plant: str, seed: int, duration: float | None, noise_estimator: str | None,
    out: Path | None, overwrite: bool,
) -> tuple[Setup, Path]:
    """
    Check everything a run needs, then make its folder.

    Raises
    ------
    MulticontactError
        With the first value that is not acceptable; there is no new folder then.

    """
    from multicontact_control.experiment.results import prepare_folder
    from multicontact_control.experiment.scenario import resolve

    setup = resolve(
        scenario, plant=plant, seed=seed, duration=duration,
        noise_estimator={'estimator': noise_estimator} if noise_estimator else None)
    return setup, prepare_folder(
        out, setup.scenario.name, overwrite=overwrite, now=datetime.now())
