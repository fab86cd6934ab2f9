"""``isf library``: what is installed, where its constants come from, and files of one's own checked."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from isf_cell.commands.library import show_library
from isf_core.errors import ErrorCode, IsfError

KINDS = ["tools", "blanks", "plates", "materials", "rigs"]
OWN = "name: own\nradius: 3 mm\nprovenance: {radius: 'published: drawing 4711'}\n"


def shown(capsys: pytest.CaptureFixture[str], *wanted: str | None) -> dict[str, dict[str, dict[str, str]]]:
    kind, name = (*wanted, None, None)[:2]
    show_library(kind, name, as_json=True)
    found: dict[str, dict[str, dict[str, str]]] = json.loads(capsys.readouterr().out)
    return found


def test_all_kinds_are_listed_with_what_their_files_say(capsys: pytest.CaptureFixture[str]) -> None:
    everything = shown(capsys)
    assert list(everything) == KINDS
    assert everything["tools"]["spif_a_flat_15"]["corner_radius"] == "2 mm"
    assert everything["blanks"]["aa1050_1000"]["size"] == "[1000 mm, 1000 mm]"
    assert everything["rigs"]["kr210_pair"]["based_on"] == "kr210_arm"
    assert shown(capsys, "plates") == {"plates": everything["plates"]}


@pytest.mark.parametrize(
    ("kind", "name", "constant", "value", "origin"),
    [
        ("tools", "spif_a_ball_5", "stick_out", "43 mm", "Table 3.8"),
        ("plates", "spif_a_round_90", "size", "[90 mm, 90 mm]", "3.5.2"),
        ("materials", "DPS780", "tensile_strength", "800 MPa", "assumed: EN 10338"),
        ("rigs", "torrao2013", "legs.cylinder.bore", "63 mm", "Table 3.1"),
    ],
)
def test_constants_come_with_their_origin(
    kind: str, name: str, constant: str, value: str, origin: str, capsys: pytest.CaptureFixture[str]
) -> None:
    show_library(kind, name, as_json=True)
    rows = {row["constant"]: row for row in json.loads(capsys.readouterr().out)["constants"]}
    assert rows[constant]["value"] == value
    assert origin in rows[constant]["origin"]


def test_a_file_of_ones_own_is_shown_or_told_with_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.yaml").write_text(OWN, encoding="utf-8")
    show_library("tools", "own.yaml", as_json=True)
    assert json.loads(capsys.readouterr().out)["constants"] == [
        {"constant": "radius", "value": "3 mm", "origin": "published: drawing 4711"}
    ]
    Path("own.yaml").write_text(OWN.replace("3 mm", "3"), encoding="utf-8")
    with pytest.raises(IsfError) as caught:
        show_library("tools", "own.yaml", as_json=True)
    assert caught.value.code is ErrorCode.FILE_UNIT
    assert caught.value.where.endswith("own.yaml:2")


@pytest.mark.parametrize(("kind", "name", "words"), [("plate", None, "plates"), ("tools", "ball", "spif_a_ball_5")])
def test_what_is_not_there_is_told_with_what_is(kind: str, name: str | None, words: str) -> None:
    with pytest.raises(IsfError) as caught:
        show_library(kind, name, as_json=True)
    assert caught.value.code is ErrorCode.FILE_NOT_FOUND
    assert words in caught.value.advice
