"""A picture in three dimensions in a page: everything is in it, packed, and can be unpacked by any reader."""

from __future__ import annotations

import base64
import gzip
import re
from typing import Any

import numpy as np
import pytest
from isf_core.types import Array
from isf_core.view.page import Ball, Steps, View, fragment, new_figure, page, scripts
from packed_page import unpacked

pytest.importorskip("plotly")


def drawn() -> Any:
    figure = new_figure()
    for high in (1.0, 4.0):
        figure.add_scatter3d(x=[0.0, 100.0, np.nan], y=[0.0, 50.0, np.nan], z=[0.0, high, np.nan])
    return figure


def test_views_choose_traces_and_labels_and_the_first_one_is_seen() -> None:
    views = {"low": View([0]), "<high>": View([1], [(np.array([1.0, 2.0, 3.0]), "a <b> & 4 N")])}
    html = fragment(drawn(), views, 'a "part"')
    content = unpacked(html)
    assert [trace["visible"] for trace in content["data"]] == [True, False]
    assert content["views"]["low"] == {"traces": [0], "annotations": []}
    (label,) = content["views"]["<high>"]["annotations"]
    assert (label["x"], label["y"], label["z"], label["text"]) == (1.0, 2.0, 3.0, "a &lt;b&gt; &amp; 4 N")
    assert html.count('type="radio"') == 2
    assert 'value="&lt;high&gt;"' in html
    assert "<b>" not in html


def test_a_label_whose_place_is_not_known_is_left_out() -> None:
    labels = [(np.array([1.0, 2.0, np.nan]), "lost"), (np.array([1.0, 2.0, 3.0]), "known")]
    (label,) = unpacked(fragment(drawn(), {"all": View([0, 1], labels)}, "part"))["views"]["all"]["annotations"]
    assert label["text"] == "known"


def test_the_box_is_to_scale_but_never_without_height() -> None:
    ratio = unpacked(fragment(drawn(), {"all": View([0, 1])}, "part"))["layout"]["scene"]["aspectratio"]
    assert ratio == pytest.approx({"x": 1.0, "y": 0.5, "z": 0.04})
    flat = new_figure()
    flat.add_scatter3d(x=[0.0, 10.0], y=[0.0, 10.0], z=[0.0, 0.0])
    assert unpacked(fragment(flat, {"all": View([0])}, "part"))["layout"]["scene"]["aspectratio"]["z"] == 0.02


def test_the_library_is_packed_once_into_two_megabytes() -> None:
    from plotly.offline import get_plotlyjs

    text = scripts()
    (packed,) = re.findall(r'id="view3d-library">([A-Za-z0-9+/=]+)</script>', text)
    assert gzip.decompress(base64.b64decode(packed)).decode("utf-8") == get_plotlyjs()
    assert len(text) < 2.1e6
    whole = page(drawn(), "a <plan>")
    assert whole.count("view3d-library") == 2  # the library, and the script that looks for it
    assert "<title>a &lt;plan&gt;</title>" in whole
    assert 'type="radio"' not in whole
    assert not re.search(r"<script[^>]+src=|https?://", re.sub(r">[A-Za-z0-9+/=]{200,}<", "><", whole))


def whole(text: str) -> Array:
    return np.frombuffer(base64.b64decode(text), dtype="<i2").astype(float)


def stepped(scale: float) -> tuple[Steps, dict[str, Any], str]:
    """A sheet that sinks in three steps, a path that is there in the first two, and a ball of 5 mm on it."""
    figure, rng = new_figure(), np.random.default_rng(3)
    figure.add_surface(x=scale * np.arange(4.0), y=scale * np.arange(3.0), z=np.zeros((3, 4)))
    figure.add_scatter3d(x=[0.0], y=[0.0], z=[0.0])
    figure.add_surface(x=np.zeros((2, 2)), y=np.zeros((2, 2)), z=np.zeros((2, 2)))
    heights = -scale * np.cumsum(rng.uniform(0.0, 1.0, (4, 3, 4)), axis=0)
    path = [scale * rng.uniform(0.0, 3.0, (7, 3)), scale * rng.uniform(0.0, 3.0, (5, 3)), np.empty((0, 3))]
    shape = np.array([[[-5.0, 0.0, 0.0], [5.0, 0.0, 0.0]], [[0.0, -5.0, 10.0], [0.0, 5.0, 10.0]]])
    steps = Steps(["one", "two", "<three>"], 0, heights, [(1, path)], [Ball(2, 0, shape)])
    html = fragment(figure, {"forming": View([0, 1, 2], steps=steps)}, "part")
    return steps, unpacked(html)["views"]["forming"]["steps"], html


@pytest.mark.parametrize("scale", [10.0, 400.0])
def test_what_moves_comes_back_from_the_differences_in_the_page(scale: float) -> None:
    """To half a unit: 0.01 mm, or what fits 1.2 m into 16 bits."""
    steps, content, html = stepped(scale)
    unit = content["unit"]
    assert unit == 0.01 if scale == 10.0 else 0.0625 < unit < 0.11
    found = np.cumsum(whole(content["heights"]).reshape(4, *content["shape"]), axis=0) * unit
    np.testing.assert_allclose(found, steps.heights, atol=0.5 * unit + 1e-9)
    (line,) = content["paths"]
    assert line["trace"] == 1
    for text, points in zip(line["points"], steps.paths[0][1], strict=True):
        np.testing.assert_allclose(whole(text).reshape(-1, 3) * unit, points, atol=0.5 * unit + 1e-9)
    assert content["labels"] == ["one", "two", "<three>"]
    assert "<three>" not in html
    (low_x, high_x), _, (low_z, high_z) = content["ranges"]
    every = np.vstack(steps.paths[0][1])
    assert low_x == pytest.approx(min(0.0, every[:, 0].min() - 5.0))
    assert high_x == pytest.approx(max(3.0 * scale, every[:, 0].max() + 5.0))
    assert (low_z, high_z) == pytest.approx((steps.heights.min(), every[:, 2].max() + 10.0))


def test_only_a_view_of_steps_has_something_to_play() -> None:
    assert "Play" in stepped(10.0)[2]
    assert "Play" not in fragment(drawn(), {"all": View([0, 1])}, "part")
