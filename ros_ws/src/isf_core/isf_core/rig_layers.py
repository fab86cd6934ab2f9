"""A rig file that tells only what differs from another one: ``based_on`` names the rig (or file) below it.

Fields replace those below, mappings are merged field by field, so that an identified ``servo.bandwidth`` leaves
``servo.rate`` as it is. What was identified later stands above what was identified before, in as many files as wanted.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from isf_core import yaml_file
from isf_core.errors import ErrorCode, IsfError
from isf_core.shared_files import find_named

BASE = "based_on"

MOST_LAYERS = 20


def layered_text(path: Path) -> str:
    """Text of the rig file at ``path`` with everything it is based on; unchanged when it stands alone.

    Raises IsfError as :func:`isf_core.yaml_file.read`, and FILE_FIELD for files that are based on each other.
    """
    text = yaml_file.read(path)
    layers = []
    here = path
    while (layer := _mapping(text)) is not None and BASE in layer:
        layers.append(layer)
        below = layer.pop(BASE)
        if not isinstance(below, str) or len(layers) > MOST_LAYERS:
            raise IsfError(
                ErrorCode.FILE_FIELD,
                f"is {below!r}, or one of more than {MOST_LAYERS} files that are based on each other",
                where=f"{path}: {BASE}",
                advice="name a rig, or a rig file relative to this one, that does not come back to it",
            )
        here = find_named("rigs", below, here.parent)
        text = yaml_file.read(here)
    if not layers or layer is None:
        return text
    merged = layer
    for upper in reversed(layers):
        merged = _merged(merged, upper)
    for tool in ("tool_1", "tool_2"):
        part = merged.get(tool)
        if isinstance(part, dict) and isinstance(part.get("error_map"), str):
            part["error_map"] = str(_map_path(part["error_map"], tool, here, layer, path))
    return yaml.safe_dump(merged, sort_keys=False, allow_unicode=True, width=10_000)


def _map_path(name: str, tool: str, lowest: Path, below: dict[str, Any], top: Path) -> Path:
    """A map stands beside the file that names it: the lowest one, unless a layer replaces it."""
    own = below.get(tool)
    return (lowest if isinstance(own, dict) and own.get("error_map") == name else top).parent / name


def _mapping(text: str) -> dict[str, Any] | None:
    """The mapping of ``text``, None where it is none: the checks of :mod:`isf_core.yaml_file` say why."""
    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError:
        return None
    return data if isinstance(data, dict) else None


def _merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    result = dict(below)
    for key, value in above.items():
        present = result.get(key)
        result[key] = _merged(present, value) if isinstance(present, dict) and isinstance(value, dict) else value
    return result
