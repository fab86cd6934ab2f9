"""Files as accidents and strangers make them: damaged texts and bytes, wrong arrays, pipes and devices.

Everything is drawn from a generator that the caller seeds, so that what was found once is found again.
"""

from __future__ import annotations

import io
import os
import random
import string
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

HOSTILE = (
    *("9**9**9 mm", "1e308 m", "1e999 mm", "-5 mm", "mm", "5", "5 mm % 3", "5 mm + 3 mm", ".nan", ".inf", "-.inf"),
    *("true", "null", "~", "''", "[]", "{}", "[[[[[1]]]]]", "{a: {b: c}}", "!!python/object/apply:os.getcwd []"),
    *("!!binary AAAA", "2024-13-45", "2024-01-01", "0x" + "f" * 50, "9" * 5000, "*nobody", "&here x", "|", ">", "@"),
    *("\\0", "\x07", "\u202e", "../../../etc/passwd", "/dev/zero", "/dev/stdin", "a" * 3000, "5 " + "m" * 3000),
    *("{a: 1, a: 2}", "{<<: *nobody}", "[" * 500, "nan", "-1e308", "1e-320", "0"),
    *('"a\\0b"', '"a\\0b.yaml"', "a" * 3000 + ".yaml", "/proc/self/mem", "b.yaml/c.yaml"),
)

NUMBERS = ("nan", "inf", "-inf", "1e308", "-1e308", "1e999", "1e-320", "0", "-1", "", "x", "9" * 400, "1_0", "0x10")
"""In place of a number of a table, a mesh or a program."""


def damaged_text(text: str, chance: random.Random) -> str:
    """``text`` after one to four accidents: values replaced, lines lost, doubled or indented, characters changed."""
    lines = text.splitlines() or [""]
    for _ in range(chance.randint(1, 4)):
        k = chance.randrange(len(lines))
        kind = chance.randrange(6)
        if kind <= 1 and ":" in lines[k]:
            lines[k] = f"{lines[k].partition(':')[0]}: {chance.choice(HOSTILE)}"
        elif kind == 2:
            del lines[k]
        elif kind == 3:
            lines.insert(chance.randrange(len(lines)), lines[k])
        elif kind == 4:
            lines[k] = " " * chance.randint(1, 9) + lines[k]
        else:
            place = chance.randrange(len(lines[k]) + 1)
            lines[k] = lines[k][:place] + chance.choice(string.printable + "\x00\ufeff\ud7ff") + lines[k][place + 1 :]
        lines = lines or ["x"]
    return "\n".join(lines)


def damaged_table(text: str, chance: random.Random) -> str:
    """Lines of numbers, between blanks or commas, after one to four accidents: numbers replaced, lost, doubled."""
    lines = text.splitlines() or [""]
    for _ in range(chance.randint(1, 4)):
        k = chance.randrange(len(lines))
        mark = "," if "," in lines[k] else " "
        cells = lines[k].split(mark)
        n = chance.randrange(len(cells))
        kind = chance.randrange(4)
        if kind <= 1:
            cells[n] = chance.choice(NUMBERS)
        elif kind == 2:
            del cells[n]
        else:
            cells.insert(n, cells[n])
        lines[k] = mark.join(cells)
    return "\n".join(lines)


def damaged_bytes(data: bytes, chance: random.Random) -> bytes:
    """``data`` after one to four accidents: bytes changed, cut out, doubled, zeroed, or the end lost."""
    content = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        if not content:
            break
        # the first bytes say what a file is and how much is to come
        place = chance.randrange(min(len(content), 200) if chance.random() < 0.5 else len(content))
        length = chance.randint(1, 64)
        kind = chance.randrange(6)
        if kind <= 1:
            content[place] = chance.randrange(256)
        elif kind == 2:
            del content[place : place + length]
        elif kind == 3:
            content[place:place] = content[place : place + length]
        elif kind == 4:
            content[place : place + 4] = chance.choice((b"\x00" * 4, b"\xff" * 4, b"\xff\xff\xff\x7f"))
        else:
            del content[place:]
    return bytes(content)


def damaged_arrays(arrays: Mapping[str, Any], chance: random.Random) -> bytes:
    """A numpy archive of ``arrays``, one to three of which are of another kind, shape or size, or hold no numbers."""
    changed: dict[str, Any] = {name: np.asarray(array) for name, array in arrays.items()}
    for _ in range(chance.randint(1, 3)):
        name = chance.choice(list(changed))
        changed[name] = _another(changed[name], chance)
        if changed[name] is None:
            del changed[name]
        changed = changed or {"x": np.zeros(1)}
    stream = io.BytesIO()
    np.savez(stream, **changed)
    return stream.getvalue()


def _another(array: Any, chance: random.Random) -> Any:
    """An array in place of ``array``; None: it is left out."""
    if array.dtype.kind == "U" and array.ndim == 0 and chance.random() < 0.8:
        return np.array(damaged_bytes(str(array).encode(), chance).decode("utf-8", "replace"))
    kind = chance.randrange(9)
    if kind == 0:
        return None
    if kind <= 2 and array.dtype.kind == "f" and array.size:
        wrong = array.copy()
        wrong.flat[chance.randrange(array.size)] = chance.choice((np.nan, np.inf, -np.inf, 1e308, -1.0, 0.0))
        return wrong
    flat = array.ravel()
    others = (
        np.array(chance.choice((0.0, -1, "x", True, np.nan))),
        flat[: len(flat) // 2],
        np.concatenate([flat, flat]),
        flat.astype("U5"),
        np.array([{"a": 1}], dtype=object),
        np.zeros((0, 3)),
        array[None],
        array.astype(np.complex64) if array.dtype.kind in "fiu" else flat[:0],
        flat.view(np.uint8) if array.dtype.kind in "fiu" and array.size else flat[:0],
    )
    return others[chance.randrange(len(others))]


STRANGE = ("pipe", "folder", "device", "nothing", "huge", "binary", "not UTF-8", "zeros", "deep", "long line", "rows")
"""What may lie at a path in place of the file that is wanted."""


def put_strange(path: Path, name: str) -> Path:
    """Make the ``name`` of STRANGE at ``path``, which is free; returns the path that leads there."""
    contents = {
        "nothing": b"",
        "binary": bytes(range(256)) * 20,
        "not UTF-8": "name: größe\nx,y,z\n1,2,3\n".encode("latin-1"),
        "zeros": bytes(5000),
        "deep": b"[" * 50_000,
        "long line": b"1," * 1_000_000,
        "rows": b"1,2,3\n" * 1_500_000,
    }
    if name == "pipe":
        os.mkfifo(path)
    elif name == "folder":
        path.mkdir()
    elif name == "device":
        path.symlink_to("/dev/zero")
    elif name == "huge":
        with path.open("wb") as file:
            file.truncate(50_000_000_000)  # takes no room on the disk
    else:
        path.write_bytes(contents[name])
    return path
