"""Scans of a part formed in stages: every stage is held against the shape that it ends with."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from isf_core.files.job import JobFile
from isf_core.geometry.height_map import HeightMap
from isf_springback.contour_record import read_target, write_target
from isf_springback.corrector import apply
from isf_springback.methods import make_corrector
from isf_springback.scan.feedback import ScanMemory
from scanned_sheet import GRID, INNER, OPENING, Sheet, X, Y
from springback_parts import JOB_TEXT, cone_contour, result_of

COUNT = 20
DEPTH = 0.5e-3 * COUNT + 2e-3
"""m, of the floor: the tip of the last contour is below its contact."""
SPRINGBACK = 0.8e-3


def cone(angle: float, depth: float = DEPTH) -> HeightMap:
    return HeightMap(GRID, GRID, np.clip((np.hypot(X, Y) - OPENING) * np.tan(np.radians(angle)), -depth, 0.0))


PART, PREFORM = cone(50.0), cone(30.0)


def stage(number: int, angle: float):
    """Contours of a cone of ``angle`` deg, DEPTH deep, one tool."""
    alone = {"support_force": np.empty(0), "support_tip": np.empty((0, 3))}
    return [
        replace(
            cone_contour(k, angle=angle, opening=OPENING),
            index=COUNT * number + k,
            count=2 * COUNT,
            stage=number,
            retract=k == 0,
            **alone,
        )
        for k in range(COUNT)
    ]


def job_file(method: str) -> JobFile:
    text = JOB_TEXT.replace("process: DSIF", "process: SPIF").replace("\ntool_2: {radius: 5 mm}", "")
    text = text.replace("\ncontrol: {support_force: 120 N}", "")
    return JobFile(text.replace("method: analytic", f"method: {method}, scan_every: 1"), Path("."))


def form(method: str, contours, preforms):
    """Mean push (m) of every contour, codes, and the sheet, which springs back by SPRINGBACK everywhere."""
    corrector, sheet = make_corrector(method, job_file(method)), Sheet(lambda depth, around: SPRINGBACK)
    corrector.set_target(PART, preforms)
    pushes, codes = [], []
    for contour in contours:
        correction = corrector.correct(contour)
        corrected = apply(contour, correction)
        sheet.form(corrected)
        corrector.add_result(corrected, result_of(corrected, 0.0, squeeze=0.0))
        corrector.add_scan(sheet.points(), contour.index)
        pushes.append(-float(correction.offset[:, 2].mean()))
        codes.append(correction.code)
    return np.array(pushes), codes, sheet


def wall_error(sheet: Sheet) -> np.ndarray:
    """m, of the wall where it is 3 to 7 mm deep."""
    wall = (PART.z[INNER, INNER] < -3e-3) & (PART.z[INNER, INNER] > -7e-3)
    return (sheet.z - PART.z)[INNER, INNER][wall]


@pytest.mark.parametrize("method", ["fused", "mpc_vertical"])
def test_a_preform_is_corrected_by_its_own_shape(method: str) -> None:
    """Against the part, the preform stands up to 4 mm too high: a method that believed it would push as far as it may.
    The force says that nothing springs back, so that all is found by scans, in both stages alike."""
    pushes, codes, sheet = form(method, stage(0, 30.0) + stage(1, 50.0), (PREFORM,))
    assert not any(codes)
    for number in (0, 1):
        settled = pushes[COUNT * number + 8 : COUNT * (number + 1)]
        assert settled == pytest.approx(np.full(12, SPRINGBACK), abs=0.15e-3)
    assert np.abs(np.median(wall_error(sheet))) < 0.25e-3


@pytest.mark.parametrize("method", ["fused", "mpc_vertical"])
def test_a_finishing_pass_begins_on_the_part(method: str) -> None:
    """Its first contours are shallow, and the sheet in the middle is as deep as the part from the beginning."""
    pushes, codes, sheet = form(method, stage(0, 50.0) + stage(1, 50.0), ())
    assert not any(codes)
    assert np.abs(pushes[COUNT:]).max() < 1.2e-3
    assert np.abs(np.median(wall_error(sheet))) < 0.25e-3


def test_the_shapes_of_all_stages() -> None:
    memory = ScanMemory(job_file("fused"))
    assert memory.target is None
    assert memory.began is None
    memory.set_target(PART, (PREFORM,))
    known = []
    for number in range(3):
        memory.work_on(number)
        known.append((memory.began, memory.target))
    assert known == [(None, PREFORM), (PREFORM, PART), (PART, PART)]


def test_the_shapes_are_kept_with_the_contours(tmp_path: Path) -> None:
    assert read_target(tmp_path) is None
    for preforms in ((), (PREFORM, cone(40.0))):
        write_target(PART, preforms, tmp_path)
        part, read = read_target(tmp_path) or (None, ())
        assert part is not None
        assert part.z == pytest.approx(PART.z)
        assert len(read) == len(preforms)
        assert all(a.z == pytest.approx(b.z) for a, b in zip(read, preforms, strict=True))
