"""What a browser is told: everything once, and of the samples that it missed no more than it can take."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isf_dashboard.history import COLUMNS, Cursor, History


def told(history: History, cursor: Cursor) -> dict[str, Any]:
    return json.loads(history.news(cursor) or "{}")


def times(message: dict[str, Any]) -> list[float]:
    """t of the samples in a message."""
    if "samples" not in message:
        return []
    packed = message["samples"]
    assert packed["kind"] == "f4"
    rows = np.frombuffer(base64.b64decode(packed["data"]), dtype="<f4").reshape(packed["shape"])
    assert rows.shape[1] == len(COLUMNS)
    return [float(value) for value in rows[:, 0]]


def row(time: float) -> Any:
    values = np.full(len(COLUMNS), np.nan)
    values[0] = time
    return values


def test_everything_is_told_once() -> None:
    history, cursor = History("live"), Cursor()
    first = told(history, cursor)
    assert first["begin"]["columns"] == list(COLUMNS)
    assert history.news(cursor) is None
    history.add("result", 1.0, index=0, force=np.float64(3.0), unknown=float("nan"), z=np.array([1.0, np.nan]))
    history.sample(row(1.0))
    history.set_status({"busy": True})
    news = told(history, cursor)
    (item,) = news["items"]
    assert (item["kind"], item["t"], item["force"], item["unknown"]) == ("result", 1.0, 3.0, None)
    assert item["z"]["shape"] == [2]
    assert times(news) == [1.0]
    assert news["status"] == {"busy": True}
    history.set_status({"busy": True})
    assert history.news(cursor) is None


def test_a_new_part_lets_the_news_of_the_last_one_go() -> None:
    history, cursor = History("live"), Cursor()
    history.add("contour", 0.0, index=7)
    assert told(history, cursor)["items"][0]["index"] == 7
    history.begin()
    history.add("contour", 1.0, index=0)
    news = told(history, cursor)
    assert "begin" in news
    assert [item["index"] for item in news["items"]] == [0]


@given(
    st.lists(st.integers(1, 400), min_size=1, max_size=12),
    st.integers(4, 60),
    st.integers(2, 50),
)
def test_whoever_is_slow_gets_fewer_samples_and_always_the_newest(looks: list[int], kept: int, at_once: int) -> None:
    history, cursor = History("live", kept=2 * kept, at_once=at_once), Cursor()
    seen: list[float] = []
    clock = 0
    for count in looks:
        for _ in range(count):
            clock += 1
            history.sample(row(float(clock)))
        new = times(told(history, cursor))
        assert 1 <= len(new) <= at_once
        assert new[-1] == clock
        seen += new
    assert seen == sorted(set(seen))
    assert len(history.table()) <= 2 * kept


def test_many_news_come_in_several_messages() -> None:
    history, cursor = History("run"), Cursor()
    for index in range(30):
        history.add("scan", 0.0, index=index, deviation=np.zeros(20_000))
    sizes, seen = [], []
    while (text := history.news(cursor)) is not None:
        sizes.append(len(text))
        seen += [item["index"] for item in json.loads(text).get("items", [])]
    assert seen == list(range(30))
    assert len(sizes) > 2
    assert max(sizes) < 1_500_000


def test_what_is_no_number_or_text_is_refused() -> None:
    with pytest.raises(TypeError, match="object"):
        History("live").add("event", 0.0, text=object())
