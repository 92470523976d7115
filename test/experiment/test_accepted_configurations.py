"""A configuration that is accepted is safe, whatever its numbers make of the control."""

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from multicontact_control.config import ControllerConfig
from multicontact_control.errors import ConfigError
from multicontact_control.experiment.closed_loop import ClosedLoop
from multicontact_control.experiment.scenario import resolve
import numpy as np
import pytest

SECTIONS = ('motion', 'force', 'contact_state', 'watchdog', 'limits', 'transition', 'friction')
FACTOR = 30.0  # times the default, either way; what is beyond a bound is refused
TICKS = 700

PARAMETERS = {
    (section, name): field.default for section in SECTIONS
    for name, field in type(ControllerConfig.model_fields[section].default).model_fields.items()
    if type(field.default) in (int, float) and field.default > 0}


@pytest.mark.slow
@settings(max_examples=30, deadline=None, derandomize=True,
          suppress_health_check=list(HealthCheck))
@given(chosen=st.lists(st.sampled_from(sorted(PARAMETERS)), min_size=1, max_size=6, unique=True),
       data=st.data(), plant=st.sampled_from(['rigid', 'puma']))
def test_accepted_configuration_is_safe(chosen, data, plant):
    """Torques and their rates within limits, and no force beyond the ceiling for 0.1 s."""
    changes = {}
    for section, name in chosen:
        default = PARAMETERS[section, name]
        factor = np.exp(data.draw(st.floats(-np.log(FACTOR), np.log(FACTOR))))
        changes.setdefault(section, {})[name] = type(default)(default * factor)
    try:
        loop = ClosedLoop(resolve('quick', plant=plant, controller=changes), commanded=True)
    except ConfigError:
        return
    config = loop.setup.controller
    limit = np.array(config.torque_limit)
    step = np.array(config.limits.torque_rate) * config.period
    ceiling = 1.25 * config.contact_state.force_ceiling
    above, last = 0, None
    loop.advance()
    loop.control.set_forces(dict.fromkeys(
        config.contact_names, max(10.0, config.contact_state.smallest_force)))
    for _ in range(TICKS):
        loop.advance()
        torque = loop.command
        assert np.isfinite(torque).all()
        assert (np.abs(torque) <= limit * (1.0 + 1e-9)).all()
        assert last is None or (np.abs(torque - last) <= step * (1.0 + 1e-9)).all()
        last = torque.copy()
        above = above + 1 if loop.sample.contact_force.max() > ceiling else 0
        assert above <= 50, loop.sample.contact_force
    loop.close()
