"""``isf describe``: rigs by name and file, jobs, and what is none of these."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from isf_cell.commands.describe import describe_cell
from isf_core.errors import ErrorCode, IsfError

EXAMPLES = Path(__file__).resolve().parents[5] / "examples" / "jobs"


def test_a_rig_by_name_and_by_file_and_a_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("my_rig.yaml").write_text("based_on: torrao2013\nname: my_rig\nlimits: {speed: 80 mm/s}\n")
    found = {}
    for name in ("ren2018", "my_rig.yaml", str(EXAMPLES / "spif_cone.yaml")):
        describe_cell(name, "left_", None, as_json=True)
        found[name] = json.loads(capsys.readouterr().out)
        robot = ElementTree.parse(found[name]["urdf"]).getroot()
        assert {link.attrib["name"] for link in robot.findall("link")} == set(found[name]["links"])
        assert Path(found[name]["rig"]).is_absolute()
    rig, own, job = found.values()
    assert (rig["urdf"], own["urdf"], job["urdf"]) == ("ren2018.urdf", "my_rig.urdf", "spif_cone.urdf")
    assert (rig["spindle_cells"], own["spindle_cells"]) == ([], [1])
    assert [found["tilts"] for found in (rig, own, job)] == [False, True, False]
    assert rig["joints"] == [f"left_tool_{k}_{axis}" for k in (1, 2) for axis in "xyz"]
    assert "left_tool_2" not in job["links"]  # SPIF
    speeds = [item.attrib["velocity"] for item in ElementTree.parse("my_rig.urdf").iter("limit")]
    assert "0.08" in speeds


def test_what_cannot_be_described_or_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for name, prefix, output, code in (
        ("nothing", "", None, ErrorCode.FILE_NOT_FOUND),
        (str(tmp_path / "no.yaml"), "", None, ErrorCode.FILE_NOT_FOUND),
        ("ren2018", "a b", None, ErrorCode.FILE_FIELD),
        ("ren2018", "", tmp_path / "file" / "cell.urdf", ErrorCode.FILE_NOT_WRITABLE),
    ):
        with pytest.raises(IsfError) as caught:
            describe_cell(name, prefix, output, as_json=True)
        assert caught.value.code == code


def test_a_cell_for_ros2_control_has_its_controllers_beside_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, rate in (("ren2018", 500), (str(EXAMPLES / "mini_cone.yaml"), 500), ("kr210_pair", 500)):
        describe_cell(name, "", tmp_path / "cell.urdf", as_json=True, ros2_control=True)
        found = json.loads(capsys.readouterr().out)
        assert found["controllers"] == str(tmp_path / "cell_controllers.yaml")
        known = yaml.safe_load(Path(found["controllers"]).read_text())
        assert known["/**/controller_manager"]["ros__parameters"]["update_rate"] == rate
        system = ElementTree.parse(found["urdf"]).getroot().find("ros2_control")
        assert system is not None
        joints = [joint.attrib["name"] for joint in system.findall("joint")]
        commanded = [known[f"/**/tool_{k}"]["ros__parameters"]["joints"] for k in (1, 2)]
        assert joints == [*commanded[0], *commanded[1]]
    with pytest.raises(IsfError, match="names of the machine's"):
        describe_cell("ren2018", "left_", None, as_json=True, ros2_control=True)
