"""
ROS parameters from configuration models, and back.

Nested fields of a model get dotted names, a mapping such as ``contacts`` one set per name in
``contact_names``. ROS holds values of any type; the models alone say what is acceptable, so that
all errors are found at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
import traceback
from types import NoneType
import typing
from typing import Any

from multicontact_control.config.base import (
    Config,
    find_config_model,
    merge,
    sets_parameter,
    validate,
)
from multicontact_control.errors import ConfigError, MulticontactError, run_all_checks
from multicontact_control.nodes.private import parameter_overrides
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.node import Node
from rclpy.parameter import Parameter

SET_BY_ROS = ('use_sim_time', 'start_type_description_service', 'qos_overrides')
LOCKED = 'can be changed only before the node is configured'


def _leaves(
    model: type[Config],
    overrides: Mapping[str, Any],
    prefix: str = '',
) -> Iterator[tuple[str, FieldInfo]]:
    """Yield name and field of all values; mappings as in `overrides`, or of their contacts."""
    for key, field in model.model_fields.items():
        name, inner = prefix + key, find_config_model(field.annotation)
        if inner is None:
            yield name, field
        elif typing.get_origin(field.annotation) is dict:
            start = f'{name}.'
            given = dict.fromkeys(
                x[len(start) :].split('.')[0] for x in overrides if x.startswith(start)
            )
            for entry in given or overrides.get('contact_names') or ():
                yield from _leaves(inner, overrides, f'{name}.{entry}.')
        else:
            yield from _leaves(inner, overrides, f'{name}.')


def _descriptor(name: str, field: FieldInfo) -> ParameterDescriptor:
    extra: Any = field.json_schema_extra or {}
    unit = f' [{extra["unit"]}]' if extra.get('unit') else ''
    # Not read-only: that changes with the life cycle, a descriptor does not.
    return ParameterDescriptor(
        name=name,
        dynamic_typing=True,
        description=f'{field.description or ""}{unit}',
        additional_constraints='' if extra.get('live') else LOCKED,
    )


class ParameterSet:
    """
    Declares the parameters of models.

    While `use` is None all of them may change, to be validated when they are used; else only
    those that are live: `use` takes what `design` makes of the configurations with a change, or
    either raises, and `refuse` hears the name and error of a change that is not taken. `version`
    counts what makes a design that was begun before out of date.
    """

    def __init__(self, node: Node, *models: type[Config]) -> None:
        self._node, self._models = node, models
        given = {
            name: parameter.value
            for name, parameter in parameter_overrides(node).items()
            if name.split('.')[0] not in SET_BY_ROS
        }
        self._live: dict[str, bool] = {}
        for name, field in (x for model in models for x in _leaves(model, given)):
            value = (
                None
                if field.is_required()
                else field.get_default(call_default_factory=True)
            )
            if name in given:
                value = [] if given[name] is None else given[name]
            descriptor = _descriptor(name, field)
            self._live[name] = descriptor.additional_constraints != LOCKED
            node.declare_parameter(
                name, _plain(value), descriptor, ignore_override=True
            )
        self._unknown = {name: x for name, x in given.items() if name not in self._live}
        self.compute_design: Callable[[Sequence[Any]], Any] = lambda configurations: (
            configurations
        )
        self.apply_design: Callable[[Any], None] | None = None
        self.version = 0
        self._designed: Callable[[], Any] | None = (
            None  # of the change that is under way
        )
        self.report_refusal: Callable[[str, Exception], None] = lambda name, error: None
        node.add_on_set_parameters_callback(self._on_set)

    def build_configurations(
        self, changes: Mapping[str, Any] | None = None
    ) -> list[Any]:
        """Return a configuration per model, with changes by name; ConfigError of all at once."""
        present = {name: self.present_value(name) for name in self._live} | dict(
            changes or {}
        )
        values: dict[str, Any] = {}
        for name, value in [*present.items(), *self._unknown.items()]:
            if value is not None:
                for part in reversed(name.split('.')):
                    value = {part: value}
                values = merge(values, value)
        known = sorted(key for model in self._models for key in model.model_fields)

        def refuse(key: str) -> None:
            raise ConfigError(
                key, f'a known parameter ({", ".join(known)})', f"unknown '{key}'"
            )

        return run_all_checks(
            *(partial(refuse, key) for key in values if key not in known),
            *(
                partial(
                    validate,
                    model,
                    {x: values[x] for x in model.model_fields if x in values},
                )
                for model in self._models
            ),
        )

    def present_value(self, name: str) -> Any:
        """Return the present value of a parameter, None if it has none."""
        return _plain(self._node.get_parameter_or(name).value)

    def design_change(self, parameters: Sequence[Parameter]) -> Any:
        """Return what a change leads to, or raise; another thread may wait for it."""
        changes = self._known(parameters)
        for name, value in changes.items():
            if (
                value is None
                or not self._live[name]
                and value != self.present_value(name)
            ):
                raise ConfigError(
                    name, hint=f'{LOCKED}; it stays {self.present_value(name)}'
                )
        return self.compute_design(self.build_configurations(changes))

    def apply(
        self,
        parameters: Sequence[Parameter],
        designed: Callable[[], Any],
    ) -> SetParametersResult:
        """Change parameters at once; `designed` returns or raises as `design_change` did."""
        self._designed = designed
        try:
            return self._node.set_parameters_atomically(parameters)
        except ParameterNotDeclaredException as error:
            return SetParametersResult(successful=False, reason=str(error))
        finally:
            self._designed = None

    def _known(self, parameters: Sequence[Parameter]) -> dict[str, Any]:
        return {x.name: _plain(x.value) for x in parameters if x.name in self._live}

    def _on_set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        changes = self._known(parameters)
        if self.apply_design is None or not changes:
            return SetParametersResult(successful=True)
        designed = self._designed or partial(self.design_change, parameters)
        try:
            self.apply_design(designed())
            self.version += 1
        except Exception as error:
            if not isinstance(
                error, MulticontactError
            ):  # a mistake here: not for the arm to pay
                self._node.get_logger().error(traceback.format_exc())
            self.report_refusal(next(iter(changes)), error)
            return SetParametersResult(
                successful=False, reason=str(error) or repr(error)
            )
        return SetParametersResult(successful=True)


def _plain(value: Any) -> Any:
    """Return an array as a list."""
    return (
        value if isinstance(value, (bool, int, float, str, NoneType)) else list(value)
    )


def find_parameter_folder(name: str, node_name: str, arguments: Sequence[str]) -> Path:
    """
    Return where a relative path starts that is the value of a parameter of a node.

    That is the folder of the last of the parameter files among some command-line arguments that
    sets it; the current folder, if the command line itself does, or nothing.
    """
    folder = Path()
    for option, value in zip(arguments, arguments[1:]):
        if option == '--params-file' and sets_parameter(Path(value), node_name, name):
            folder = Path(value).resolve().parent
    by_itself = any(
        option in ('-p', '--param') and value.split(':=')[0].rpartition(':')[2] == name
        for option, value in zip(arguments, arguments[1:])
    )
    return Path() if by_itself else folder


def load_parameters(node: Node, *models: type[Config]) -> list[Any]:
    """Declare the parameters of models, which stay as they are; return the configurations."""
    parameters = ParameterSet(node, *models)
    configurations = parameters.build_configurations()
    parameters.apply_design = lambda configurations: None
    return configurations
