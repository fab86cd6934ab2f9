"""Job, rig and material files: every fault is told with file, line, field and advice."""

from pathlib import Path

import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files import yaml_file
from isf_core.files.job import Job, JobFile, load_job, springback_method
from isf_core.files.material import load_material
from isf_core.files.rig import load_rig
from isf_core.files.yaml_file import share_directory

GOOD = """\
name: cone
part: {mesh: cone.stl, unit: mm}
process: DSIF
rig: ren2018
sheet:
  material: AA5754-O
  thickness: 1.0 mm
tool_1: {radius: 5 mm}
tool_2: {radius: 5 mm}
path:
  incremental_depth: 0.5 mm
  point_spacing: 0.5 mm
  feed: 30 mm/s
control: {support_force: 120 N}
"""


def parse(text: str) -> Job:
    return yaml_file.parse(text, Job, "job.yaml")


def test_quantities_become_si() -> None:
    job = parse(GOOD)
    assert job.sheet.thickness == pytest.approx(1e-3)
    assert job.path.feed == pytest.approx(0.03)
    assert job.control.support_force == 120.0
    assert parse(GOOD.replace("1.0 mm", "0.0394 in")).sheet.thickness == pytest.approx(1.00076e-3)


@pytest.mark.parametrize(
    ("old", "new", "code", "place", "words"),
    [
        ("thickness: 1.0 mm", "thikness: 1.0 mm", ErrorCode.FILE_FIELD, "job.yaml:7", "did you mean 'thickness'"),
        (
            "120 N}",
            "120 N, ratee: 5 Hz}",
            ErrorCode.FILE_FIELD,
            "job.yaml:14",
            "control.ratee' (did you mean 'rate'?",
        ),
        (
            "120 N}",
            "120 N, force_rules: [{force: 9 N},\n  {wal_angle: [0 deg, 9 deg], force: 9 N}]}",
            ErrorCode.FILE_FIELD,
            "job.yaml:15",
            "control.force_rules.2.wal_angle' (did you mean 'wall_angle'?",
        ),
        (
            "120 N}",
            "120 N}\nsupport_force: 9 N",
            ErrorCode.FILE_FIELD,
            "job.yaml:15",
            "did you mean 'control.support_force'?",
        ),
        ("120 N}", "120 N, horizon: 4}", ErrorCode.FILE_FIELD, "job.yaml:14", "did you mean 'springback.mpc.horizon'?"),
        ("120 N}", "120 N, xyz: 4}", ErrorCode.FILE_FIELD, "job.yaml:14", "known here: rate, support_force"),
        ("thickness: 1.0 mm", "thickness: 1.0", ErrorCode.FILE_UNIT, "job.yaml:7", "has no unit"),
        ("thickness: 1.0 mm", "thickness: 1.0 N", ErrorCode.FILE_UNIT, "job.yaml:7", "not a quantity in m"),
        ("thickness: 1.0 mm", "thickness: 1 m", ErrorCode.FILE_FIELD, "job.yaml:7", "1000 mm must be less than 10 mm"),
        ("120 N}", "120 N, engage_wall_angle: 2 rad}", ErrorCode.FILE_FIELD, "job.yaml:14", "less than 90"),
        (
            "120 N}",
            "9 kN}",
            ErrorCode.FILE_FIELD,
            "job.yaml:14",
            "support_force: 9 kN must be less than or equal to 1500 N (or 'auto')",
        ),
        ("120 N}", "120 N, vertical_force: -1 N}", ErrorCode.FILE_FIELD, "job.yaml:14", "-1 N must be greater than or"),
        (
            "120 N}",
            "120 N, rate: 5 Hz}",
            ErrorCode.FILE_FIELD,
            "job.yaml:14",
            "5 Hz must be greater than or equal to",
        ),
        (
            "120 N}",
            "120 N}\nspringback: {open_loop_contours: -1}",
            ErrorCode.FILE_FIELD,
            "job.yaml:15",
            "open_loop_contours: Input should be greater than or equal to 0",
        ),
        ("thickness: 1.0 mm", "thickness: nan mm", ErrorCode.FILE_UNIT, "job.yaml:7", "nan"),
        ("thickness: 1.0 mm", "thickness: one", ErrorCode.FILE_UNIT, "job.yaml:7", "not a number with a unit"),
        ("feed: 30 mm/s", "feed: 30 mm", ErrorCode.FILE_UNIT, "job.yaml:13", "not a quantity in m/s"),
        ("feed: 30 mm/s", "feed: -3 mm/s", ErrorCode.FILE_FIELD, "job.yaml:13", "greater than"),
        ("process: DSIF", "process: DISF", ErrorCode.FILE_FIELD, "job.yaml:3", "SPIF"),
        ("tool_2: {radius: 5 mm}\n", "", ErrorCode.FILE_FIELD, "job.yaml:1", "needs tool_2"),
        ("process: DSIF", "process: SPIF", ErrorCode.FILE_FIELD, "job.yaml:1", "no support tool"),
        ("name: cone", f"name: {81 * 'c'}", ErrorCode.FILE_FIELD, "job.yaml:1", "name: String should have at most 80"),
        ("name: cone\n", "", ErrorCode.FILE_FIELD, "job.yaml:1", "'name' is missing"),
        ("name: cone", "name: [", ErrorCode.FILE_SYNTAX, "job.yaml:", ""),
        ("unit: mm", "unit: furlong", ErrorCode.FILE_FIELD, "job.yaml:2", "'mm'"),
    ],
)
def test_a_wrong_field_is_reported_with_its_place(old: str, new: str, code: ErrorCode, place: str, words: str) -> None:
    with pytest.raises(IsfError) as caught:
        parse(GOOD.replace(old, new))
    assert caught.value.code == code
    assert caught.value.where.startswith(place)
    assert words in caught.value.message


@pytest.mark.parametrize(
    ("old", "advice"),
    [
        ("  feed: 30 mm/s\n", "add 'feed', a number in mm/s"),
        ("process: DSIF\n", "add 'process'"),
        ("tool_1: {radius: 5 mm}\n", "add the section 'tool_1', with "),
    ],
)
def test_what_to_write_for_a_missing_field_is_told(old: str, advice: str) -> None:
    assert old in GOOD
    with pytest.raises(IsfError) as caught:
        parse(GOOD.replace(old, ""))
    assert caught.value.advice.startswith(advice)


@pytest.mark.parametrize("text", ["", "- a\n- b\n", "42"])
def test_what_is_not_a_mapping_is_refused(text: str) -> None:
    with pytest.raises(IsfError) as caught:
        parse(text)
    assert caught.value.code == ErrorCode.FILE_SYNTAX


def test_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(IsfError, match="no such file") as caught:
        load_job(tmp_path / "nowhere.yaml")
    assert caught.value.code == ErrorCode.FILE_NOT_FOUND
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(IsfError) as caught:
        load_job(tmp_path / "binary.yaml")
    assert caught.value.code == ErrorCode.FILE_SYNTAX


def test_an_unknown_material_lists_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "job.yaml").write_text(GOOD.replace("AA5754-O", "unobtainium"))
    with pytest.raises(IsfError, match="AA1100-O") as caught:
        load_job(tmp_path / "job.yaml")
    assert caught.value.code == ErrorCode.FILE_NOT_FOUND


def test_paths_are_relative_to_the_job_file(tmp_path: Path) -> None:
    (tmp_path / "job.yaml").write_text(GOOD)
    assert load_job(tmp_path / "job.yaml").mesh == (tmp_path / "cone.stl").resolve()
    assert JobFile(GOOD, tmp_path).rig.name == "ren2018"


def test_a_material_without_provenance_is_refused(tmp_path: Path) -> None:
    text = (share_directory() / "materials" / "AA5754-O.yaml").read_text()
    own = tmp_path / "own.yaml"
    own.write_text("\n".join(line for line in text.splitlines() if not line.startswith("  friction")))
    with pytest.raises(IsfError, match="provenance is missing for friction"):
        load_material("own.yaml", tmp_path)


def test_every_shared_file_loads() -> None:
    materials = sorted((share_directory() / "materials").glob("*.yaml"))
    rigs = sorted((share_directory() / "rigs").glob("*.yaml"))
    assert materials
    assert rigs
    for path in materials:
        assert load_material(path.stem).name == path.stem
    for path in rigs:
        assert load_rig(path.stem).name == path.stem


ADSIF = GOOD.replace("process: DSIF", "process: ADSIF").replace("control: {support_force: 120 N}\n", "")


@pytest.mark.parametrize(
    ("more", "field", "words"),
    [
        ("springback:\n  gain: 1.0\n  method: analytic\n", "springback.method", "constant depth"),
        ("control:\n  rate: 500 Hz\n  support_force: 120 N\n", "control.support_force", "no force control"),
        ("control:\n  rate: 500 Hz\n  support_force: auto\n", "control.support_force", "no force control"),
    ],
)
def test_adsif_refuses_what_would_move_its_tools_off_their_plane(more: str, field: str, words: str) -> None:
    """Its tools stay at the projection distance; nothing a person wrote down is dropped in silence."""
    with pytest.raises(IsfError, match=words) as caught:
        parse(ADSIF + more)
    assert caught.value.code == ErrorCode.FILE_FIELD
    assert caught.value.where == "job.yaml:16"
    assert caught.value.what.startswith(f"{field}: ")
    assert caught.value.advice
    assert parse(ADSIF + "springback: {method: none}\ncontrol: {support_force: 0 N}\n").control.support_force == 0.0


def test_a_support_tool_presses_by_itself_where_the_job_does_not_say(tmp_path: Path) -> None:
    """DSIF without support_force: chosen as for auto; position control has to be asked for."""
    left_out = GOOD.replace("control: {support_force: 120 N}\n", "")
    (tmp_path / "job.yaml").write_text(left_out)
    assert load_job(tmp_path / "job.yaml").job.support_force_at() > 0.0
    assert parse(left_out + "control: {rate: 500 Hz}\n").control.support_force == "auto"
    assert parse(left_out + "control: {support_force: 0 N}\n").control.support_force == 0.0
    on_blank = left_out.replace("feed: 30 mm/s", "feed: 30 mm/s\n  support: on_blank")
    assert parse(on_blank).control.support_force == 0.0
    assert parse(ADSIF).control.support_force == 0.0
    alone = left_out.replace("process: DSIF", "process: SPIF").replace("tool_2: {radius: 5 mm}\n", "")
    assert parse(alone).control.support_force == 0.0


SPIF = GOOD.replace("process: DSIF", "process: SPIF").replace("control: {support_force: 120 N}\n", "")
TPIF = SPIF.replace("process: SPIF", "process: TPIF\ndie: {mesh: die.stl, unit: mm}")
ADSIF = GOOD.replace("process: DSIF", "process: ADSIF").replace("control: {support_force: 120 N}\n", "")


@pytest.mark.parametrize(
    ("text", "section", "method"),
    [
        (GOOD, "", "elastic"),
        (SPIF, "", "elastic"),
        (SPIF, "gain: 0.9", "elastic"),
        (SPIF, "method: auto", "elastic"),
        (SPIF, "scan_every: 1", "fused"),
        (SPIF, "method: fused, scan_every: 1", "fused"),
        (SPIF, "scan_every: 1, learning: cone.json", "learned"),
        (TPIF, "", "none"),
        (TPIF, "scan_every: 1", "mpc_tpif"),
        (ADSIF, "", "none"),
        (SPIF.replace("point_spacing: 0.5 mm", "program: part.nc"), "", "none"),
        (SPIF.replace("feed:", "compensation: [sheet]\n  feed:"), "", "none"),
        (SPIF, "method: none", "none"),
    ],
)
def test_parts_are_corrected_by_what_the_cell_has_unless_the_job_names_a_method(
    text: str, section: str, method: str
) -> None:
    spec = parse(text + (f"springback: {{{section}}}\n" if section else "")).springback
    assert spec.method == method


def test_auto_may_be_asked_for_beside_a_job_that_names_a_method() -> None:
    job = parse(SPIF + "springback: {method: analytic, scan_every: 1}\n")
    assert [springback_method(job, name) for name in (None, "", "none", "auto")] == [
        "analytic",
        "analytic",
        "none",
        "fused",
    ]


def test_a_job_on_a_machine_of_more_force_keeps_what_the_real_one_bears() -> None:
    """Rig ren2018 bears 1.5, 1.5 and 2 kN; its load cells read as much."""
    job = JobFile(GOOD, Path())
    stronger = job.with_force_raised(1.8)
    assert stronger.rig.limits.force == pytest.approx((2700.0, 2700.0, 3600.0))
    assert stronger.rig.load_cell.force_range == pytest.approx((2700.0, 2700.0, 3600.0))
    assert stronger.rig_force == job.rig_force == job.rig.limits.force == (1500.0, 1500.0, 2000.0)
    assert stronger.with_force_raised(1.8) is stronger
    assert (stronger.force_raised, job.force_raised) == (1.8, 1.0)
    assert job.with_force_raised(1.0) is job
