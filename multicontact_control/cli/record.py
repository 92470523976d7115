"""`multicontact record`."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

from multicontact_control.cli.exits import errors_in_one_line, require_ros
from multicontact_control.cli.options import DomainId
from multicontact_control.errors import ConfigError
import typer


def record(
    topics: Annotated[list[str] | None, typer.Argument(
        help='Topics to record, e.g. /joint_states /tf; now or as soon as they appear.')] = None,
    all_topics: Annotated[bool, typer.Option(
        '--all', '-a', help='Record every topic that is not hidden.')] = False,
    output: Annotated[Path | None, typer.Option(
        '--output', '-o', help='Folder of the bag, to be created; rosbag2_<date>-<time> if not '
        'given.')] = None,
    domain_id: DomainId = None,
) -> None:
    """
    Record topics to a rosbag2 folder (MCAP), like `ros2 bag record`.

    Messages of any installed type are stored as they come over the wire. Ctrl-C ends it and
    closes the bag.
    """
    with errors_in_one_line():
        if bool(topics) == all_topics:
            raise ConfigError('topics', 'either names or --all', 'both' if topics else 'neither')
        require_ros()
        from multicontact_control.tools.record import record as run_record

        folder = output or Path(f'rosbag2_{datetime.now():%Y_%m_%d-%H_%M_%S}')
        run_record(topics or [], folder, lambda line: print(line, flush=True),
                   domain_id=domain_id)
