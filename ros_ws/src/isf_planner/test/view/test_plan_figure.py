"""The picture of a plan: what it shows of every process, and a place where nothing can be written."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_planner import Plan, plan
from isf_planner.view.plan_figure import FORMING, SUPPORT, draw_plan, make_figure
from isf_planner.view.plan_view import QUANTITIES, make_scene
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.image import imread
from matplotlib.patches import Circle
from planner_parts import EXAMPLES, Cone, job_for, write

NAMES = ("two_features", "tpif_cone", "adsif_cone", "spiral_cone")


@pytest.fixture(scope="module")
def made() -> dict[str, tuple[Plan, JobFile]]:
    jobs = {name: load_job(EXAMPLES / "jobs" / f"{name}.yaml") for name in NAMES}
    coarse = jobs["adsif_cone"].text.replace("point_spacing: 0.5 mm", "point_spacing: 1 mm")
    jobs["adsif_cone"] = JobFile(coarse, jobs["adsif_cone"].base)
    return {name: (plan(job_file), job_file) for name, job_file in jobs.items()}


def panels(planned: Plan, job_file: JobFile) -> list[Axes]:
    """From above, section, curves over depth."""
    axes = make_figure(planned, job_file).axes
    return [next(a for a in axes if a.get_title("left").startswith(t)) for t in ("Paths", "Section", "Up to")]


def balls(axes: Axes, colour: str) -> list[tuple[float, float]]:
    """Centres of the tools drawn in a colour, mm, from left to right."""
    circles = [patch for patch in axes.patches if isinstance(patch, Circle) and patch.get_linewidth() > 0]
    return sorted(circle.center for circle in circles if to_hex(circle.get_edgecolor()) == colour.lower())


def test_the_backing_plate_lies_under_the_sheet_around_its_opening() -> None:
    job_file = load_job(EXAMPLES / "jobs" / "ren_cone_plate.yaml")  # opening 76 mm, sheet 1 mm, edge rounded by 2 mm
    above, section, _ = panels(plan(job_file), job_file)
    edge, _ = [found for found in above.collections if isinstance(found, LineCollection)]
    assert np.hypot(*edge.get_segments()[0].T) == pytest.approx(38.0, abs=1e-9)
    assert above.get_xlim()[1] > 38.0
    (plate,) = [found for found in section.collections if found.get_label() == "backing plate"]
    corners = np.vstack([path.vertices for path in plate.get_paths()])
    assert np.abs(corners[:, 0]).min() == pytest.approx(38.0, abs=0.1)
    assert corners[:, 1].max() == pytest.approx(-1.0, abs=1e-9)
    at_edge = corners[np.abs(corners[:, 0]) < 38.2]
    assert -3.0 - 1e-9 <= at_edge[:, 1][at_edge[:, 1] > -4.9].max() < -2.0  # under the rounding


@pytest.mark.parametrize("name", NAMES)
def test_what_every_process_shows(name: str, made: dict[str, tuple[Plan, JobFile]]) -> None:
    planned, job_file = made[name]
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # identical limits of an axis
        above, section, curves = panels(planned, job_file)
    (paths,) = [found for found in above.collections if isinstance(found, LineCollection)]
    steps = np.array([np.linalg.norm(line[1] - line[0]) for line in paths.get_segments()])
    assert steps.max() < 2e3 * job_file.job.path.point_spacing  # open contours have no chord back to their start
    (low, high), (left, right) = curves.get_ylim(), curves.get_xlim()
    assert 0.0 == left < right
    assert 0.0 == low < high
    for colour in (FORMING, SUPPORT) if job_file.job.process != "TPIF" else (FORMING,):
        assert len(balls(section, colour)) == (2 if name == "two_features" else 1)


def test_lower_tool_forms_from_below(made: dict[str, tuple[Plan, JobFile]]) -> None:
    """The pocket is on the left, the dome on the right, 4 mm each, formed by balls of 5 mm."""
    section = panels(*made["two_features"])[1]
    (pocket, dome), (under, over) = balls(section, FORMING), balls(section, SUPPORT)
    assert pocket[0] < 0 < dome[0]
    assert pocket[1] > under[1]
    assert dome[1] < over[1]
    for one, other in ((pocket, under), (dome, over)):  # R1 + R2 + t, drawn in the section itself
        assert np.hypot(*np.subtract(one, other)) == pytest.approx(10 + np.cos(np.radians(40)), abs=0.1)


def test_tips_over_a_die_are_shown_on_the_finished_part(made: dict[str, tuple[Plan, JobFile]]) -> None:
    planned, job_file = made["tpif_cone"]
    scene = make_scene(planned, QUANTITIES["wall_angle"])
    z = scene.forming[np.isfinite(scene.forming).all(axis=1), 2]
    assert z.min() == pytest.approx(0.0, abs=1e-6)
    assert z.max() == pytest.approx(5.5, abs=1e-6)  # 6 mm less the first step
    ((x, height),) = balls(panels(planned, job_file)[1], FORMING)
    contact = abs(x) - 5.0 * np.sin(np.radians(40)), height - 5.0 * np.cos(np.radians(40))
    assert contact[0] == pytest.approx(24 - contact[1] / np.tan(np.radians(40)), abs=0.1)  # on the wall of the cone


def test_view_shows_both_tools_where_roles_change(made: dict[str, tuple[Plan, JobFile]]) -> None:
    scene = make_scene(made["two_features"][0], QUANTITIES["wall_angle"])
    assert scene.forming_tools == (1, 2)
    assert len(scene.support) == len(scene.forming)


@pytest.mark.parametrize("process", ["SPIF", "DSIF"])
def test_picture(process: str, tmp_path: Path) -> None:
    job_file = job_for(write(Cone().mesh(50e-6), tmp_path / "cone.stl"), depth="1 mm", process=process)
    picture = draw_plan(plan(job_file), job_file, tmp_path / "plan.png")
    pixels = imread(picture)
    assert pixels.shape[:2] == (936, 1560)
    left, upper, lower = pixels[:, :780, :3], pixels[:468, 780:, :3], pixels[468:, 780:, :3]
    for panel in (left, upper, lower):  # ink in every panel
        assert np.mean(panel.min(axis=2) < 0.9) > 0.01
    support_colour = np.array([0xD5, 0x5E, 0x00]) / 255
    support_drawn = np.abs(upper - support_colour).max(axis=2) < 0.1
    assert support_drawn.any() == (process == "DSIF")


def test_folder_that_does_not_exist(tmp_path: Path) -> None:
    job_file = job_for(write(Cone().mesh(50e-6), tmp_path / "cone.stl"), depth="4 mm")
    with pytest.raises(IsfError) as caught:
        draw_plan(plan(job_file), job_file, tmp_path / "none" / "plan.png")
    assert caught.value.code is ErrorCode.FILE_NOT_WRITABLE
