"""An executive that may wait for a contour no longer than it takes: the part ends with a code."""

from __future__ import annotations

from pathlib import Path

import pytest
from isf_cell.options import RunOptions
from isf_cell.processes.cell_nodes import CellChoice, cell_nodes
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.run import graph_run
from isf_core.errors import ErrorCode
from quick_cone import LONGER, quick_cone

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]


def test_a_contour_without_a_result_in_its_time_ends_the_part(tmp_path: Path) -> None:
    """Every process lives and answers; the contour alone takes longer than 0.1 s."""
    client = graph_run.CellClient()
    try:
        with ProcessGroup(tmp_path) as group:
            for node in cell_nodes(CellChoice(lockstep=True)):
                impatient = {"contour_timeout": 0.1} if node.name == "executive" else {}
                group.start(node.package, node.executable, node.parameters | impatient, outlives=node.outlives)
            client.wait_ready(group)
            result = client.form(quick_cone(step=LONGER), RunOptions(), lambda _: None, group)
    finally:
        client.close()
    assert result.code == ErrorCode.CONTOUR_TIMEOUT
    assert "no result within 0.1 s" in result.message
