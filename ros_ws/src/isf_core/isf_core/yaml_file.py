"""YAML files checked against a pydantic model: every fault is named with file, line, field and advice."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from isf_core.errors import ErrorCode, IsfError
from isf_core.quantity import FROM_FILE

Model = TypeVar("Model", bound=BaseModel)


def read(path: Path) -> str:
    """Text of a file; IsfError FILE_NOT_FOUND or FILE_SYNTAX when it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path), advice="check the path; it is relative to here"
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        raise IsfError(ErrorCode.FILE_SYNTAX, f"cannot be read as text: {error}", where=str(path)) from error


def parse(text: str, model: type[Model], name: str) -> Model:
    """Model from YAML ``text``; ``name`` is the file named in errors.

    Raises
    ------
    IsfError : FILE_SYNTAX (not YAML, not a mapping), FILE_UNIT (missing or wrong unit),
        FILE_FIELD (unknown, missing or out-of-range field)
    """
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{name}:{mark.line + 1}" if mark else name
        problem = getattr(error, "problem", None) or "not valid YAML"
        advice = "check indentation and colons"
        raise IsfError(ErrorCode.FILE_SYNTAX, str(problem), where=where, advice=advice) from error
    if not isinstance(data, dict) or root is None:
        raise IsfError(
            ErrorCode.FILE_SYNTAX, "is empty or not a mapping of fields", where=name, advice="start from an example"
        )
    try:
        return model.model_validate(data, context=FROM_FILE)
    except ValidationError as error:
        raise _explain(error, model, root, name) from error


def load(path: Path, model: type[Model]) -> Model:
    """Model from the YAML file at ``path``; raises IsfError as :func:`read` and :func:`parse`."""
    return parse(read(path), model, str(path))


def _explain(error: ValidationError, model: type[BaseModel], root: yaml.Node, name: str) -> IsfError:
    # an unknown field is usually the reason why another one is missing: name it first
    faults = sorted(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden")
    first = faults[0]
    place = first["loc"]
    field = ".".join(str(part) for part in place)
    advice = ""
    code = ErrorCode.FILE_FIELD
    if first["type"] == "extra_forbidden":
        what = f"unknown field '{field}'"
        near = difflib.get_close_matches(str(place[-1]), _known_fields(model, place[:-1]), n=1)
        known = ", ".join(_known_fields(model, place[:-1]))
        advice = f"did you mean '{near[0]}'?" if near else f"known here: {known}"
    elif first["type"] == "missing":
        what = f"field '{field}' is missing"
        advice = "add it; see the examples"
    else:
        what = f"{field}: {first['msg']}"
        if first["type"] == "unit":
            code = ErrorCode.FILE_UNIT
            advice = "quantities in files carry their unit"
    if len(faults) > 1:
        advice = f"{advice}; {len(faults) - 1} more fault(s) in this file".lstrip("; ")
    return IsfError(code, what, where=f"{name}:{_line(root, place)}", advice=advice)


def _known_fields(model: type[BaseModel], place: tuple[int | str, ...]) -> list[str]:
    current: Any = model
    for part in place:
        info = current.model_fields.get(part) if hasattr(current, "model_fields") else None
        current = info.annotation if info else None
        for choice in get_args(current):  # "ToolSpec | None" -> ToolSpec
            if hasattr(choice, "model_fields"):
                current = choice
    return list(current.model_fields) if hasattr(current, "model_fields") else []


def _line(node: yaml.Node, place: tuple[int | str, ...]) -> int:
    """Line (1-based) of the deepest node of ``place`` that exists."""
    line = node.start_mark.line
    for part in place:
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                if key.value == str(part):
                    line, node = key.start_mark.line, value
                    break
            else:
                break
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            line = node.start_mark.line
        else:
            break
    return line + 1
