"""A checkpoint is whole at any time."""

import json
from pathlib import Path

from isf_cell.run.part_run import Checkpoint


def test_it_replaces_the_old_one_and_leaves_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "part.json"
    for index in (1, 2):
        Checkpoint("cone", "cone-1", index, 42, "analytic", 0, 7).write(path)
    assert json.loads(path.read_text())["next_index"] == 2
    assert [item.name for item in tmp_path.iterdir()] == ["part.json"]
