"""A job with other fields, as campaigns and try-outs form it."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.job import load_job

REN_CONE = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "ren_cone.yaml"

values = st.one_of(st.integers(), st.text(max_size=4), st.lists(st.integers(), max_size=2))
names = st.text("abc", min_size=1, max_size=2)
fields = st.recursive(
    st.dictionaries(names, values, max_size=3), lambda inner: st.dictionaries(names, inner, max_size=3)
)


def test_fields_are_changed_one_by_one_and_those_that_are_null_are_left_out() -> None:
    plain = load_job(REN_CONE)
    changed = plain.changed(
        {
            "path": {"support": "on_blank"},
            "control": {"support_force": None, "engage_depth": None},
            "backing_plate": {"shape": "circle", "size": ["110 mm", "110 mm"]},
        }
    )
    assert changed.job.path.support == "on_blank"
    assert changed.job.path.incremental_depth == plain.job.path.incremental_depth == 0.5e-3
    assert changed.job.control.support_force == 0.0
    assert changed.job.control.rate == 500.0
    assert changed.job.backing_plate is not None
    assert changed.mesh == plain.mesh
    assert plain.job.backing_plate is None


def test_what_is_wrong_with_a_change_is_told_as_of_a_job() -> None:
    with pytest.raises(IsfError, match="support_force must be 0 N") as caught:
        load_job(REN_CONE).changed({"path": {"support": "on_blank"}})
    assert caught.value.code == ErrorCode.FILE_FIELD
    with pytest.raises(IsfError) as caught:
        load_job(REN_CONE).changed({"sheet": {"thickness": 1}})
    assert caught.value.code == ErrorCode.FILE_UNIT


def test_what_was_null_can_be_left_out_of_a_section_that_is_not_there() -> None:
    assert yaml_file.merged({"a": 1}, {"b": {"c": None}}) == {"a": 1, "b": {}}


@given(fields, fields)
def test_a_change_made_twice_is_the_change(job: dict[str, object], change: dict[str, object]) -> None:
    once = yaml_file.merged(job, change)
    assert yaml_file.merged(once, change) == once
    assert yaml_file.merged(job, {}) == job
    assert yaml_file.merged(once, dict.fromkeys(once)) == {}
