"""Tables of fields and parameters in the manual, and parameter files: ``./isf python scripts/field_tables.py``.

All are made from the sources. A page asks for a table by a pair of comments, ``<!-- fields: module.Class -->`` and
``<!-- end -->``; what stands between them is replaced. The tables of docs/reference/nodes.md give a file for each node,
``config/NODE.yaml`` of its package, with every parameter at its default. ``--check`` writes nothing and ends with 1
where something is not in step.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import math
import re
import sys
import textwrap
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from isf_core.files.quantity import Reading
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

DOCS = Path(__file__).resolve().parents[1] / "docs"
MARK = re.compile(r"(<!-- fields: ([\w.]+) -->\n).*?(<!-- end -->)", re.DOTALL)
WORDS = {"Literal": "", "NoneType": "none", "str": "text", "int": "integer", "float": "number", "bool": "true or false"}


def field_docstrings(kind: type) -> dict[str, str]:
    """Name of a field to the text that stands below it in the source, in one line."""
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(body, ast.ClassDef)
    found = {}
    for node, below in zip(body.body, body.body[1:], strict=False):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and isinstance(below, ast.Expr):
            found[node.target.id] = " ".join(str(ast.literal_eval(below.value)).split())
    return found


def written_type(kind: type, name: str) -> str:
    """The annotation as a reader of a file understands it: units are those of the examples."""
    source = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(source, ast.ClassDef)
    for node in source.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == name:
            return _words(node.annotation)
    return ""


def _words(node: ast.expr) -> str:
    if isinstance(node, ast.BinOp):
        parts = [_words(node.left), _words(node.right)]
        return " or ".join(part for part in parts if part != "none")
    if isinstance(node, ast.Subscript):
        outer = _words(node.value)
        inner = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if outer == "tuple":
            many = any(isinstance(item, ast.Constant) and item.value is Ellipsis for item in inner)
            return f"list of {_words(inner[0])}" if many else f"{len(inner)} x {_words(inner[0])}"
        if outer == "dict":
            return "names and texts"
        if outer == "Annotated":
            return _words(inner[0])
        return ", ".join(_words(item) for item in inner)
    if isinstance(node, ast.Constant):
        return "none" if node.value is None else f"`{node.value}`"
    text = ast.unparse(node)
    return WORDS.get(text, text if text in ("tuple", "Annotated", "Literal") else _named(text))


SECTIONS = (
    *("ForceRule", "Clamp", "ToolAxis", "Servo", "LoadCell", "SpindleCells", "Limits", "HydraulicLegs", "LegFault"),
    *("FuzzyLoop", "FeedforwardLoop", "Valve", "Cylinder", "Supply", "Encoder", "Cables"),
)


def _named(text: str) -> str:
    """A class of its own is a section, a quantity is called by its name."""
    if text.endswith("Spec") or text in SECTIONS:
        return "section"
    return {
        "MeshUnit": "`m`, `cm`, `mm`, `in`",
        "SupportForce": "force",
        "RuleForce": "force",
        "SpindleSpeed": "spindle speed",
        "ErrorTable": "rows of position and error",
        "FlowTable": "rows of plastic strain and stress",
        "EdgeStiffness": "force per displacement and length",
        "EdgeForce": "force per length",
        "VoltageGain": "force per voltage",
        "CellFault": "section",
        "Controller": "`fuzzy`, `feedforward`",
        "Six": "6 x length",
        "HeatLoss": "power per temperature",
        "HeatCapacity": "energy per temperature",
        "Resistance": "force per speed",
        "Channel": "`x1`, `y1`, `z1`, ... `z3`",
    }.get(text, text.lower())


UNITS = {
    "length": (1e3, "mm"),
    "angle": (180 / math.pi, "deg"),
    "stress": (1e-9, "GPa"),
    "speed": (1e3, "mm/s"),
    "acceleration": (1e3, "mm/s^2"),
    "spindle speed": (30 / math.pi, "rpm"),
    "force": (1.0, "N"),
    "frequency": (1.0, "Hz"),
    "torque": (1.0, "N m"),
    "time": (1.0, "s"),
    "voltage": (1.0, "V"),
    "flow": (6e4, "l/min"),
    "pressure": (1e-5, "bar"),
    "volume": (1e3, "l"),
    "mass": (1.0, "kg"),
    "compliance": (1e6, "um/N"),
    "temperature": (1.0, "degC"),
    "power": (1e-3, "kW"),
    "power per temperature": (1e-3, "kW/K"),
    "energy per temperature": (1e-3, "kJ/K"),
    "force per speed": (1e-3, "N*s/mm"),
}


def default_text(value: Any, kind: str) -> str:
    """Default as it would be written in a file."""
    if value is PydanticUndefined or value is dataclasses.MISSING:
        return "needed"
    if value is None or value == () or value == "":
        return "-"
    if isinstance(value, BaseModel):
        return "its defaults"
    if isinstance(value, bool):
        return "`true`" if value else "`false`"
    if isinstance(value, (tuple, list)):
        return "`[" + ", ".join(default_text(item, kind).strip("`") for item in value) + "]`"
    if isinstance(value, (int, float)):
        for name, (factor, unit) in sorted(UNITS.items(), key=lambda item: -len(item[0])):
            if re.search(rf"\b{name}\b", kind):
                return f"`{round(float(value) * factor, 9):g} {unit}`"
        return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"
    return f"`{value}`"


BOUNDS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


def bounds_text(info: FieldInfo, kind: str) -> str:
    """Range that a field of a file is held to by itself, as it would be written there."""
    said = [*info.metadata, *_said(info.annotation)]
    found: dict[str, float] = {}
    for item in said:
        for name in BOUNDS:
            if (bound := getattr(item, name, None)) is not None:
                found[name] = float(bound)
    if not found:
        return "-"
    reading = next((item for item in said if isinstance(item, Reading)), None)
    factor, unit = UNITS.get(kind) or ((1.0 / reading.size, reading.unit) if reading else (1.0, ""))
    # five digits: a bound of 1.5708 rad is one of 90 deg
    numbers = {name: f"{float(f'{bound * factor:.5g}'):.10g}" for name, bound in found.items()}
    if set(numbers) == {"ge", "le"}:
        text = f"{numbers['ge']} .. {numbers['le']}"
    else:
        text = " and ".join(f"{sign} {numbers[name]}" for name, sign in BOUNDS.items() if name in numbers)
    return f"{text} {unit}".strip()


def _said(annotation: Any) -> Iterator[Any]:
    """What stands beside the types in an annotation, at any depth."""
    for item in typing.get_args(annotation):  # of Annotated: the type, then what stands beside it
        if isinstance(item, FieldInfo):
            yield from item.metadata
        else:
            yield item
            yield from _said(item)


def range_text(item: Any) -> str:
    """Range or choices of a node's parameter."""
    said = item.metadata
    if said["choices"]:
        return ", ".join(f"`{name}`" for name in said["choices"])
    lowest, highest = (None if math.isinf(said[end]) else f"{said[end]:.10g}" for end in ("minimum", "maximum"))
    if lowest is None and highest is None:
        return "-"
    return f"{lowest or ''} .. {highest or ''}".strip()


def table(name: str) -> str:
    """Markdown table of the fields of a model of files, or of the parameters of a node."""
    module, _, attribute = name.rpartition(".")
    kind = getattr(importlib.import_module(module), attribute)
    lines = []
    if issubclass(kind, BaseModel):
        lines += ["| field | value | default | range | meaning |", "|---|---|---|---|---|"]
        texts = field_docstrings(kind)
        for field, info in kind.model_fields.items():
            words = written_type(kind, field)
            cells = [f"`{field}`", words, default_text(info.default, words), bounds_text(info, words)]
            lines.append(f"| {' | '.join(cells)} | {_cell(texts.get(field, ''))} |")
    else:
        lines += ["| parameter | default | unit | range | set | meaning |", "|---|---|---|---|---|---|"]
        for item in dataclasses.fields(kind):
            said = item.metadata
            cells = [
                f"`{item.name}`",
                default_text(item.default, ""),
                said["unit"] or "-",
                range_text(item),
                "at the start" if said["read_only"] else "any time",
                _cell(said["description"]),
            ]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    return re.sub(r"``([^`]*)``", r"`\1`", text).replace("|", "\\|")


NODE = re.compile(r"^### (\w+)\n\n<!-- fields: (([\w]+)[\w.]*) -->", re.MULTILINE)


def parameter_files() -> dict[Path, str]:
    """File of each node of docs/reference/nodes.md, and what has to stand in it."""
    page = (DOCS / "reference" / "nodes.md").read_text(encoding="utf-8")
    sources = DOCS.parent / "ros_ws" / "src"
    return {
        sources / package / "config" / f"{node}.yaml": parameter_file(node, package, name)
        for node, name, package in NODE.findall(page)
    }


def parameter_file(node: str, package: str, name: str) -> str:
    """Every parameter of a node at its default, for ``--params-file``."""
    module, _, attribute = name.rpartition(".")
    kind = getattr(importlib.import_module(module), attribute)
    lines = [
        f"# Every parameter of node {node} at its default, made by scripts/field_tables.py. Copy it, change the copy:",
        f"# ros2 run {package} {node} --ros-args --params-file my_{node}.yaml",
        "/**:",
        "  ros__parameters:",
    ]
    for item in dataclasses.fields(kind):
        said = item.metadata
        facts = [said["unit"], range_text(item), "" if said["read_only"] else "any time"]
        facts = "; ".join(fact.replace("`", "") for fact in facts if fact not in ("", "-"))
        lines += [
            f"    # {line}" for line in textwrap.wrap(said["description"] + (f" ({facts})" if facts else ""), 112)
        ]
        value = list(item.default) if isinstance(item.default, tuple) else item.default
        lines += textwrap.indent(yaml.safe_dump({item.name: value}), "    ").splitlines()
    return "\n".join(lines) + "\n"


def filled(text: str) -> str:
    """``text`` of a page with its tables made anew."""
    return MARK.sub(lambda match: f"{match[1]}\n{table(match[2])}\n{match[3]}", text)


def main(arguments: list[str]) -> int:
    """Write the tables and files, or only compare; returns the exit code."""
    late = []
    for path, text in parameter_files().items():
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            late.append(path)
            if "--check" not in arguments:
                path.parent.mkdir(exist_ok=True)
                path.write_text(text, encoding="utf-8")
    for path in sorted(DOCS.rglob("*.md")):
        text = path.read_text(encoding="utf-8")
        new = filled(text)
        if new != text:
            late.append(path)
            if "--check" not in arguments:
                path.write_text(new, encoding="utf-8")
    for path in late:
        print(f"{path.relative_to(DOCS.parent)}: {'not in step' if '--check' in arguments else 'written'}")
    return 1 if late and "--check" in arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
