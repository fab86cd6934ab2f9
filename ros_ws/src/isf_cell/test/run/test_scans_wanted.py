"""What a person is told of scans that a method needs, or that nothing can be read from."""

from __future__ import annotations

from pathlib import Path

import pytest
from isf_cell import in_process
from isf_cell.commands import terminal
from isf_cell.options import RunOptions
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_springback.estimators.fused import MODEL_ALONE

JOB = """\
name: cone
part: {mesh: not_there.stl, unit: mm}
process: SPIF
rig: ren2018
sheet: {material: AA5754-O, thickness: 1 mm}
tool_1: {radius: 5 mm}
path: {incremental_depth: 0.5 mm, point_spacing: 0.5 mm, feed: 30 mm/s}
"""


@pytest.mark.parametrize(
    ("section", "chosen"), [("{method: mpc_vertical}", None), ("{method: none}", "mpc_two_directional")]
)
def test_a_job_without_the_scans_of_its_method_is_refused_before_its_plan(section: str, chosen: str | None) -> None:
    job_file = JobFile(f"{JOB}control: {{support_force: 0 N}}\nspringback: {section}\n", Path())
    with pytest.raises(IsfError, match="scan_every: 1") as caught:
        in_process.form(job_file, RunOptions(correction=chosen))
    assert caught.value.code == ErrorCode.FILE_FIELD
    with pytest.raises(IsfError) as planned:
        in_process.form(job_file, RunOptions(correction="none"))
    assert planned.value.code != ErrorCode.FILE_FIELD  # the mesh that the plan misses


def test_notes_and_a_correction_without_eyes_are_warnings_at_the_terminal() -> None:
    remarks = [{"text": MODEL_ALONE}, {"text": "the rim lies 1.4 mm too low"}]
    with terminal.console.capture() as shown:
        terminal.show_summary({"notes": ["2 scans left out [why]"], "remarks": remarks}, None)
    assert "wall and base [mm]" in shown.get()
    lines = [line for line in shown.get().splitlines() if line.startswith("warning")]
    assert lines == ["warning 2 scans left out [why]", f"warning {MODEL_ALONE}"]
