"""A checkpoint is whole at any time, and what is not whole, of this software or unfinished does not go on."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isf_cell.options import RunOptions
from isf_cell.run.cell import PartGoal, PlannedPart
from isf_cell.run.checkpoint import CONTOURS, PART_FILE, Checkpoint, CheckpointFolder, folder_below, state_file
from isf_cell.run.part_keeper import PartKeeper, PartTotals, TickCounts
from isf_core.contour import ContourResult
from isf_core.errors import ErrorCode, IsfError
from quick_cone import quick_cone

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
        (path / CONTOURS / f"contour_{k:06d}.001.npz").write_bytes(b"contour %d" % k)
    (path / state_file("machine", index)).write_bytes(b"machine %d" % index)
    folder.write(replace(PART, next_index=index, files=folder.checksums(index)))
    return folder


def refusal(path: Path) -> IsfError:
    with pytest.raises(IsfError) as caught:
        CheckpointFolder(path).read()
    return caught.value


def test_a_checkpoint_is_checked_on_python_3_10(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("hashlib.file_digest", raising=False)
    kept(tmp_path)
    (tmp_path / state_file("machine", 2)).write_bytes(b"another")
    assert refusal(tmp_path).code is ErrorCode.CHECKPOINT_UNUSABLE


@pytest.mark.parametrize(("lockstep", "seconds"), [(True, 43_250.0 - 1.5), (False, 18.75 + 30.0)])
def test_by_the_clock_the_time_in_which_nobody_formed_is_no_time_of_the_process(lockstep: bool, seconds: float) -> None:
    """Formed from 1.5 to 20.25 s and, gone on with at 43,220 s, to 43,250 s."""
    none, nothing, ticks = np.empty((0, 3)), np.empty(0), np.array([43_220.0, 43_250.0])
    points = (none, none, none, none, nothing, none, ticks, nothing, nothing, np.zeros(2, dtype=bool))
    rest = [ContourResult("cone-1", 2, 43_220.0, 43_250.0, True, *points)]
    before = replace(PART, lockstep=lockstep)
    totals = PartTotals.of(rest, TickCounts(), before)
    assert totals.ended - totals.began == pytest.approx(seconds)
    assert totals.contours == 3
    again = PartTotals.of([], TickCounts(), before)
    assert again.ended - again.began == pytest.approx(18.75)


def test_it_is_read_as_it_was_written(tmp_path: Path) -> None:
    kept(tmp_path)
    found = CheckpointFolder(tmp_path).read()
    assert replace(found, files={}) == PART
    assert found.state_of("machine") == "machine_000002.npz"
    assert set(found.files) == {
        "machine_000002.npz",
        "contours/contour_000000.001.npz",
        "contours/contour_000001.001.npz",
    }


def test_the_machine_before_the_last_contour_goes_and_what_a_kill_left_too(tmp_path: Path) -> None:
    folder = kept(tmp_path)
    (tmp_path / state_file("machine", 3)).write_bytes(b"machine 3")
    (tmp_path / CONTOURS / "contour_000002.001.npz").write_bytes(b"contour 2")
    assert CheckpointFolder(tmp_path).read().next_index == 2
    assert (tmp_path / state_file("machine", 3)).exists()  # who only looks changes nothing
    assert CheckpointFolder(tmp_path).take_up().next_index == 2  # killed before part.json was replaced
    assert not (tmp_path / state_file("machine", 3)).exists()
    assert not (tmp_path / CONTOURS / "contour_000002.001.npz").exists()
    (tmp_path / state_file("machine", 3)).write_bytes(b"machine 3")
    folder.write(replace(PART, next_index=3, files=folder.checksums(3)))
    assert [path.name for path in tmp_path.glob("machine_*")] == [state_file("machine", 3)]


def test_what_comes_late_leaves_the_checkpoint_whole_until_the_next_one(tmp_path: Path) -> None:
    folder = kept(tmp_path)
    late = tmp_path / CONTOURS / "contour_000001.002.npz"
    late.write_bytes(b"contour 1 and its scan")
    assert CheckpointFolder(tmp_path).read().next_index == 2  # killed before part.json was replaced
    folder.write(replace(PART, files=folder.checksums(2)))
    assert "contours/contour_000001.002.npz" in CheckpointFolder(tmp_path).read().files
    assert [path.name for path in (tmp_path / CONTOURS).glob("contour_000001*")] == [late.name]


def test_a_new_part_leaves_nothing_of_the_one_before_and_what_is_not_of_it(tmp_path: Path) -> None:
    folder = kept(tmp_path)
    own = {tmp_path / "machine_before_trimming.npz", tmp_path / CONTOURS / "mine.npz"}
    for path in own:
        path.write_bytes(b"saved by a person")
    folder.begin()
    assert refusal(tmp_path).code is ErrorCode.FILE_NOT_FOUND
    assert set(tmp_path.rglob("*.npz")) == own


def test_a_part_is_kept_below_the_folder_of_the_cell_alone(tmp_path: Path) -> None:
    root, elsewhere = tmp_path / "runs", tmp_path / "elsewhere"
    root.mkdir()
    elsewhere.mkdir()
    (root / "link").symlink_to(elsewhere)
    assert folder_below(root, "cone/checkpoint") == root / "cone" / "checkpoint"
    assert folder_below(root, str(root / "cone")) == root / "cone"
    for asked in (".", "..", "../elsewhere", str(elsewhere), "link/cone", "cone/../../elsewhere", "a\0b"):
        with pytest.raises(IsfError) as caught:
            folder_below(root, asked)
        assert caught.value.code is ErrorCode.FILE_OUTSIDE


class Saver:
    """A cell whose states land in ``folder``, after the ``failures`` given for the first calls."""

    counts = TickCounts()

    def __init__(self, folder: Path, *failures: IsfError) -> None:
        self._folder, self._failures = folder, list(failures)

    def save_state(self, next_index: int) -> tuple[str, ...]:
        if self._failures:
            raise self._failures.pop(0)
        (self._folder / CONTOURS).mkdir(parents=True, exist_ok=True)
        (self._folder / CONTOURS / f"contour_{next_index - 1:06d}.001.npz").write_bytes(b"contour")
        return (f"{CONTOURS}/contour_{next_index - 1:06d}",)


class Phases:
    """What an operator is told."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def phase(self, text: str, *_: int) -> None:
        self.told.append(text)


def keeper_of(path: Path, saver: Saver) -> tuple[PartKeeper, PartGoal, Phases]:
    phases, goal = Phases(), PartGoal(quick_cone(), RunOptions())
    keeper = PartKeeper(CheckpointFolder(path), saver, phases, lockstep=False)  # type: ignore[arg-type]
    keeper.begin(goal)
    return keeper, goal, phases


def test_a_save_that_fails_is_told_once_and_tried_again(tmp_path: Path) -> None:
    full = IsfError(ErrorCode.FILE_NOT_WRITABLE, "no space left")
    keeper, goal, phases = keeper_of(tmp_path, Saver(tmp_path, full, full))
    for index in (1, 2, 3):
        keeper.keep(goal, PlannedPart("plan", 5), index, [])
    found = CheckpointFolder(tmp_path).read()
    assert (found.next_index, found.lockstep) == (3, False)
    assert len(phases.told) == 1
    assert "no space left" in phases.told[0]
    keeper.keep(goal, PlannedPart("plan", 5), 4, [], "the sheet tore")
    assert refusal(tmp_path).code is ErrorCode.SHEET_TORN


def test_a_torn_part_is_known_as_such_where_nothing_could_be_saved(tmp_path: Path) -> None:
    keeper, goal, _ = keeper_of(tmp_path, Saver(tmp_path, *[IsfError(ErrorCode.SERVICE_TIMEOUT, "late")] * 2))
    keeper.keep(goal, PlannedPart("plan", 5), 1, [])
    keeper.keep(goal, PlannedPart("plan", 5), 2, [], "the sheet tore")
    assert refusal(tmp_path).code is ErrorCode.SHEET_TORN


def test_a_node_that_dies_meanwhile_ends_the_part(tmp_path: Path) -> None:
    keeper, goal, _ = keeper_of(tmp_path, Saver(tmp_path, IsfError(ErrorCode.NODE_DIED, "machine ended")))
    with pytest.raises(IsfError) as caught:
        keeper.keep(goal, PlannedPart("plan", 5), 1, [])
    assert caught.value.code is ErrorCode.NODE_DIED


def test_states_that_land_elsewhere_are_no_checkpoint(tmp_path: Path) -> None:
    keeper, goal, phases = keeper_of(tmp_path / "checkpoint", Saver(tmp_path / "elsewhere"))
    keeper.keep(goal, PlannedPart("plan", 5), 1, [])
    assert refusal(tmp_path / "checkpoint").code is ErrorCode.FILE_NOT_FOUND
    assert "state_folder" in phases.told[0]


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
