"""The ROS 2 face of the package: thin nodes around the core, and what they share."""

import os
import sys

from multicontact_control.errors import RosError
from multicontact_control.process import limit_threads

limit_threads()  # every node's process comes through here before it imports numpy
if not os.environ.get('AMENT_PREFIX_PATH'):
    os.environ['AMENT_PREFIX_PATH'] = sys.prefix  # where wheels put their resources
try:
    from ament_index_python import get_resources

    known = get_resources('rmw_typesupport').keys() - {'rmw_implementation'}
    wanted = os.environ.get('RMW_IMPLEMENTATION')
    # With a middleware that is not installed, rcl would end the process.
    if wanted and known and wanted not in known:
        raise ImportError(
            f'RMW_IMPLEMENTATION: expected {" or ".join(known)}, got {wanted}'
        )
    import rclpy.node  # noqa: F401 - what is compiled of it, too
except ImportError as error:
    sys.tracebacklimit = 0  # a node's process ends with one line, as a command does
    raise RosError(
        f'ROS 2 (rclpy) cannot be loaded: {str(error).splitlines()[0]}; install the extra [ros], '
        f'source a ROS 2 Jazzy (found: {os.environ.get("ROS_DISTRO", "none")}) or use '
        '`multicontact simulate`'
    ) from None
