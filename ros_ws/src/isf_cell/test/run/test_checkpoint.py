"""A checkpoint is whole at any time, and what is not whole, of this software or unfinished does not go on."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_cell.run.checkpoint import CONTOURS, PART_FILE, Checkpoint, CheckpointFolder, state_file
from isf_core.errors import ErrorCode, IsfError

PART = Checkpoint(
    job_name="cone",
    job_text="name: cone",
    base_folder="/jobs",
    correction="analytic",
    support_force=None,
    variant=0,
    seed=7,
    sheet="fast",
    plan_id="cone-1",
    count=42,
    next_index=2,
    began=1.5,
    ended=20.25,
    ticks=1000,
)


def kept(path: Path, index: int = 2) -> CheckpointFolder:
    """A folder with the states before contour ``index`` and the checkpoint of them."""
    folder = CheckpointFolder(path)
    folder.begin()
    (path / CONTOURS).mkdir(exist_ok=True)
    for k in range(index):
        (path / CONTOURS / f"contour_{k:06d}.npz").write_bytes(b"contour %d" % k)
    (path / state_file("machine", index)).write_bytes(b"machine %d" % index)
    folder.write(replace(PART, next_index=index, files=folder.checksums(index)))
    return folder


def refusal(path: Path) -> IsfError:
    with pytest.raises(IsfError) as caught:
        CheckpointFolder(path).read()
    return caught.value


def test_it_is_read_as_it_was_written(tmp_path: Path) -> None:
    kept(tmp_path)
    found = CheckpointFolder(tmp_path).read()
    assert replace(found, files={}) == PART
    assert found.state_of("machine") == "machine_000002.npz"
    assert set(found.files) == {"machine_000002.npz", "contours/contour_000000.npz", "contours/contour_000001.npz"}


def test_the_machine_before_the_last_contour_goes_and_what_a_kill_left_too(tmp_path: Path) -> None:
    folder = kept(tmp_path)
    (tmp_path / state_file("machine", 3)).write_bytes(b"machine 3")
    (tmp_path / CONTOURS / "contour_000002.npz").write_bytes(b"contour 2")
    assert CheckpointFolder(tmp_path).read().next_index == 2
    assert (tmp_path / state_file("machine", 3)).exists()  # who only looks changes nothing
    assert CheckpointFolder(tmp_path).take_up().next_index == 2  # killed before part.json was replaced
    assert not (tmp_path / state_file("machine", 3)).exists()
    assert not (tmp_path / CONTOURS / "contour_000002.npz").exists()
    (tmp_path / state_file("machine", 3)).write_bytes(b"machine 3")
    folder.write(replace(PART, next_index=3, files=folder.checksums(3)))
    assert [path.name for path in tmp_path.glob("machine_*")] == [state_file("machine", 3)]


def test_a_new_part_leaves_nothing_of_the_one_before(tmp_path: Path) -> None:
    kept(tmp_path).begin()
    assert refusal(tmp_path).code is ErrorCode.FILE_NOT_FOUND
    assert not list(tmp_path.rglob("*.npz"))


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        ({"next_index": 42}, ErrorCode.PART_FINISHED, "all 42 contours are formed"),
        ({"lost": "the sheet tore"}, ErrorCode.SHEET_TORN, "the sheet tore"),
        ({"software": "0.0.1"}, ErrorCode.CHECKPOINT_UNUSABLE, "version 0.0.1"),
        ({"files": {"machine_000002.npz": "0"}}, ErrorCode.CHECKPOINT_UNUSABLE, "machine_000002.npz is damaged"),
        ({"files": {"machine_000009.npz": "0"}}, ErrorCode.CHECKPOINT_UNUSABLE, "machine_000009.npz cannot be read"),
    ],
)
def test_what_cannot_go_on_is_refused(change: dict[str, Any], code: ErrorCode, words: str, tmp_path: Path) -> None:
    folder = kept(tmp_path)
    folder.write(replace(PART, **{"files": folder.checksums(2), **change}))
    error = refusal(tmp_path)
    assert error.code is code
    assert words in error.message
    assert error.advice


@pytest.mark.parametrize(
    "text", ["", "{}", "[1]", "no JSON", '{"format": "isf-part-checkpoint", "version": 99}', "\x00" * 100]
)
def test_a_file_that_is_no_checkpoint_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / PART_FILE).write_text(text, encoding="utf-8")
    assert refusal(tmp_path).code is ErrorCode.CHECKPOINT_UNUSABLE


@settings(deadline=None, max_examples=25)
@given(st.data())
def test_any_changed_value_is_noticed(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    path = tmp_path_factory.mktemp("checkpoint")
    kept(path)
    file = path / PART_FILE
    content = json.loads(file.read_text(encoding="utf-8"))
    name = data.draw(st.sampled_from(sorted(content["content"])))
    content["content"][name] = data.draw(
        st.integers() | st.text() | st.none() | st.floats(allow_nan=False) | st.lists(st.integers(), max_size=2)
    )
    changed = content["content"][name] != json.loads(file.read_text(encoding="utf-8"))["content"][name]
    file.write_text(json.dumps(content), encoding="utf-8")
    if changed:
        assert refusal(path).code is ErrorCode.CHECKPOINT_UNUSABLE


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(IsfError) as caught:
        CheckpointFolder(tmp_path / "file").begin()
    assert caught.value.code is ErrorCode.FILE_NOT_WRITABLE
