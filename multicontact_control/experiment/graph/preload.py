"""What every node needs, loaded once by the process that the nodes are forked from."""

import gc
import signal

import multicontact_control.nodes.controller_node
import multicontact_control.nodes.noise_estimator_node
import multicontact_control.nodes.recorder_node  # noqa: F401 - loaded for those that are forked
from setproctitle import setproctitle
import sim_bridge.sim_node  # noqa: F401

setproctitle('multicontact_control: nodes are forked from this')
gc.collect()
gc.freeze()  # what is not written to stays shared
signal.signal(signal.SIGHUP, signal.SIG_IGN)  # a run stops its nodes in order
