"""Node parameters described once, as a frozen dataclass: name, type, default, unit, range and text.

What is declared here is what ``ros2 param describe`` shows, what the reference page lists (scripts/field_tables.py) and
what the parameter files in ``config`` of each package hold.
"""

from __future__ import annotations

import math
from dataclasses import Field, field, fields
from typing import Any, TypeVar

from isf_core.errors import ErrorCode, IsfError
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterValueException, ParameterException
from rclpy.node import Node

Parameters = TypeVar("Parameters")

LARGEST_INTEGER = 2**63 - 1
"""End of the range of an integer that has none: what a parameter can hold."""


def parameter(
    default: Any,
    description: str,
    *,
    unit: str = "",
    read_only: bool = True,
    minimum: float = -math.inf,
    maximum: float = math.inf,
    choices: tuple[str, ...] = (),
) -> Any:
    """Dataclass field of a node parameter; ``read_only``: fixed when the node starts.

    A number must lie in ``minimum`` .. ``maximum`` (both included), a text must be one of ``choices`` if there are any.
    """
    metadata = {
        "description": description,
        "unit": unit,
        "read_only": read_only,
        "minimum": minimum,
        "maximum": maximum,
        "choices": choices,
    }
    return field(default=default, metadata=metadata)


def descriptor(item: Field[Any]) -> ParameterDescriptor:
    """What ``ros2 param describe`` shows of the parameter of a dataclass field."""
    said = item.metadata
    found = ParameterDescriptor(
        description=f"{said['description']} [{said['unit']}]" if said["unit"] else said["description"],
        read_only=said["read_only"],
        additional_constraints=f"one of {', '.join(said['choices'])}" if said["choices"] else "",
    )
    lowest, highest = said["minimum"], said["maximum"]
    if isinstance(item.default, float):
        found.floating_point_range = [FloatingPointRange(from_value=float(lowest), to_value=float(highest))]
    elif isinstance(item.default, int) and not isinstance(item.default, bool):
        ends = (
            (-LARGEST_INTEGER if lowest == -math.inf else int(lowest)),
            (LARGEST_INTEGER if highest == math.inf else int(highest)),
        )
        found.integer_range = [IntegerRange(from_value=ends[0], to_value=ends[1])]
    return found


def declare(node: Node, kind: type[Parameters]) -> None:
    """Declare every field of the dataclass ``kind`` as a parameter of ``node``.

    A value out of its range is taken here, so that the node can say with a code why it cannot be configured.

    Raises IsfError FILE_FIELD when a parameter was given a value of another type.
    """
    for item in fields(kind):  # type: ignore[arg-type]
        described = descriptor(item)
        default = list(item.default) if isinstance(item.default, tuple) else item.default
        try:
            try:
                node.declare_parameter(item.name, default, described)
            except InvalidParameterValueException:
                described.floating_point_range, described.integer_range = [], []
                node.declare_parameter(item.name, default, described)
        except ParameterException as error:
            raise IsfError(
                ErrorCode.FILE_FIELD, str(error), where=f"parameter {item.name}", advice=f"e.g. {item.default}"
            ) from error


def read(node: Node, kind: type[Parameters], changes: dict[str, Any] | None = None) -> Parameters:
    """The present values of the parameters declared by :func:`declare`, or with ``changes`` of some of them.

    Raises IsfError FILE_FIELD when one is not finite, out of its range, or none of its choices.
    """
    names = [item.name for item in fields(kind)]  # type: ignore[arg-type]
    values = {name: node.get_parameter(name).value for name in names} | (changes or {})
    for item in fields(kind):  # type: ignore[arg-type]
        _check(item, values[item.name])
    return kind(**{name: values[name] for name in names})


def _check(item: Field[Any], value: Any) -> None:
    said = item.metadata
    where, advice = f"parameter {item.name}", said["description"]
    if isinstance(value, str) and said["choices"] and value not in said["choices"]:
        what = f"'{value}' is none of {', '.join(said['choices'])}"
        raise IsfError(ErrorCode.FILE_FIELD, what, where=where, advice=advice)
    # infinite is a value of its own for limits that are off, where the range does not end
    if isinstance(value, int | float) and not said["minimum"] <= value <= said["maximum"]:
        unit = f" {said['unit']}" if said["unit"] else ""
        what = f"{value:g} is not within {said['minimum']:g} to {said['maximum']:g}{unit}"
        raise IsfError(ErrorCode.FILE_FIELD, what, where=where, advice=advice)
