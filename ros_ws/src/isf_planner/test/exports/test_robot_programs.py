"""Programs of robots: frames and poses put together again lead the arm to the planned tips; two arms go together."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.geometry.serial_arm import SerialArm
from isf_planner import Plan, exports, plan

EXAMPLES = Path(__file__).resolve().parents[5] / "examples" / "jobs"
NUMBER = r"(-?[0-9.]+)"
Arms = tuple[SerialArm | None, SerialArm | None]
Made = tuple[Plan, Arms]


def planned(name: str) -> Made:
    text = (EXAMPLES / name).read_text().replace("incremental_depth: 0.5 mm", "incremental_depth: 1.5 mm")
    job_file = JobFile(text.replace("point_spacing: 0.5 mm", "point_spacing: 2 mm"), EXAMPLES, name)
    return plan(job_file), (job_file.rig.arm(1), job_file.rig.arm(2))


@pytest.fixture(scope="module")
def one() -> Made:
    return planned("robot_cone.yaml")


@pytest.fixture(scope="module")
def pair() -> Made:
    return planned("robot_pair_cone.yaml")


def kuka(x: float, y: float, z: float, a: float, b: float, c: float) -> np.ndarray:
    """(4, 4) of a KUKA frame: mm, turned about z by A, then about the new y by B, then about the new x by C, deg."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(np.radians([a, b, c])), np.sin(np.radians([a, b, c]))
    about_z = np.array([[ca, -sa, 0], [sa, ca, 0], [0, 0, 1]])
    about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    about_x = np.array([[1, 0, 0], [0, cc, -sc], [0, sc, cc]])
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = about_z @ about_y @ about_x, [x, y, z]
    return frame


def by_quaternion(place: list[float], quaternion: list[float]) -> np.ndarray:
    """(4, 4) of an ABB pose: mm and w x y z."""
    w, *v = quaternion
    v = np.array(v)
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    frame = np.eye(4)
    frame[:3, :3] = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    frame[:3, 3] = place
    return frame


def flange_of(joints: list[float]) -> np.ndarray:
    """(4, 4) mm, flange of a KR 210 R2700 extra in its base for joints in deg, by Denavit-Hartenberg matrices."""

    def link(angle: float, offset: float, length: float, twist: float) -> np.ndarray:
        c, s, ct, st = np.cos(angle), np.sin(angle), np.cos(twist), np.sin(twist)
        return np.array(
            [[c, -s * ct, s * st, length * c], [s, c * ct, -c * st, length * s], [0, st, ct, offset], [0, 0, 0, 1.0]]
        )

    a, quarter = np.radians(joints), np.pi / 2
    return np.linalg.multi_dot(
        [
            link(-a[0], 675, 350, -quarter),
            link(a[1], 0, 1150, 0),
            link(a[2] - quarter, 0, -41, -quarter),
            link(-a[3], 1200, 0, quarter),
            link(a[4], 0, 0, -quarter),
            link(-a[5], 215, 0, 0),
        ]
    )


def frames_of(line: str) -> np.ndarray:
    return kuka(*[float(value) for value in re.findall(rf"[XYZABC] {NUMBER}", line)])


def tips_of(result: Plan, tool: int) -> np.ndarray:
    """(N, 3) mm, planned tips in the order of a program, closed contours to their first point again."""
    tips = [one.forming_tip if one.forming_tool == tool else one.support_tip for one in result.contours]
    closed = [
        np.vstack([path, path[:1]]) if one.closed else path for one, path in zip(result.contours, tips, strict=True)
    ]
    return 1e3 * np.vstack(closed)


@pytest.mark.parametrize(("case", "tool"), [("one", 1), ("pair", 1), ("pair", 2)])
def test_krl_leads_the_arm_to_the_planned_joints_and_tips(
    case: str, tool: int, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    result, arms = request.getfixturevalue(case)
    files = exports.export(result, tmp_path / "part.src", None, arms)
    table = exports.export(result, tmp_path / "joints.csv", "joints", arms)[0]
    lines = files[tool - 1].read_text().splitlines()
    base = frames_of(next(line for line in lines if line.startswith("$BASE=")))
    held = frames_of(next(line for line in lines if line.startswith("$TOOL=")))
    points = [frames_of(line) for line in lines if line.endswith("C_DIS")]
    tips = tips_of(result, tool)
    assert len(points) == len(tips)
    np.testing.assert_allclose([point[:3, 3] for point in points], tips, atol=1e-5)
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    joints = rows[:, 6:12] if case == "one" else rows[:, 10:16] if tool == 1 else rows[:, 16:22]
    for k in range(0, len(points), 25):
        flange = base @ points[k] @ np.linalg.inv(held)
        other = flange_of(joints[k])
        np.testing.assert_allclose(flange[:3, 3], other[:3, 3], atol=1e-3)  # 1 um
        np.testing.assert_allclose(flange[:3, 2], other[:3, 2], atol=1e-6)
    # the shank leaves the sheet on the tool's own side
    assert points[0][2, 2] == pytest.approx(-1.0 if tool == 1 else 1.0)
    start = next(line for line in lines if line.startswith("PTP "))
    lifted = frames_of(next(line for line in lines if line.startswith("LIN {X")))
    # clear of the sheet plane and the formed sheet
    assert lifted[2, 3] == pytest.approx(20.0 if tool == 1 else tips[:, 2].min() - 20.0, abs=1e-3)
    above = base @ lifted @ np.linalg.inv(held)
    np.testing.assert_allclose(
        flange_of([float(value) for value in re.findall(rf"A[1-6] {NUMBER}", start)])[:3, 3], above[:3, 3], atol=1e-3
    )


def test_rapid_leads_the_arm_as_krl_does(one: Made, tmp_path: Path) -> None:
    result, arms = one
    text = exports.export(result, tmp_path / "part.mod", None, arms)[0].read_text()
    four = rf"\[{NUMBER},{NUMBER},{NUMBER},{NUMBER}\]"
    three = rf"\[{NUMBER},{NUMBER},{NUMBER}\]"
    sheet = [float(v) for v in re.search(rf'wobjdata isfSheet:=\[FALSE,TRUE,"",\[{three},{four}\]', text).groups()]  # type: ignore[union-attr]
    held = [float(v) for v in re.search(rf"tooldata isfTool:=\[TRUE,\[{three},\[1,0,0,0\]\]", text).groups()]  # type: ignore[union-attr]
    points = re.findall(rf"MoveL \[{three},{four}.*,z0,", text)
    tips = tips_of(result, 1)
    assert len(points) == len(tips)
    joints = [float(v) for v in re.search(rf"MoveAbsJ \[\[{','.join([NUMBER] * 6)}\]", text).groups()]  # type: ignore[union-attr]
    first = [float(value) for value in points[0]]
    first[2] = 20.0  # the arm begins above the first point
    flange = by_quaternion(sheet[:3], sheet[3:]) @ by_quaternion(first[:3], first[3:])
    flange = flange @ np.linalg.inv(by_quaternion(held, [1.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(flange[:3, 3], flange_of(joints)[:3, 3], atol=1e-3)
    assert len({tuple(point[3:]) for point in points}) == 1  # one orientation, written in one way


def test_both_arms_move_to_simultaneous_points_under_the_same_id(pair: Made, tmp_path: Path) -> None:
    result, arms = pair
    files = exports.export(result, tmp_path / "part.mod", None, arms)
    pattern = re.compile(rf"MoveL \[\[{NUMBER},{NUMBER},{NUMBER}\].*\\ID:=([0-9]+),\[{NUMBER},500.*,(z0|fine),")
    found = []
    for number, file in enumerate(files, start=1):
        text = file.read_text()
        assert text.count("SyncMoveOn isfOn, isfTasks;") == text.count("SyncMoveOff isfOff;") == 1
        assert 'PERS tasks isfTasks{2}:=[["T_ROB1"],["T_ROB2"]];' in text
        inside = text[text.index("SyncMoveOn") : text.index("SyncMoveOff")]
        rows = [match.groups() for match in pattern.finditer(text)]
        assert len(rows) == inside.count("MoveL")  # no move without an ID while the arms are coupled
        found.append({int(row[3]): row for row in rows})
        assert len(found[-1]) == len(rows)  # no ID twice
        points = np.array([[float(v) for v in row[:3]] for row in rows if row[5] == "z0"])
        np.testing.assert_allclose(points, tips_of(result, number), atol=1e-5)
    assert found[0].keys() == found[1].keys()
    upper, lower = tips_of(result, 1), tips_of(result, 2)
    planned_pairs = {tuple(np.round([*a, *b], 4)) for a, b in zip(upper, lower, strict=True)}
    for ident, row in found[0].items():
        other = found[1][ident]
        assert row[5] == other[5]
        if row[5] == "z0":
            together = np.round([float(v) for v in (*row[:3], *other[:3])], 4)
            assert min(np.abs(np.array(one) - together).max() for one in planned_pairs) < 2e-4


def test_both_arms_take_the_same_time_and_wait_for_each_other(pair: Made, tmp_path: Path) -> None:
    result, arms = pair
    times, waits = [], []
    for file in exports.export(result, tmp_path / "part.src", None, arms):
        speed, last, spent, phases = 0.0, None, [], []
        for line in file.read_text().splitlines():
            if line.startswith("$VEL.CP="):
                speed = 1e3 * float(line.split("=")[1])
            if line.startswith("$OUT[1]="):
                phases.append(line.split("=")[1])
                last = None
            if line.startswith("WAIT FOR $IN[1]=="):
                assert line.split("==")[1] == phases[-1]
            if line.startswith("LIN {X"):
                here = frames_of(line)[:3, 3]
                if last is not None and line.endswith("C_DIS"):
                    spent.append(np.linalg.norm(here - last) / speed)
                last = here if line.endswith("C_DIS") else None
        times.append(np.array(spent))
        waits.append(phases)
    assert len(times[0]) == len(times[1]) > 50
    np.testing.assert_allclose(times[0], times[1], rtol=2e-3, atol=1e-4)
    assert (
        waits[0] == waits[1] == ["TRUE", "FALSE"] * (len(result.contours) // 2) + ["TRUE"] * (len(result.contours) % 2)
    )


def test_roboteam_names_the_same_place_in_both(pair: Made, tmp_path: Path) -> None:
    result, arms = pair
    files = exports.export(result, tmp_path / "part.src", "krl_roboteam", arms)
    labels = [re.findall(r'SYNCCMD\(#ProgSync,"(C\d+)",3\)', file.read_text()) for file in files]
    assert labels[0] == labels[1] == [f"C{k + 1}" for k in range(len(result.contours))]


def test_without_arms_programs_are_those_of_the_controllers_frames(pair: Made, tmp_path: Path) -> None:
    result, _ = pair
    files = exports.export(result, tmp_path / "part.src")
    assert "$BASE" not in files[0].read_text()
    with pytest.raises(IsfError, match="no program for two tools") as caught:
        exports.export(result, tmp_path / "part.csv", "joints")
    assert caught.value.code is ErrorCode.EXPORT_FORMAT_UNKNOWN


def test_programs_of_arms_read_back(pair: Made, tmp_path: Path) -> None:
    result, arms = pair
    for name, form in (("part.src", "krl"), ("part.mod", "rapid")):
        upper, lower = exports.export(result, tmp_path / name, form, arms)
        for file, tool in ((upper, 1), (lower, 2)):
            contours = exports.read_programs([file], exports.load_post(form))
            assert len(contours) == len(result.contours)
            for found, one in zip(contours, result.contours, strict=True):
                tips = one.forming_tip if one.forming_tool == tool else one.support_tip
                np.testing.assert_allclose(found[tool - 1], tips, atol=1e-6)
