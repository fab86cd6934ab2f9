"""``isf record``: what is no size or time is refused before the recorder starts."""

from __future__ import annotations

from pathlib import Path

import pytest
from isf_cell import cli
from isf_cell.commands.exit_codes import exit_for
from isf_core.errors import ErrorCode


@pytest.mark.parametrize("option", ["--ring", "--split-size", "--split-time"])
@pytest.mark.parametrize("value", ["-5", "nan", "inf"])
def test_what_is_no_size_or_time_is_refused(
    option: str, value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli, "keep_for_results", lambda: None)  # standard output is that of the tests
    monkeypatch.setattr("os.execv", lambda *_: pytest.fail("the recorder was started"))
    monkeypatch.setattr("sys.argv", ["isf", "record", "-o", str(tmp_path / "bag"), option, value])
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert left.value.code == exit_for(ErrorCode.FILE_FIELD)
    told = " ".join(capsys.readouterr().err.split())
    assert "FILE_FIELD" in told
    assert option in told
    assert "0 or more" in told
