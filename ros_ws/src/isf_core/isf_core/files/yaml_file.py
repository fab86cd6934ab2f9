"""YAML files checked against a pydantic model: every fault is named with file, line, field and advice.

Models are frozen, strict about unknown fields and carry the provenance of constants. Material and rig files are found
at a path given by the user, else in the package's share folder.
"""

from __future__ import annotations

import difflib
import math
import os
import sysconfig
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, cast, get_args, get_origin

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from isf_core.errors import ErrorCode, IsfError
from isf_core.files.bounded import read_text
from isf_core.files.quantity import FROM_FILE, LONGEST_SHOWN, Reading


class FieldError(ValueError):
    """A field that does not go with others; raised by validators, told with the line of ``field`` ("control.rate")."""

    def __init__(self, what: str, *, field: str, advice: str) -> None:
        super().__init__(what)
        self.what, self.field, self.advice = what, field, advice


class FileModel(BaseModel):
    """A part of a YAML file; unknown fields are errors, and truth values where a number is wanted."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_value(cls, value: Any, info: ValidationInfo) -> Any:
        """Python counts with true as with 1; who writes it for a gain means something else."""
        if info.context and info.context.get("from_file") and info.field_name is not None and _has_truth(value):
            about = cls.model_fields[info.field_name]
            plain = next(_readings([*about.metadata, about.annotation]), None) is None  # quantities say it themselves
            types = set(_types(about.annotation))
            if plain and bool not in types and types & {int, float}:
                raise PydanticCustomError("truth_value", "true and false are no numbers")
        return value


def _has_truth(value: Any) -> bool:
    """True for a truth value and for a list that has one, at any depth."""
    return isinstance(value, bool) or (isinstance(value, list) and any(map(_has_truth, value)))


def _types(annotation: Any) -> Iterator[Any]:
    """What ``annotation`` is made of: of ``tuple[int, float] | None`` the types and the None."""
    parts = get_args(annotation)
    if not parts:
        yield annotation
    for part in parts:
        yield from _types(part)


Model = TypeVar("Model", bound=BaseModel)


LONGEST = 100_000
"""Characters of a file: written by people, and read by a parser that takes seconds for more."""
MOST_NODES = 100_000
"""Fields and values of a file, aliases written out."""


def read(path: Path) -> str:
    """Text of a YAML file; raises IsfError FILE_NOT_FOUND, and FILE_SYNTAX when it cannot be read."""
    try:
        text = read_text(path, 4 * LONGEST)
    except FileNotFoundError as error:
        raise IsfError(
            ErrorCode.FILE_NOT_FOUND, "no such file", where=str(path), advice="check the path; it is relative to here"
        ) from error
    except OSError as error:
        raise IsfError(ErrorCode.FILE_SYNTAX, f"cannot be read as text: {error.strerror}", where=str(path)) from error
    return text


class _TwiceError(yaml.MarkedYAMLError):
    """A key that a mapping has twice."""


class _Loader(yaml.SafeLoader):
    """The safe loader, but for keys that a mapping has twice, of which it would take the last one without a word, and
    for null characters, which no name of a file can have.

    Keys are looked for while the nodes are made. A merge (<<) puts its fields among those of the mapping only later, so
    that fields written in the mapping may stand in place of merged ones.
    """

    def compose_scalar_node(self, anchor: Any) -> yaml.ScalarNode:
        node: yaml.ScalarNode = super().compose_scalar_node(anchor)  # type: ignore[no-untyped-call]
        if "\0" in node.value:
            raise yaml.MarkedYAMLError(problem="a text has a null character", problem_mark=node.start_mark)
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node: yaml.MappingNode = super().compose_mapping_node(anchor)  # type: ignore[no-untyped-call]
        first: dict[Any, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue  # no name of a field: construction refuses it
            merge = key.tag == "tag:yaml.org,2002:merge"
            value = key.value if merge else self.construct_object(key)  # type: ignore[no-untyped-call]
            for same in {value, str(value)}:  # 1 and 01 are one number, 1 and "1" one field of a model
                if same in first:
                    what = f"'{key.value[:LONGEST_SHOWN]}' is there twice, first in line {first[same] + 1}"
                    raise _TwiceError(problem=what, problem_mark=key.start_mark)
            first |= dict.fromkeys((value, str(value)), key.start_mark.line)
        return node


def content(text: str, name: str) -> Any:
    """What the YAML ``text`` holds: a mapping, a list, a value, None where it is empty; ``name`` of it in errors.

    Every text from outside is read here: files, options of commands, jobs in messages and bags.

    Raises
    ------
    IsfError : FILE_SYNTAX (not YAML, a key twice in one mapping, nested too deeply, more than LONGEST characters or
        MOST_NODES fields with the aliases written out, as a merge does), FILE_FIELD (a date or number that is none)
    """
    return _content(text, name)[1]


def merged(fields: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """``fields`` with those of ``change`` in their place, sections field by field; one that is null is left out (as RFC
    7396 merges JSON)."""
    result = dict(fields)
    for name, value in change.items():
        old = result.get(name)
        if value is None:
            result.pop(name, None)
        elif isinstance(value, Mapping):
            result[name] = merged(old if isinstance(old, Mapping) else {}, value)
        else:
            result[name] = value
    return result


def _content(text: str, name: str) -> tuple[yaml.Node | None, Any]:
    """The nodes of the ``text``, with their places, and what it holds."""
    if len(text) > LONGEST:
        advice = "leave out what does not belong there"
        raise IsfError(ErrorCode.FILE_SYNTAX, f"is longer than {LONGEST:,} characters", where=name, advice=advice)
    try:
        loader = _Loader(text)
        root = loader.get_single_node()  # type: ignore[no-untyped-call]
        if root is None:
            return None, None
        if _written_out(root, {}) > MOST_NODES:  # construction of merges would write them out
            what = f"stands for more than {MOST_NODES:,} fields, its aliases (*name) written out"
            raise IsfError(ErrorCode.FILE_SYNTAX, what, where=name, advice="write out what is meant")
        return root, loader.construct_document(root)  # type: ignore[no-untyped-call]
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{name}:{mark.line + 1}" if mark else name
        problem = getattr(error, "problem", None) or "not valid YAML"
        twice = isinstance(error, _TwiceError)
        advice = "leave out the one that is not meant" if twice else "check indentation and colons"
        raise IsfError(ErrorCode.FILE_SYNTAX, str(problem), where=where, advice=advice) from error
    except ValueError as error:  # what looks like a date or a number and is none
        what = f"a value cannot be read: {error}"
        raise IsfError(ErrorCode.FILE_FIELD, what, where=name, advice="put a text in quotes") from error
    except RecursionError as error:
        what = "is nested too deeply"
        raise IsfError(ErrorCode.FILE_SYNTAX, what, where=name, advice="start from an example") from error


def _written_out(node: yaml.Node, known: dict[int, float]) -> float:
    """Number of nodes in ``node``, each as often as it is named; infinite where it holds itself."""
    if id(node) not in known:
        known[id(node)] = math.inf
        parts: list[yaml.Node] = []
        if isinstance(node, yaml.MappingNode):
            parts = [part for pair in node.value for part in pair]
        elif isinstance(node, yaml.SequenceNode):
            parts = node.value
        known[id(node)] = 1.0 + sum(_written_out(part, known) for part in parts)
    return known[id(node)]


def parse(text: str, model: type[Model], name: str, layers: Sequence[tuple[str, str]] = ()) -> Model:
    """Model from YAML ``text``; ``name`` is the file named in errors.

    ``layers``: names and texts of the files that ``text`` was merged from, the uppermost first; an error names the line
    of the one that has the field.

    Raises
    ------
    IsfError : as :func:`content`; FILE_SYNTAX (not a mapping), FILE_UNIT (missing or wrong unit), FILE_FIELD (unknown,
        missing or out-of-range field)
    """
    root, data = _content(text, name)
    if not isinstance(data, dict) or root is None:
        raise IsfError(
            ErrorCode.FILE_SYNTAX, "is empty or not a mapping of fields", where=name, advice="start from an example"
        )
    try:
        return model.model_validate(data, context=FROM_FILE)
    except ValidationError as error:
        nodes = [(file, yaml.compose(layer, Loader=yaml.SafeLoader)) for file, layer in layers]
        files = [(file, node) for file, node in nodes if node is not None]
        raise _explain(error, model, files or [(name, root)]) from error


def load(path: Path, model: type[Model]) -> Model:
    """Model from the YAML file at ``path``; raises IsfError as :func:`read` and :func:`parse`."""
    return parse(read(path), model, str(path))


def _explain(error: ValidationError, model: type[BaseModel], files: Sequence[tuple[str, yaml.Node]]) -> IsfError:
    # an unknown field is usually the reason why another one is missing: name it first; of a field that takes a word
    # or a quantity ("auto" or a force) the quantity tells more; a list is too short, too, where its items are refused
    rank = {"extra_forbidden": 0, "literal_error": 2, "too_short": 3}
    faults = sorted(error.errors(), key=lambda fault: rank.get(fault["type"], 1))
    first = faults[0]
    place = first["loc"] if first["type"] == "extra_forbidden" else _without_choice(model, first["loc"])
    field = ".".join(str(part + 1 if isinstance(part, int) else part) for part in place)  # people count from 1
    advice = ""
    code = ErrorCode.FILE_FIELD
    if first["type"] == "extra_forbidden":
        what = f"unknown field '{field}'"
        advice = _meant(str(place[-1]), place[:-1], model)
    elif first["type"] == "missing":
        what = f"field '{field}' is missing"
        advice = _to_add(str(place[-1]), place[:-1], model)
    else:
        what = f"{field}: {_bound(first, model) or first['msg'].removeprefix('Value error, ')}"
        cause = first.get("ctx", {}).get("error")
        if isinstance(cause, FieldError):
            place = tuple(cause.field.split("."))
            what, advice = f"{cause.field}: {cause.what}", cause.advice
        if first["type"] == "unit":
            code = ErrorCode.FILE_UNIT
            advice = "quantities in files carry their unit"
        if first["type"] == "truth_value":
            advice = "write a number"
        words = [fault for fault in faults[1:] if fault["type"] == "literal_error"]
        if any(_without_choice(model, fault["loc"]) == place for fault in words):
            advice = f"{advice}; or {words[0]['ctx']['expected']}".lstrip("; ")
    more = len({_without_choice(model, fault["loc"]) for fault in faults}) - 1
    if more > 0:
        advice = f"{advice}; {more} more error(s) in this file".lstrip("; ")
    found = [(*_line(root, place), file) for file, root in files]
    _, line, file = max(found, key=lambda one: one[0])  # of files that know as much the first
    return IsfError(code, what, where=f"{file}:{line}", advice=advice)


def _meant(name: str, place: tuple[int | str, ...], model: type[BaseModel]) -> str:
    """Advice for the unknown field ``name`` in the section ``place``: a field there, or one of another section."""
    section = _section(model, place)
    here = list(section.model_fields) if section is not None else []
    elsewhere = [path for path in _paths(model) if path.rpartition(".")[2] == name][:2]
    near = difflib.get_close_matches(name, here, n=1, cutoff=0.75) or elsewhere
    near = near or difflib.get_close_matches(name, here, n=1)
    if near:
        return f"did you mean {' or '.join(repr(item) for item in near)}?"
    return f"known here: {', '.join(here)}"


def _to_add(name: str, place: tuple[int | str, ...], model: type[BaseModel]) -> str:
    """Advice for the field ``name`` that the section ``place`` lacks: what is written there."""
    section = _section(model, place)
    info = section.model_fields.get(name) if section is not None else None
    annotation = info.annotation if info is not None else None
    reading = next(_readings([*(info.metadata if info is not None else ()), annotation]), None)
    words = [str(word) for word in get_args(annotation)] if get_origin(annotation) is Literal else []
    if reading is not None:
        return f"add '{name}', a number in {reading.unit}"
    if words:
        return f"add '{name}', one of {', '.join(words)}"
    if (inner := _model_in(annotation)) is not None:
        needed = [field for field, one in inner.model_fields.items() if one.is_required()]
        return f"add the section '{name}', with {', '.join(needed)}" if needed else f"add the section '{name}'"
    return f"add '{name}'"


_BOUNDS = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "greater than or equal to"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "less than or equal to"),
}


def _bound(fault: Any, model: type[BaseModel]) -> str:
    """What is said of a quantity out of its bounds, in the unit people read; empty for any other fault."""
    key, words = _BOUNDS.get(fault["type"], ("", ""))
    names = [part for part in _without_choice(model, fault["loc"]) if isinstance(part, str)]
    section = _section(model, tuple(names[:-1]))
    info = section.model_fields.get(names[-1]) if section is not None and names else None
    if not key or info is None:
        return ""
    reading = next(_readings([*info.metadata, info.annotation]), None)
    if reading is None:
        return ""
    given = fault["input"]  # as in the file where the field may be left out, else in SI already
    value = reading.text(given) if isinstance(given, float | int) else str(given)
    return f"{value} must be {words} {reading.text(float(fault['ctx'][key]))}"


def _without_choice(model: type[BaseModel], place: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """``place`` without the name of the choice that pydantic adds for a field of several types."""
    for k, part in enumerate(place):
        section = _section(model, place[:k])
        if isinstance(part, str) and section is not None and part not in section.model_fields:
            return place[:k]
        if isinstance(part, str) and section is None:
            return place[:k]
    return place


def _readings(parts: Iterable[Any]) -> Iterator[Reading]:
    """Units among the metadata and inside the annotations ``parts``: of ``Length | None``, ``tuple[Angle, ...]``."""
    for part in parts:
        if isinstance(part, Reading):
            yield part
        yield from _readings([*getattr(part, "__metadata__", ()), *get_args(part)])


def _section(model: type[BaseModel], place: tuple[int | str, ...]) -> type[BaseModel] | None:
    """The model of the section at ``place``; numbers are places in a list of sections."""
    current: type[BaseModel] | None = model
    for part in place:
        if isinstance(part, str):
            info = current.model_fields.get(part) if current is not None else None
            current = _model_in(info.annotation) if info else None
    return current


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The section that a field holds: ``ToolSpec | None`` and ``tuple[ForceRule, ...]`` as well as the model itself."""
    if hasattr(annotation, "model_fields"):
        return cast("type[BaseModel]", annotation)
    return next((found for choice in get_args(annotation) if (found := _model_in(choice)) is not None), None)


def _paths(model: type[BaseModel], before: str = "") -> Iterator[str]:
    """All fields of a file with their sections: "control.support_force"."""
    for name, info in model.model_fields.items():
        yield before + name
        if (section := _model_in(info.annotation)) is not None:
            yield from _paths(section, f"{before}{name}.")


def _line(node: yaml.Node, place: tuple[int | str, ...]) -> tuple[int, int]:
    """How many parts of ``place`` exist, and the line (1-based) of the deepest one."""
    line = node.start_mark.line
    for depth, part in enumerate(place):
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                if key.value == str(part):
                    line, node = key.start_mark.line, value
                    break
            else:
                return depth, line + 1
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            line = node.start_mark.line
        else:
            return depth, line + 1
    return len(place), line + 1


def line_of(text: str, place: tuple[int | str, ...]) -> int:
    """Line (1-based) in the YAML ``text`` of the field at ``place``, or of the deepest part of it that is there."""
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    return 1 if node is None else _line(node, place)[1]


def share_directory() -> Path:
    """``share/isf_core`` of the ROS package or wheel that is installed, else the package's own source tree."""
    schemes = (sysconfig.get_default_scheme(), f"{os.name}_user")
    prefixes = [item for item in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if item]
    for prefix in (*prefixes, *(sysconfig.get_path("data", scheme) for scheme in schemes)):
        candidate = Path(prefix) / "share" / "isf_core"
        if (candidate / "materials").is_dir():
            return candidate
    return Path(__file__).resolve().parents[2]


def find_named(folder: str, name_or_path: str, base: Path | None = None) -> Path:
    """File for a name in ``share/isf_core/<folder>`` or a path relative to ``base``.

    Raises
    ------
    IsfError : FILE_NOT_FOUND, with the names that exist
    """
    if not is_path(name_or_path):
        return find_shipped(folder, name_or_path)
    path = Path(name_or_path)
    path = path if path.is_absolute() or base is None else base / path
    if not _is_file(path):
        raise _not_in(folder, name_or_path, path)
    return path


def find_shipped(folder: str, name: str) -> Path:
    """File for a name in ``share/isf_core/<folder>``, never one beside it: for names from a bag, which opens no files.

    Raises
    ------
    IsfError : FILE_NOT_FOUND, with the names that exist
    """
    path = share_directory() / folder / f"{name}.yaml"
    if is_path(name) or Path(name).name != name or not _is_file(path):
        raise _not_in(folder, name, path)
    return path


def _is_file(path: Path) -> bool:
    """False also for a name that no file can have: longer than the system takes, or with a null character."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_path(name: str) -> bool:
    """True for a path of a file, False for a name in the share folder."""
    return name.endswith((".yaml", ".yml"))


def _not_in(folder: str, name: str, path: Path) -> IsfError:
    if len(name) > LONGEST_SHOWN:
        name, path = f"{name[:LONGEST_SHOWN]}...", path.with_name("...")
    known = ", ".join(sorted(p.stem for p in (share_directory() / folder).glob("*.yaml")))
    return IsfError(ErrorCode.FILE_NOT_FOUND, f"no '{name}' in {folder}", where=str(path), advice=f"known: {known}")
