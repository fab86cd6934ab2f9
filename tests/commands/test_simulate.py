"""``isf simulate`` as a user runs it: numbers, files, repeatability, SPIF, off-nominal variants."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
from isf_analysis.bag.bag_reader import read_bag
from isf_cell import in_process
from isf_cell.commands.exit_codes import Exit
from isf_cell.options import RunOptions
from quick_cone import quick_cone, quick_cone_file


def isf(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "isf_cell.cli", *arguments]
    return forked_process.run(command, cwd=cwd)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("simulate")
    done = isf("simulate", str(quick_cone_file(folder)), "--json", "-o", "run", cwd=folder)
    assert done.returncode == Exit.OK, done.stderr
    assert done.stderr.count("warning the sheet is free for 114 mm") == 1
    data: dict[str, Any] = json.loads(done.stdout)
    return data


def test_the_json_object_has_what_scripts_rely_on(simulated: dict[str, Any]) -> None:
    for key in ("max_mm", "mean_abs_mm", "rms_mm", "regions"):
        assert key in simulated["deviation"]
    for key in ("set_N", "p999_abs_error_N", "rms_error_N", "contact_fraction"):
        assert key in simulated["force"]
    for key in ("contours", "ticks", "late_ticks", "lost_messages", "wall_s", "sim_s", "bag", "report"):
        assert key in simulated
    assert simulated["lost_messages"] == 0
    assert simulated["ticks"] > 0


def test_bag_and_report_exist_and_agree_with_the_numbers(simulated: dict[str, Any]) -> None:
    record = read_bag(simulated["bag"])
    assert record.formed == simulated["contours"] == record.planned
    page = Path(simulated["report"])
    assert page.suffix == ".html"
    assert f"{simulated['deviation']['max_mm']:.2f}" in page.read_text(encoding="utf-8")
    assert list(page.parent.glob("*.png"))


def test_the_correction_improves_the_part(simulated: dict[str, Any]) -> None:
    reference = simulated["reference"]["deviation"]
    assert simulated["deviation"]["mean_abs_mm"] < reference["mean_abs_mm"]


def test_the_same_seed_repeats_bit_by_bit_and_another_does_not() -> None:
    job_file = quick_cone()
    first, second, other = (in_process.form(job_file, RunOptions(seed=seed)) for seed in (1, 1, 2))
    assert first.scan is not None
    assert second.scan is not None
    assert other.scan is not None
    np.testing.assert_array_equal(first.scan.z, second.scan.z)
    assert not np.array_equal(first.scan.z, other.scan.z)


def test_an_off_nominal_world_gives_another_part() -> None:
    job_file = quick_cone()
    nominal, other = (in_process.form(job_file, RunOptions(variant=variant)) for variant in (0, 3))
    assert nominal.scan is not None
    assert other.scan is not None
    assert np.abs(nominal.scan.z - other.scan.z).max() > 1e-5


def test_without_force_set_point_the_support_is_position_controlled() -> None:
    record = in_process.form(quick_cone(), RunOptions(support_force=0.0))
    assert record.failure() is None
    assert not any(result.tick_engaged.any() for result in record.results)


FAST_REFUSED = "the fast sheet does not know a support tool that holds the blank"
SHELL_REFUSED = "the elasto-plastic sheet forms SPIF, DSIF and TPIF, not ADSIF"
TOO_SLOW = "the elasto-plastic sheet 'shell_coarse' is slower than the wall clock"


@pytest.mark.parametrize(
    ("command", "job", "options", "message"),
    [
        ("simulate", "ren_cone_on_blank", ("--sheet", "fast"), FAST_REFUSED),
        ("form", "ren_cone_on_blank", ("--sheet", "fast"), FAST_REFUSED),
        ("form", "ren_cone_on_blank", ("--real-time",), TOO_SLOW),  # what it is formed on where no sheet is named
        ("simulate", "adsif_cone", ("--sheet", "shell"), SHELL_REFUSED),
        ("form", "adsif_cone", ("--sheet", "shell"), SHELL_REFUSED),
    ],
)
def test_a_sheet_that_cannot_be_formed_so_is_refused_before_anything_starts(
    tmp_path: Path, command: str, job: str, options: tuple[str, ...], message: str
) -> None:
    file = Path(__file__).parents[2] / "examples" / "jobs" / f"{job}.yaml"
    done = isf(command, str(file), *options, "-o", "run", cwd=tmp_path)
    assert done.returncode == Exit.INPUT
    assert "error 1003 FILE_FIELD" in done.stderr
    assert message in done.stderr
    assert "starting the nodes" not in done.stderr
    assert not (tmp_path / "run" / "bag").exists()
