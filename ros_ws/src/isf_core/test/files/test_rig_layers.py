"""Rig files that are based on others."""

from __future__ import annotations

from pathlib import Path

import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.rig import load_rig


def test_what_a_layer_reports_replaces_what_is_below(tmp_path: Path) -> None:
    (tmp_path / "first.yaml").write_text(
        "based_on: ren2018\nservo:\n  bandwidth: 28 Hz\nprovenance:\n  servo.bandwidth: 'identified: here'\n"
    )
    (tmp_path / "second.yaml").write_text("based_on: first.yaml\nname: second\ncontact_stiffness: 0.4 N/um\n")
    below, rig = load_rig("ren2018"), load_rig("second.yaml", tmp_path)
    assert rig.name == "second"
    assert rig.contact_stiffness == pytest.approx(0.4e6)
    assert (rig.servo.bandwidth, rig.servo.rate) == (28.0, below.servo.rate)
    assert rig.provenance == {**below.provenance, "servo.bandwidth": "identified: here"}
    rest = {"name", "contact_stiffness", "servo", "provenance"}
    assert rig.model_dump(exclude=rest) == below.model_dump(exclude=rest)


def test_an_error_map_stays_beside_the_file_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "above.yaml").write_text("based_on: praveen2020\ncontact_stiffness: 0.4 N/um\n")
    below, rig = load_rig("praveen2020"), load_rig("above.yaml", tmp_path)
    for tool in ("tool_1", "tool_2"):
        assert getattr(rig, tool).error_map == getattr(below, tool).error_map


def test_a_rig_is_found_from_the_folder_that_one_is_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A relative folder names the map once."""
    (tmp_path / "rigs").mkdir()
    (tmp_path / "rigs" / "below.yaml").write_text("based_on: ren2018\ntool_1:\n  error_map: map.csv\n")
    (tmp_path / "rigs" / "above.yaml").write_text("based_on: below.yaml\ncontact_stiffness: 0.4 N/um\n")
    monkeypatch.chdir(tmp_path)
    for name in ("below.yaml", "above.yaml"):
        assert load_rig(name, Path("rigs")).tool_1.error_map == str(tmp_path / "rigs" / "map.csv")


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("based_on: unknown_rig\n", ErrorCode.FILE_NOT_FOUND),
        ("based_on: 7\n", ErrorCode.FILE_FIELD),
        ("based_on: piece.yaml\n", ErrorCode.FILE_FIELD),
        ("based_on: ren2018\nservo:\n  bandwith: 28 Hz\n", ErrorCode.FILE_FIELD),
        ("based_on: ren2018\nservo:\n  bandwidth: 28\n", ErrorCode.FILE_UNIT),
        ("based_on: [\n", ErrorCode.FILE_SYNTAX),
    ],
)
def test_layers_that_cannot_be(tmp_path: Path, text: str, code: ErrorCode) -> None:
    (tmp_path / "piece.yaml").write_text(text)
    with pytest.raises(IsfError) as caught:
        load_rig("piece.yaml", tmp_path)
    assert caught.value.code is code
    assert "piece.yaml" in caught.value.message or "unknown_rig" in caught.value.message


def test_a_fault_is_in_the_line_of_the_file_that_has_it(tmp_path: Path) -> None:
    (tmp_path / "below.yaml").write_text("based_on: ren2018\nname: below\nservo:\n  rate: 500 Hz\n  bandwidth: 28\n")
    (tmp_path / "above.yaml").write_text("based_on: below.yaml\nservo:\n  bandwidth: 29\n")
    with pytest.raises(IsfError, match=r"above\.yaml:3: servo\.bandwidth: 29"):
        load_rig("above.yaml", tmp_path)
    (tmp_path / "above.yaml").write_text("based_on: below.yaml\nname: above\n")
    with pytest.raises(IsfError, match=r"below\.yaml:5: servo\.bandwidth"):
        load_rig("above.yaml", tmp_path)
    (tmp_path / "above.yaml").write_text("based_on: below.yaml\nservo:\n  bandwidth: 28 Hz\n  bandwith: 28 Hz\n")
    with pytest.raises(IsfError, match=r"above\.yaml:4: unknown field 'servo\.bandwith'"):
        load_rig("above.yaml", tmp_path)
