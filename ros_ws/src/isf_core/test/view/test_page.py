"""A picture in three dimensions in a page: everything is in it, packed, and can be unpacked by any reader."""

from __future__ import annotations

import base64
import gzip
import re
from typing import Any

import numpy as np
import pytest
from isf_core.view.page import View, fragment, new_figure, page, scripts
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
