"""The fault campaign on a real cell: a process is killed, the part resumed, and wrenches are altered."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import pytest
from isf_cell.commands.faults import run_faults
from isf_cell.faults import campaign
from isf_core.errors import ErrorCode

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]

KINDS = ["kill force_ctrl", "wrench saturated"]


def run_short(folder: Path) -> None:
    """The campaign; times may miss their goals where the tests beside this one keep the computer busy."""
    with suppress(SystemExit):
        run_faults(folder, KINDS, short=True, faults=1, seed=3, resume=True, as_json=False)


def test_faults_are_injected_judged_and_gone_on_after(tmp_path: Path) -> None:
    run_short(tmp_path)
    killed, saturated = campaign.read_cases(tmp_path)
    assert (killed.kind, killed.code, killed.resumed) == (KINDS[0], ErrorCode.NODE_DIED, True)
    assert killed.difference is not None
    assert killed.difference < 1e-9  # m: in lockstep bit by bit
    assert (saturated.kind, saturated.code, saturated.resumed) == (KINDS[1], ErrorCode.WRENCH_OUT_OF_RANGE, None)
    for case in (killed, saturated):
        assert case.load > 10.0
        assert case.sound, case
        assert case.released is not None
        assert case.released < 60.0  # s: the tools were let go
    assert "| wrench saturated | 10 kN in one component | lockstep | 1 |" in (tmp_path / "faults.md").read_text()
    run_short(tmp_path)  # nothing is left to do
    assert len(campaign.read_cases(tmp_path)) == 2


@pytest.mark.clock
def test_a_frozen_force_control_leaves_the_contour_it_wakes_in_when_the_part_goes_on(tmp_path: Path) -> None:
    """The part has ended without it; awake again it goes on with that contour, and was not to be armed for the next."""
    with suppress(SystemExit):
        run_faults(tmp_path, ["freeze force_ctrl"], short=False, faults=1, seed=7, resume=True, as_json=False)
    (case,) = campaign.read_cases(tmp_path)
    assert (case.code, case.resumed, case.resumed_with) == (ErrorCode.NODE_DIED, True, 0)
    assert case.sound, case
    assert (
        case.worst < 0.6
    )  # of the limit: forming takes 0.47; 0.8 where the machine, once reset, went after old targets
