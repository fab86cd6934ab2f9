"""Archives, JSON and meshes from outside: unpacked within bounds, and nothing but plain data is read."""

from __future__ import annotations

import io
import os
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import archive, bounded, mesh_parser
from isf_core.files.die_mesh import read_die
from isf_core.files.job import JobFile

ROOT = Path(__file__).resolve().parents[5]
DIE_JOB = ROOT / "examples" / "jobs" / "tpif_cone.yaml"


def header(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    """Of a .npy file that promises such an array."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": kind, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def zipped(content: bytes, name: str = "a.npy") -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(name, content)
    return stream.getvalue()


def with_other_size(packed: bytes, size: int) -> bytes:
    """The zip with another size of its first file in its table."""
    content, place = bytearray(packed), packed.rfind(b"PK\x01\x02")
    content[place + 24 : place + 28] = size.to_bytes(4, "little")
    return bytes(content)


def test_arrays_are_read_as_they_were_written(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.asarray("text"), "c": np.zeros((0, 3)), "d": np.asarray(True)}
    for compressed in (False, True):
        archive.write_archive(tmp_path / "x.npz", arrays, compressed=compressed)
        read = archive.read_archive(tmp_path / "x.npz")
        assert list(read) == list(arrays)
        for name, array in arrays.items():
            assert read[name].dtype == array.dtype
            np.testing.assert_array_equal(read[name], array)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "not a zip"),
        (zipped(header((3,))), "another size"),
        (zipped(header((10**12,))), "another size"),
        (zipped(header((10**12,), "<U0")), "no plain values"),
        (zipped(header((1,), "|O") + b"\x80\x04N."), "no plain values"),
        (zipped(b"\x93NUMPY\x01\x00\x88\x13" + b"(" * 5000), "damaged"),
        (zipped(header((1,)) + bytes(8))[:-10], "not a zip"),
        (zipped(header((25_000_000,)) + bytes(200_000_000)), "larger than 100 MB when it is unpacked"),
        (with_other_size(zipped(header((25_000_000,)) + bytes(200_000_000)), 1000), "Bad CRC"),
    ],
    ids=["empty", "short", "huge", "no width", "objects", "deep", "cut", "bomb", "bomb that lies"],
)
def test_an_archive_that_is_none_is_refused_before_there_is_room_for_it(
    content: bytes, why: str, tmp_path: Path
) -> None:
    path = tmp_path / "x.npz"
    path.write_bytes(content)
    with pytest.raises(OSError, match=why) as refused:
        archive.read_archive(path, 100_000_000)
    assert refused.value.filename == str(path)


def test_pipes_and_devices_are_no_archives(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.npz")
    for path in (tmp_path / "pipe.npz", Path("/dev/zero"), tmp_path):
        with pytest.raises(OSError, match="a pipe or a device"):
            archive.read_archive(path)
        with pytest.raises(OSError, match="a pipe or a device"):
            bounded.read_json(path)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "9" * 10_000, "\x00"])
def test_what_is_no_json_is_an_error_of_reading(text: str, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(OSError, match="is no JSON"):
        bounded.read_json(path)


MODEL = (
    '<?xml version="1.0"?><model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'
    '<resources><object id="1" type="model"><mesh><vertices>{vertices}</vertices><triangles>'
    '<triangle v1="0" v2="1" v3="2"/></triangles></mesh></object></resources>'
    '<build><item objectid="1"/></build></model>'
)
CORNERS = '<vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/>'


def test_a_packed_mesh_is_parsed_up_to_what_memory_bears() -> None:
    name = "3D/3dmodel.model"
    small = zipped(MODEL.format(vertices=CORNERS).encode(), name)
    assert len(mesh_parser.parse_mesh(small, "3mf").to_mesh().faces) == 1
    large = zipped(MODEL.format(vertices=CORNERS + '<vertex x="0" y="0" z="0"/>' * 600_000).encode(), name)
    assert len(large) < 100_000
    with pytest.raises(OSError, match="larger than 16 MB when it is unpacked"):
        mesh_parser.parse_mesh(large, "3mf")
    with pytest.raises(ValueError, match="Bad CRC"):
        mesh_parser.parse_mesh(with_other_size(large, 1000), "3mf")
    entities = MODEL.format(vertices=CORNERS).replace("<model", '<!DOCTYPE a [<!ENTITY b "c">]><model', 1)
    with pytest.raises(ValueError, match="entities"):
        mesh_parser.parse_mesh(zipped(entities.encode(), name), "3mf")


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("die.stl", None, ErrorCode.FILE_NOT_FOUND),
        ("die.exe", b"x", ErrorCode.MESH_UNREADABLE),
        ("die.obj", b"", ErrorCode.MESH_EMPTY),
        ("die.obj", b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", ErrorCode.MESH_EMPTY),
        ("die.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", ErrorCode.MESH_UNREADABLE),
        ("die.stl", os.mkfifo, ErrorCode.MESH_UNREADABLE),
    ],
)
def test_a_die_that_cannot_be_used_has_a_code(name: str, content: object, code: ErrorCode, tmp_path: Path) -> None:
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif callable(content):
        content(path)
    text = DIE_JOB.read_text(encoding="utf-8").replace("../parts/tpif_cone_die.stl", str(path))
    assert str(path) in text
    with pytest.raises(IsfError) as refused:
        read_die(JobFile(text, DIE_JOB.parent))
    assert refused.value.code is code
    assert refused.value.where == str(path)
    assert refused.value.advice


def test_a_mesh_in_text_is_parsed_up_to_what_memory_bears() -> None:
    head = b"ply\nformat ascii 1.0\nelement vertex 2000000\nproperty float x\nend_header\n"
    for kind, data in (("ply", head + b"1 2 3\n" * 2_000_001), ("off", b"OFF\n" + bytes(25_000_000))):
        with pytest.raises(OSError, match="larger than"):
            mesh_parser.parse_mesh(data, kind)


def test_a_table_with_an_endless_line_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("x,y,z\n" + "1," * 6000)
    with pytest.raises(OSError, match="line 2 has more than 10,000 characters"):
        bounded.read_lines(path)
    path.write_text("1\n" * 2_000_000)
    with pytest.raises(OSError, match="larger than 3 MB"):
        bounded.read_lines(path)


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    """Spreadsheets begin a table with it: a first column of another name would be taken for something else."""
    path = tmp_path / "x.csv"
    path.write_bytes(b"\xef\xbb\xbffx,fy\r\n1,2\r\n")
    assert bounded.read_text(path) == "fx,fy\n1,2\n"
    assert bounded.read_lines(path) == ["fx,fy", "1,2"]
    path.write_bytes(b"\xef\xbb\xbf[1]")
    assert bounded.read_json(path) == [1]


def test_nothing_is_read_of_a_file_that_is_too_large(tmp_path: Path) -> None:
    with (tmp_path / "large").open("wb") as file:
        file.truncate(60_000_000)
    tracemalloc.start()
    try:
        with pytest.raises(OSError, match="is larger than 50 MB"):
            bounded.read_content(tmp_path / "large", 50_000_000)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 1_000_000  # bytes
