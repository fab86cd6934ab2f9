"""``isf identify --dial`` on a rig whose tools are carried by arms."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from isf_cell.cli import app
from isf_core.files.rig import load_rig
from typer.testing import CliRunner


def test_a_dial_at_the_tip_of_an_arm_finds_tool_and_holder_alone(tmp_path: Path) -> None:
    """4.2087 um/N along x, of which the arm's joints take 4.1487 um/N: the rig file's 0.05 um/N becomes 0.06 um/N."""
    table, piece = tmp_path / "dial.csv", tmp_path / "mine.yaml"
    rows = [
        f"1,x,{place},{repeat},{force},{4.2087 * force + 0.1 * (-1) ** k:.3f}"
        for place in (1, 2, 3)
        for repeat in range(1, 7)
        for k, force in enumerate((20, 60, 100, 140))
    ]
    table.write_text("tool,axis,place,repeat,force_N,deflection_um\n" + "\n".join(rows))
    done = CliRunner().invoke(
        app, ["identify", "--rig", "kr210_pair", "--dial", str(table), "--json", "-o", str(piece)]
    )
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["values"]["tool_1.x"]["value"] == pytest.approx(0.06e-6, abs=0.002e-6)
    rig = load_rig(str(piece))
    assert rig.tool_1.compliance == pytest.approx((0.06e-6, 0.05e-6, 0.01e-6), abs=0.002e-6)
    assert "um/N of the arm taken off" in rig.provenance["tool_1.compliance.x"]
