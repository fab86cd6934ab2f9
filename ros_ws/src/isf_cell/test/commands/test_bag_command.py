"""``isf bag repair``: of a bag whose writer was killed, one that every command and tool reads."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.bag.bag_writer import write_bag
from isf_cell.cli import app
from rosbags.rosbag2 import Reader
from synthetic_part import make_part
from typer.testing import CliRunner

PART = make_part(contours=2, spacing=5e-3, points=12)


def test_a_bag_without_its_end_becomes_whole(tmp_path: Path) -> None:
    bag = write_bag(PART, tmp_path / "run" / "bag")
    file = bag / "bag.mcap"
    file.write_bytes(file.read_bytes()[:-3000])  # index and footer
    (bag / "metadata.yaml").unlink()
    with pytest.raises(FileNotFoundError), Reader(bag):
        pass
    done = CliRunner().invoke(app, ["bag", "repair", str(tmp_path / "run"), "-o", str(tmp_path / "whole"), "--json"])
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    assert "ended by force" in printed["notes"][0]
    with Reader(tmp_path / "whole") as reader:
        assert reader.message_count == printed["messages"] > 0
    part = read_bag(tmp_path / "whole")
    assert [result.index for result in part.results] == [result.index for result in PART.results]
    assert not part.notes


def test_a_bag_is_never_overwritten(tmp_path: Path) -> None:
    write_bag(PART, tmp_path / "bag")
    before = (tmp_path / "bag" / "bag.mcap").read_bytes()
    done = CliRunner().invoke(app, ["bag", "repair", str(tmp_path / "bag"), "-o", str(tmp_path / "bag")])
    assert done.exit_code != 0
    assert "exists already" in str(done.exception)
    assert (tmp_path / "bag" / "bag.mcap").read_bytes() == before
