"""The springback commands on a small job: numbers as JSON, files that are named, mistakes with a code."""

import csv
import json
from pathlib import Path

import pytest
from isf_cell.cli import app
from isf_core.errors import ErrorCode, IsfError
from isf_springback.database.database import Database
from typer.testing import CliRunner

JOB = Path(__file__).resolve().parents[5] / "examples" / "jobs" / "mini_cone.yaml"


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ISF_CACHE_DIR", str(tmp_path / "cache"))


def isf(*words):
    """The JSON object of ``isf springback``; raises what the command raises."""
    result = CliRunner().invoke(app, ["springback", *map(str, words), "--json"])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_predict_gives_the_deflection_at_the_control_points():
    found = isf("predict", JOB, "--force", 300, "--force", 100)
    assert found["loads_N"] == [100.0, 300.0]
    assert found["depth_mm"] == pytest.approx(5.0, abs=0.5)
    deflection = found["points"][0]["deflection_mm"]
    assert 1.0 < deflection[0] < deflection[1] < 5.0
    shallow = isf("predict", JOB, "--force", 300, "--depth", 1.0)
    assert shallow["contour"] < found["contour"]


def test_sideways_loads_deflect_less():
    down = isf("predict", JOB, "--force", 100)
    side = isf("predict", JOB, "--force", 100, "--direction", "x")
    assert side["points"][0]["deflection_mm"][0] < down["points"][0]["deflection_mm"][0]


def test_control_points_writes_picture_and_table(tmp_path):
    found = isf("control-points", JOB, "-o", tmp_path / "out")
    assert found["control_points"] >= found["computed_points"] == found["control_loops"]
    assert Path(found["picture"]).read_bytes()[:4] == b"\x89PNG"
    rows = list(csv.DictReader(Path(found["table"]).read_text().splitlines()))
    assert len(rows) == found["control_points"]
    assert set(rows[0]) == {"contour", "x_mm", "y_mm", "z_mm", "centre", "computed"}


def test_database_is_stored_where_the_method_looks(tmp_path):
    from isf_core.files.job import load_job
    from isf_springback.database.database import database_of

    found = isf("database", JOB, "--workers", 0)
    assert found["power_law_r2_min"] > 0.99
    stored = database_of(load_job(JOB))
    assert stored is not None
    assert len(stored.levels) == found["levels"]
    again = isf("database", JOB, "--workers", 0, "-o", tmp_path / "db.json")
    assert len(Database.load(Path(again["database"])).levels) == found["levels"]


def test_the_database_of_a_part_is_made_once_before_it_and_not_for_methods_without(tmp_path, monkeypatch, capsys):
    from isf_cell.commands.elastic_database import prepare_database
    from isf_core.files.job import load_job
    from isf_springback.database.database import database_of

    job_file, said = load_job(JOB), []
    prepare_database(job_file, "analytic", said.append)
    assert (said, database_of(job_file)) == ([], None)
    prepare_database(job_file, "elastic", said.append)
    assert "depths" in said[-1]
    made = database_of(job_file)
    assert made is not None
    assert len(made.levels) == isf("database", JOB, "--workers", 0)["levels"]
    said.clear()
    prepare_database(job_file, "elastic", said.append)
    assert said == []
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ISF_CACHE_DIR", str(tmp_path / "file"))  # no folder
    prepare_database(job_file, "elastic", said.append)  # the part can be formed all the same
    assert "no springback database" in capsys.readouterr().err


def test_a_database_that_takes_long_says_so_once_and_what_does_without_it():
    from isf_cell.commands.elastic_database import DatabaseProgress

    said, now = [], [100.0]
    told = DatabaseProgress(said.append, clock=lambda: now[0])
    told.progress(0, 6)
    now[0] = 129.0
    assert told.poll() is False
    assert said == ["springback database: 0 of 6 depths"]
    for now[0] in (130.0, 131.0, 400.0):
        assert told.poll() is False  # it is computed on
    assert len(said) == 2
    assert said[1].startswith("springback database: 0 of 6 depths, still at it after 30 s")
    assert "--correction analytic" in said[1]
    told.progress(1, 6)
    assert said[2] == said[1].replace("0 of 6", "1 of 6")


def test_calibrate_answers_with_fields_of_the_job(tmp_path):
    curve = tmp_path / "push.csv"
    curve.write_text("force_N,displacement_mm\n60,1.90\n240,3.91\n400,5.00\n")
    found = isf("calibrate", JOB, curve)
    assert found["edge_slope"] == "clamped"
    assert found["rms_mm"] < 0.1
    assert found["rms_of_largest"] == pytest.approx(found["rms_mm"] / 5.0)
    assert found["remarks"] == []
    assert min(found["plain_rms_mm"], key=found["plain_rms_mm"].get) == "clamped, free in plane"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("predict", JOB, "--direction", "up"), ErrorCode.FILE_FIELD),
        (("predict", JOB, "--force", -5), ErrorCode.FILE_FIELD),
        (("calibrate", JOB, "none.csv"), ErrorCode.FILE_NOT_FOUND),
        (("compare", JOB, "--methods", "none,magic"), ErrorCode.METHOD_UNKNOWN),
        (("compare", JOB, "--methods", ","), ErrorCode.METHOD_UNKNOWN),
    ],
)
def test_mistakes_have_a_code(words, code):
    with pytest.raises(IsfError) as failure:
        isf(*words)
    assert failure.value.code == code


@pytest.mark.slow
def test_compare_forms_the_part_with_every_method(tmp_path):
    found = isf("compare", JOB, "--methods", "none,elastic", "-o", tmp_path / "out")
    none, elastic = found["methods"]
    assert none["code"] == elastic["code"] == 0
    assert elastic["base_signed_mm"] < none["base_signed_mm"]
    assert elastic["slowest_correction_ms"] < 1000
    assert Path(found["picture"]).is_file()
