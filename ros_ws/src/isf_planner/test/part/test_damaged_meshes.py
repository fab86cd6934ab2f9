"""Damaged mesh files of every format: a plan, or a refusal with code, place and advice; never anything else."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_planner import Plan, plan
from isf_planner.part.meshes import FORMATS, load_mesh
from planner_parts import Cone, job_for, write

SOURCE = Cone().mesh(0.3e-3)


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Bits flipped, bytes replaced, pieces cut out, doubled or left off."""
    content = bytearray(data)
    kind = rng.integers(5)
    place = int(rng.integers(len(content)))
    if kind == 0:
        for at in rng.integers(len(content), size=int(rng.integers(1, 20))):
            content[at] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        content[place : place + 8] = rng.bytes(8)
    elif kind == 2:
        del content[place : place + int(rng.integers(1, 400))]
    elif kind == 3:
        content[place:place] = content[place : place + int(rng.integers(1, 400))]
    else:
        del content[place:]
    return bytes(content)


def check(count: int, seed: int, folder: Path) -> None:
    rng = np.random.default_rng(seed)
    sources = {kind: write(SOURCE, folder / f"part.{kind}").read_bytes() for kind in FORMATS}
    refused = 0
    for k in range(count):
        kind = FORMATS[k % len(FORMATS)]
        path = folder / f"damaged.{kind}"
        path.write_bytes(damaged(sources[kind], rng))
        made = planned_or_refused(path)
        if isinstance(made, IsfError):
            refused += 1
            assert made.code.owner == "planner", f"file {k}: {made}"
            assert made.where, f"file {k}: {made}"
            assert made.advice, f"file {k}: {made}"
        else:
            assert made.contours
            assert all(np.isfinite(contour.forming_tip).all() for contour in made.contours)
    assert refused > count // 5  # the damage is real


def planned_or_refused(path: Path) -> Plan | IsfError:
    """The plan of a file, or its refusal; any other exception ends the test."""
    try:
        return plan(job_for(path, process="SPIF", depth="4 mm", spacing="2 mm"))
    except IsfError as error:
        return error


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # parsers cast what the damage made of numbers
def test_forty_damaged_files(tmp_path: Path) -> None:
    check(40, 1, tmp_path)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_five_hundred_damaged_files(tmp_path: Path) -> None:
    check(500, 2, tmp_path)


def test_a_pipe_a_device_and_a_folder_are_no_meshes(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "device.stl").symlink_to("/dev/zero")
    (tmp_path / "folder.stl").mkdir()
    for name in ("pipe", "device", "folder"):
        with pytest.raises(IsfError, match="a folder, a pipe or a device") as refused:
            load_mesh(tmp_path / f"{name}.stl", "mm")
        assert refused.value.code is ErrorCode.MESH_UNREADABLE
