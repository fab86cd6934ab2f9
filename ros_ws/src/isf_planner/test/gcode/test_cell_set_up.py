"""Work offsets that are stored for a cell, where programs find them."""

from __future__ import annotations

from pathlib import Path

import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_planner.gcode.reader import read_program
from isf_planner.gcode.set_up import cell_set_up, cell_set_up_path, load_set_up, store_work_offset


@pytest.fixture(autouse=True)
def cells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of the set-ups."""
    folder = tmp_path / "cells"
    monkeypatch.setenv("ISF_CELLS", str(folder))
    return folder


def test_an_offset_is_found_again_for_its_rig_alone() -> None:
    assert cell_set_up("ren2018")[1] is None
    path = cell_set_up_path("ren2018")
    store_work_offset(path, 54, (12.5e-3, -7.25e-3, 0.1234e-3))
    store_work_offset(path, 57, (0.0, 0.0, 50e-3))
    found, file = cell_set_up("ren2018")
    assert file == path
    assert found.offset(54) == pytest.approx((12.5e-3, -7.25e-3, 0.1234e-3), abs=5e-8)
    assert found.offset(57) == pytest.approx((0.0, 0.0, 50e-3), abs=5e-8)
    assert found.offset(55) == (0.0, 0.0, 0.0)
    assert cell_set_up("torrao2013")[1] is None


def test_tools_in_the_file_stay(cells: Path) -> None:
    path = cell_set_up_path("my rig/of ours")
    assert path.parent == cells
    cells.mkdir()
    path.write_text(
        "tools:\n  3: {length: 100 mm, radius: 7.5 mm}\nmounted: 3\nwork_offsets: {G55: [1 mm, 2 mm, 3 mm]}\n"
    )
    store_work_offset(path, 54, (1e-3, 0.0, 0.0))
    found = load_set_up(path)
    assert (found.mounted, found.tools[3].length) == (3, 0.1)
    assert found.offset(55) == pytest.approx((1e-3, 2e-3, 3e-3))
    assert found.offset(54) == pytest.approx((1e-3, 0.0, 0.0))
    assert [item.name for item in cells.iterdir()] == [path.name]


def test_a_program_begins_where_the_offset_says() -> None:
    path = cell_set_up_path("ren2018")
    store_work_offset(path, 56, (10e-3, 20e-3, 30e-3))
    program = read_program("G56 G90\nG1 X1 Y2 Z3 F600\nM30\n", cell_set_up("ren2018")[0])
    assert program.tips[-1, :3] == pytest.approx([11e-3, 22e-3, 33e-3])


def test_what_is_not_understood_is_not_written_over(cells: Path) -> None:
    path = cell_set_up_path("ren2018")
    cells.mkdir()
    path.write_text("work_offset: {G54: [1 mm, 2 mm, 3 mm]}\n")
    with pytest.raises(IsfError) as refused:
        store_work_offset(path, 54, (0.0, 0.0, 0.0))
    assert refused.value.code == ErrorCode.FILE_FIELD
    assert "1 mm" in path.read_text()


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(IsfError) as refused:
        store_work_offset(tmp_path / "file" / "ren2018.yaml", 54, (0.0, 0.0, 0.0))
    assert refused.value.code == ErrorCode.FILE_NOT_WRITABLE
