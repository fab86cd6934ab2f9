"""The table of a fault campaign: every goal that is missed is named, and a campaign goes on with the cases it has."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from isf_cell import cli
from isf_cell.commands.exit_codes import Exit, exit_for
from isf_cell.faults import campaign
from isf_cell.faults.campaign import CASES_FILE, Case, Plan, chosen, read_cases
from isf_cell.faults.kinds import KINDS, FaultKind
from isf_cell.faults.rows import page_of, rows_of
from isf_core.errors import ErrorCode, IsfError

GOOD = Case(
    "kill force_ctrl",
    0,
    1,
    True,
    contour=1,
    load=700.0,
    code=1502,
    reaction=0.02,
    held=0.1,
    released=0.3,
    worst=0.5,
    right=True,
)


def test_a_good_case_misses_nothing() -> None:
    (row,) = rows_of([GOOD, replace(GOOD, number=1, resumed=True)])
    assert row.misses == []
    assert row.as_dict()["injected"] == 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"reaction": 0.051}, "held after 0.05 s"),
        ({"reaction": math.inf}, "held after ever"),
        ({"released": 5.1}, "force for 5.10 s"),
        ({"released": math.inf}, "force for ever"),
        ({"right": False, "code": 1506}, "told 1506"),
        ({"resumed": False}, "1 not resumed"),
        ({"wrong_success": True}, "1 wrong success"),
        ({"lost": 2}, "2 results lost"),
        ({"worst": 1.2}, "120 % of the force limit"),
        ({"load": 0.0}, "1 not injected"),
    ],
)
def test_every_goal_that_is_missed_is_named(change: dict[str, object], words: str) -> None:
    case = replace(GOOD, number=1, **change)  # type: ignore[arg-type]
    (row,) = rows_of([GOOD, case])
    assert row.misses == [words]
    assert words in page_of([row], seed=1, load=2.0, cores=2)


def test_cases_are_read_back_and_a_broken_line_is_left_out(tmp_path: Path) -> None:
    case = replace(GOOD, codes=(1406, 1502), released=None)
    (tmp_path / CASES_FILE).write_text(json.dumps(asdict(case)) + '\n{"kind": "kill fo')
    assert read_cases(tmp_path) == [case]
    assert read_cases(tmp_path / "nothing") == []


def test_kinds_are_chosen_by_how_their_names_begin() -> None:
    assert {kind.name for kind in chosen(["freeze m", "cancel"], short=False)} == {"freeze machine", "cancel"}
    assert len(chosen([], short=True)) >= 12
    assert len(chosen([], short=False)) == len(KINDS) == len({kind.name for kind in KINDS})
    with pytest.raises(IsfError, match="no kind of fault begins with 'earthquake'") as caught:
        chosen(["earthquake"], short=False)
    assert caught.value.code is ErrorCode.FILE_FIELD


@pytest.mark.parametrize("judged", [0, 1])
@pytest.mark.parametrize(
    ("ended", "code"),
    [
        (IsfError(ErrorCode.NODE_DIED, "the planner died"), ErrorCode.NODE_DIED),
        (KeyboardInterrupt(), ErrorCode.CANCELLED),
    ],
    ids=["error", "ctrl_c"],
)
def test_a_campaign_that_ends_early_is_one_object(
    ended: BaseException,
    code: ErrorCode,
    judged: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def run(*_: object) -> Iterator[Case]:
        yield from [GOOD] * judged
        raise ended

    monkeypatch.setattr(campaign, "run", run)
    monkeypatch.setattr(cli, "keep_for_results", lambda: None)  # standard output is that of the tests
    monkeypatch.setattr("sys.argv", ["isf", "faults", "--kinds", GOOD.kind, "--json", "-o", str(tmp_path / "run")])
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert left.value.code == exit_for(code)
    data = json.loads(capsys.readouterr().out)
    assert data["error"]["name"] == code.name
    assert data.get("faults", 0) == judged
    assert not data.get("ok")
    assert (tmp_path / "run" / "faults.md").is_file() == bool(judged)


@pytest.mark.parametrize("seed", [1, 2])
def test_faults_of_another_seed_are_others(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of seed 1 are in the folder."""
    waiting: list[tuple[int, str]] = []

    def of_cell(_: object, cases: list[tuple[int, FaultKind]], *__: object, **___: object) -> Iterator[Case]:
        waiting.extend((number, kind.name) for number, kind in cases)
        yield from ()

    monkeypatch.setattr(campaign, "_of_cell", of_cell)
    (tmp_path / CASES_FILE).write_text(json.dumps(asdict(GOOD)) + "\n")
    kinds = [kind for kind in KINDS if kind.name == GOOD.kind]
    assert not list(campaign.run(Plan(tmp_path, kinds, 2, seed), lambda _: None))
    assert waiting == [(1, GOOD.kind)] if seed == 1 else [(0, GOOD.kind), (1, GOOD.kind)]


def test_a_campaign_without_all_its_faults_is_not_good(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two of other seeds and kinds are in the folder, and none comes."""
    (tmp_path / CASES_FILE).write_text(
        "".join(f"{json.dumps(asdict(case))}\n" for case in (replace(GOOD, seed=2), GOOD))
    )
    monkeypatch.setattr(campaign, "run", lambda *_: iter(()))
    monkeypatch.setattr(cli, "keep_for_results", lambda: None)
    for seed in ("1", "3"):
        words = [
            "isf",
            "faults",
            "--kinds",
            "kill planner",
            "--faults",
            "1",
            "--seed",
            seed,
            "--json",
            "-o",
            str(tmp_path),
        ]
        monkeypatch.setattr("sys.argv", words)
        with pytest.raises(SystemExit) as left:
            cli.main()
        assert left.value.code == Exit.CHECK_FAILED
        data = json.loads(capsys.readouterr().out)
        assert not data["ok"]
        assert data["page"] == (str(tmp_path / "faults.md") if seed == "1" else None)
