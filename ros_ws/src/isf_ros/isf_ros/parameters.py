"""Node parameters described once, as a frozen dataclass: name, type, default, text and read-only flag."""

from __future__ import annotations

import math
from dataclasses import field, fields
from typing import Any, TypeVar

from isf_core.errors import ErrorCode, IsfError
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node

Parameters = TypeVar("Parameters")


def parameter(
    default: Any,
    description: str,
    *,
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
        "read_only": read_only,
        "minimum": minimum,
        "maximum": maximum,
        "choices": choices,
    }
    return field(default=default, metadata=metadata)


def declare(node: Node, kind: type[Parameters]) -> None:
    """Declare every field of the dataclass ``kind`` as a parameter of ``node``.

    Raises IsfError FILE_FIELD when a parameter was given a value of another type.
    """
    for item in fields(kind):  # type: ignore[arg-type]
        descriptor = ParameterDescriptor(
            description=item.metadata.get("description", ""), read_only=item.metadata.get("read_only", True)
        )
        try:
            node.declare_parameter(item.name, item.default, descriptor)
        except ParameterException as error:
            raise IsfError(
                ErrorCode.FILE_FIELD, str(error), where=f"parameter {item.name}", advice=f"e.g. {item.default}"
            ) from error


def read(node: Node, kind: type[Parameters]) -> Parameters:
    """The present values of the parameters declared by :func:`declare`.

    Raises IsfError FILE_FIELD when one is not finite, out of its range, or none of its choices.
    """
    values = {item.name: node.get_parameter(item.name).value for item in fields(kind)}  # type: ignore[arg-type]
    for item in fields(kind):  # type: ignore[arg-type]
        _check(item.name, values[item.name], **{key: item.metadata[key] for key in _LIMITS if key in item.metadata})
    return kind(**values)


_LIMITS = ("description", "minimum", "maximum", "choices")


def _check(
    name: str,
    value: Any,
    description: str = "",
    minimum: float = -math.inf,
    maximum: float = math.inf,
    choices: tuple[str, ...] = (),
) -> None:
    """The ``description``, which begins with the unit, goes into the advice."""
    where = f"parameter {name}"
    if isinstance(value, str) and choices and value not in choices:
        what = f"'{value}' is none of {', '.join(choices)}"
        raise IsfError(ErrorCode.FILE_FIELD, what, where=where, advice=description)
    # infinite is a value of its own for limits that are off, where the range does not end
    if isinstance(value, int | float) and not minimum <= value <= maximum:
        what = f"{value:g} is not within {minimum:g} to {maximum:g}"
        raise IsfError(ErrorCode.FILE_FIELD, what, where=where, advice=description)
