"""Node parameters described once, as a frozen dataclass: name, type, default, text and read-only flag."""

from __future__ import annotations

from dataclasses import field, fields
from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

Parameters = TypeVar("Parameters")


def parameter(default: Any, description: str, *, read_only: bool = True) -> Any:
    """Dataclass field of a node parameter; ``read_only``: fixed when the node starts."""
    return field(default=default, metadata={"description": description, "read_only": read_only})


def declare(node: Node, kind: type[Parameters]) -> None:
    """Declare every field of the dataclass ``kind`` as a parameter of ``node``."""
    for item in fields(kind):  # type: ignore[arg-type]
        descriptor = ParameterDescriptor(
            description=item.metadata.get("description", ""), read_only=item.metadata.get("read_only", True)
        )
        node.declare_parameter(item.name, item.default, descriptor)


def read(node: Node, kind: type[Parameters]) -> Parameters:
    """The present values of the parameters declared by :func:`declare`."""
    return kind(**{item.name: node.get_parameter(item.name).value for item in fields(kind)})  # type: ignore[arg-type]
