"""Views of a plan in three dimensions, and the places that warnings name."""

from __future__ import annotations

import base64
import gzip
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_planner import Plan, plan
from isf_planner.part.mesh_checks import place_text
from isf_planner.part.warning_places import warning_places
from isf_planner.predict.predictions import with_predictions
from isf_planner.view.plan_view import QUANTITIES, make_scene, show
from matplotlib.image import imread
from planner_parts import EXAMPLES


@pytest.fixture(scope="module")
def made() -> Plan:
    job_file = load_job(EXAMPLES / "jobs" / "mini_cone.yaml")
    planned = plan(job_file)
    contours, _ = with_predictions(planned.contours, job_file)
    return replace(
        planned, contours=contours, warnings=("the wall at x = 12.0, y = -3.5, z = -2.0 mm is steep", "no place")
    )


@given(st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3))
def test_places_are_read_as_they_are_written(point: list[float]) -> None:
    ((place, text),) = warning_places([f"contour 3 at {place_text(np.array(point))}: too steep"])
    np.testing.assert_allclose(place, point, atol=0.051e-3)
    assert "contour 3" in text


def test_place_without_height() -> None:
    ((place, _),) = warning_places(["around x = 12.0, y = -3.5 mm"])
    np.testing.assert_allclose(place, [12e-3, -3.5e-3, 0.0])


@pytest.mark.parametrize("colour", QUANTITIES)
def test_colours_of_path_and_surface_agree(colour: str, made: Plan) -> None:
    scene = make_scene(made, QUANTITIES[colour])
    assert np.isnan(scene.values).sum() == len(made.contours)
    formed = scene.colour[np.isfinite(scene.colour)]
    assert len(formed) > 300
    assert formed.min() >= np.nanmin(scene.values)
    assert formed.max() <= np.nanmax(scene.values)
    # the flange beside the part has no colour
    assert np.isnan(scene.colour[0, 0])
    assert len(scene.support) == len(scene.forming)


def test_html_is_one_file(made: Plan, tmp_path: Path) -> None:
    pytest.importorskip("plotly")
    text = show(made, tmp_path / "plan.html", "force").read_text(encoding="utf-8")
    assert not re.findall(r"<script[^>]+src=", text)
    (packed,) = re.findall(r"data-view3d>([A-Za-z0-9+/=]+)</script>", text)
    drawn = gzip.decompress(base64.b64decode(packed)).decode("utf-8")
    assert "axial force in N" in drawn
    assert "lower tool (supports)" in drawn
    assert "x = 12.0, y = -3.5" in drawn


def test_png_shows_warnings(made: Plan, tmp_path: Path) -> None:
    red = np.array([0xC1, 0x12, 0x1F]) / 255
    counts = []
    for name, one in (("with", made), ("without", replace(made, warnings=()))):
        pixels = imread(show(one, tmp_path / f"{name}.png", "thickness"))[:, :, :3]
        assert pixels.shape[0] > 600
        counts.append(int((np.abs(pixels - red).max(axis=2) < 0.05).sum()))
    assert counts[0] > 50
    assert counts[1] == 0


def test_unknown_colour_ending_and_folder(made: Plan, tmp_path: Path) -> None:
    for path, colour, code in (
        (tmp_path / "plan.png", "taste", ErrorCode.EXPORT_FORMAT_UNKNOWN),
        (tmp_path / "plan.gif", "force", ErrorCode.EXPORT_FORMAT_UNKNOWN),
        (tmp_path / "none" / "plan.png", "force", ErrorCode.FILE_NOT_WRITABLE),
    ):
        with pytest.raises(IsfError) as caught:
            show(made, path, colour)
        assert caught.value.code is code


def test_missing_plotly_is_reported(made: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    with pytest.raises(IsfError, match="pip install plotly"):
        show(made, tmp_path / "plan.html")
