"""A whole part through real nodes in real processes over real DDS, against the same cores in one process."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
import yaml
from isf_analysis.bag.bag_reader import read_bag
from isf_analysis.measures.record import PartRecord
from isf_cell import in_process
from isf_cell.commands.exit_codes import Exit
from isf_cell.options import RunOptions
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.replay.outcome import replay
from isf_cell.replay.recorded_run import read_run
from isf_cell.replay.what_if import parse
from isf_cell.run import graph_run
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile, load_job
from isf_core.files.yaml_file import find_named
from isf_ros.stamps import to_seconds
from quick_cone import LONGER, quick_cone, quick_cone_file
from rosbags.highlevel import AnyReader

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("forked_nodes")]

ROOT = Path(__file__).resolve().parents[2]
JOB = ROOT / "examples" / "jobs" / "mini_cone.yaml"


def quiet(_: Any) -> None:
    """Feedback that nobody looks at."""


def few_ticks() -> JobFile:
    """The small cone with its own correction, at a rate that a loop gain of 36 1/s is stable at."""
    cone = quick_cone("method: elastic", step=LONGER)
    assert "rate: 100 Hz" in cone.text
    return JobFile(cone.text.replace("rate: 100 Hz", "rate: 150 Hz"), cone.base)


@pytest.fixture(scope="module")
def graph_run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run of the small cone, formed once through the node graph in lockstep."""
    folder = tmp_path_factory.mktemp("graph")
    steps: list[int] = []
    result, failure = graph_run.form(
        few_ticks(), RunOptions(seed=3), folder, lambda m: steps.append(m.index) if m.phase == "forming" else None
    )
    assert failure is None
    assert result.lost_messages == 0
    assert result.late_ticks == 0
    assert steps == list(range(result.contours))
    return folder


@pytest.fixture(scope="module")
def graph_record(graph_run_folder: Path) -> PartRecord:
    """The same read back from its bag."""
    return read_bag(graph_run_folder / "bag")


def test_the_bag_holds_the_whole_part(graph_record: PartRecord) -> None:
    assert graph_record.failure() is None
    assert graph_record.formed == graph_record.planned == len(graph_record.corrections)
    assert graph_record.job_name == "mini_cone"
    assert graph_record.lockstep
    (warned,) = graph_record.plan_warnings
    assert warned.startswith("the sheet is free for 114 mm between the part and the clamp")
    assert graph_record.scan is not None
    assert graph_record.target is not None


def test_the_bag_alone_shows_the_cell(graph_run_folder: Path) -> None:
    """Frames from the sheet to both tips over all the part, the machine, the blank and then the scan, every contour."""
    with AnyReader([graph_run_folder / "bag"]) as reader:
        said = [(item.topic, reader.deserialize(raw, item.msgtype)) for item, _, raw in reader.messages()]
    of = {topic: [message for name, message in said if name == topic] for topic in {name for name, _ in said}}
    parents = {
        item.child_frame_id: item.header.frame_id
        for message in of["/tf"] + of["/tf_static"]
        for item in message.transforms
    }
    for frame in ("tool_1", "tool_2"):
        while frame != "sheet":
            frame = parents[frame]
    assert "<robot" in of["/robot_description"][-1].data
    assert [len(message.points) > 100 for message in (of["/part/sheet"][0], of["/part/sheet"][-1])] == [False, True]
    assert len(of["/contour/path"]) == len(of["/contour/result"])
    moments = [to_seconds(item.header.stamp) for message in of["/tf"] for item in message.transforms]
    poses = [to_seconds(message.header.stamp) for message in of["/tool_1/pose"]]
    assert min(moments) < poses[0] + 0.05 * poses[-1]
    assert max(moments) > 0.95 * poses[-1]


def test_graph_and_in_process_agree(graph_record: PartRecord) -> None:
    """The contract of docs/reference/architecture.md: 1 um and 0.1 N, contour by contour and in the final shape."""
    alone = in_process.form(few_ticks(), RunOptions(seed=3))
    assert len(alone.results) == len(graph_record.results)
    assert alone.plan_warnings == graph_record.plan_warnings
    for mine, theirs in zip(alone.results, graph_record.results, strict=True):
        assert len(mine.tick_time) == len(theirs.tick_time)
        np.testing.assert_allclose(theirs.forming_target, mine.forming_target, atol=1e-6)
        np.testing.assert_allclose(theirs.support_target, mine.support_target, atol=1e-6)
        np.testing.assert_allclose(theirs.forming_force, mine.forming_force, atol=0.1)
        np.testing.assert_allclose(theirs.support_force, mine.support_force, atol=0.1)
    for mine, theirs in zip(alone.corrections, graph_record.corrections, strict=True):
        np.testing.assert_allclose(theirs.offset, mine.offset, atol=1e-6)
    assert alone.scan is not None
    assert graph_record.scan is not None
    np.testing.assert_allclose(graph_record.scan.z, alone.scan.z, atol=1e-6)
    here, there = alone.formed_sheet, graph_record.formed_sheet
    assert here is not None
    assert there is not None
    np.testing.assert_allclose(there.points, here.points, atol=1e-6)
    np.testing.assert_allclose(there.thickness, here.thickness, atol=1e-6)
    np.testing.assert_allclose(there.strain_margin, here.strain_margin, atol=1e-3)


def test_a_recorded_part_is_decided_again_bit_for_bit(graph_run_folder: Path) -> None:
    """Every target and every correction; a wrench that is off by the last bit that matters shows, as does a gain."""
    run = read_run(graph_run_folder)
    assert run.ticks is not None
    assert run.armed is not None
    found = replay(run, parse([]))
    numbers = found.numbers()
    # on a busy computer the recorder may lose a target (and says so), never what the tick was made from
    known = np.isfinite(run.ticks.target).all(axis=1)
    expected = True if known.all() else None
    told = json.dumps({name: numbers[name] for name in ("targets", "results", "corrections")})
    assert found.identical is expected, told
    assert numbers["targets"]["compared"] == known.sum() > 3_000
    assert numbers["targets"]["not_replayed"] == 0
    assert numbers["corrections"]["compared"] == numbers["results"]["compared"] == run.part.planned
    wrench = run.ticks.wrench.copy()
    wrench[len(wrench) // 2, 0] += 0.005  # N, sideways on the forming tool
    assert replay(replace(run, ticks=replace(run.ticks, wrench=wrench)), parse([])).identical is False
    lost = np.where(np.arange(len(known))[:, None] % 100, run.ticks.target, np.nan)
    lossy = replay(replace(run, ticks=replace(run.ticks, target=lost)), parse([]))
    assert lossy.identical is None
    assert any(f"the targets of {(~np.isfinite(lost)).any(axis=1).sum()} ticks" in note for note in lossy.notes)
    assert lossy.numbers()["targets"]["differing"] == 0
    assert 0 < lossy.numbers()["targets"]["compared"] < known.sum()
    other = replay(run, parse(["force.loop_gain=36", "springback.gain=0.5"]), replant=False)
    assert other.identical is False
    assert 1.0 < other.numbers()["targets"]["largest_um"] < 500.0
    assert other.numbers()["corrections"]["largest_mm"] > 1.0


def test_a_recorded_part_is_formed_again_from_a_contour_on(graph_run_folder: Path) -> None:
    """What the nodes formed, formed in this process: the same to the last bit; with another gain only from there on."""
    run, number = read_run(graph_run_folder), 4
    assert replay(run, parse([]), start=number - 1).identical is True
    other = replay(run, parse(["force.loop_gain=36"]), start=number - 1)
    assert other.before is not None
    assert other.before.identical
    assert other.numbers()["results"]["first_contour"] == number - 1
    by_clock = replace(run, ticks=replace(run.ticks, exact=False))
    unknown = replay(by_clock, parse([]), start=number - 1)
    assert unknown.identical is None
    assert "by the clock" in unknown.identical_unknown


def test_a_part_that_the_machine_ended_is_decided_again_bit_for_bit(tmp_path: Path) -> None:
    """Its force limit is met in the second contour: the fault is no decision, and ends it at the same tick in both
    ways. The contour tells the fault, not what the wrenches look like after the machine has moved the tools clear."""
    rig = find_named("rigs", "ren2018").read_text()
    assert "force: [1500 N, 1500 N, 2000 N]" in rig
    (tmp_path / "weak.yaml").write_text(rig.replace("1500 N, 1500 N, 2000 N", "1500 N, 1500 N, 960 N"))
    job = quick_cone_file(tmp_path)
    job.write_text(job.read_text().replace("ren2018", "weak.yaml"))
    _, failure = graph_run.form(load_job(job), RunOptions(seed=3), tmp_path / "run", quiet)
    assert failure is not None
    assert failure.code == ErrorCode.FORCE_LIMIT
    run = read_run(tmp_path / "run")
    assert [result.completed for result in run.part.results] == [True, False]
    last = run.part.results[-1]
    assert last.code == ErrorCode.FORCE_LIMIT
    assert "the machine bears (1500, 1500, 960) N" in last.message
    for found in (replay(run, parse([])), replay(run, parse([]), start=1)):
        assert found.identical is True, json.dumps(found.numbers()["results"])


def test_examples_of_the_page_on_analysis_run(graph_run_folder: Path, tmp_path: Path) -> None:
    """Its Python and its commands, on the run of the small cone."""
    page = (ROOT / "docs" / "methods" / "analysis.md").read_text(encoding="utf-8")
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "NAME").symlink_to(graph_run_folder)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    blocks = dict.fromkeys(re.findall(r"^```(python|sh)\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL))
    commands = [line for kind, block in blocks if kind == "sh" for line in block.splitlines()]
    lines = [["-m", "isf_cell.cli", *shlex.split(line.removeprefix("./isf "))] for line in commands]
    lines += [["-c", block] for kind, block in blocks if kind == "python"]
    assert len(lines) >= 4
    for arguments in lines:
        done = forked_process.run([sys.executable, *arguments], cwd=tmp_path)
        assert done.returncode == Exit.OK, f"{arguments}: {done.stderr}"
    assert (tmp_path / "tables" / "tool_1_wrench.csv").is_file()
    assert (tmp_path / "out" / "replay.png").is_file()


def test_graph_and_in_process_agree_on_the_elasto_plastic_sheet(tmp_path: Path) -> None:
    """1 um and 0.1 N here too; the bag names the sheet. Of a force that its cells overstate the machine bears 1.8 times
    what its rig says, force control as well, and the contour that took it says so."""
    rig = find_named("rigs", "ren2018").read_text().replace("size: [250 mm, 250 mm]", "size: [100 mm, 100 mm]")
    assert "force: [1500 N, 1500 N, 2000 N]" in rig
    rig = rig.replace("force: [1500 N, 1500 N, 2000 N]", "force: [1500 N, 1500 N, 800 N]")
    (tmp_path / "small.yaml").write_text(rig)
    job = quick_cone_file(tmp_path)
    job.write_text(job.read_text().replace("unit: mm", "unit: mm\n  scale: 0.5").replace("ren2018", "small.yaml"))
    job_file, options = load_job(job), RunOptions(seed=3, sheet="shell_coarse", support_force=0.0)
    result, failure = graph_run.form(job_file, options, tmp_path, quiet)
    assert failure is None
    assert (result.late_ticks, result.lost_messages) == (0, 0)
    there, here = read_bag(tmp_path / "bag"), in_process.form(job_file, options)
    assert there.sheet["model"] == "shell_coarse"
    assert here.sheet["model"] == "shell_coarse"
    for mine, theirs in zip(here.results, there.results, strict=True):
        np.testing.assert_allclose(theirs.forming_force, mine.forming_force, atol=0.1)
    assert here.scan is not None
    assert there.scan is not None
    np.testing.assert_allclose(there.scan.z, here.scan.z, atol=1e-6)
    assert here.scan.z.min() < -1.5e-3  # a part: its target is 2.5 mm deep
    most = max(result.forming_force[:, 2].max() for result in there.results)
    assert 800.0 < most < 1440.0
    assert there.overload == here.overload
    assert "ren2018 bears 800 N" in there.overload


@pytest.mark.parametrize("victim", ["force_ctrl", "springback", "planner", "machine"])
def test_when_a_node_dies_the_machine_holds_and_the_executive_says_why(victim: str, tmp_path: Path) -> None:
    killed: list[str] = []

    def kill_after_second_contour(group: ProcessGroup) -> Callable[[Any], None]:
        def feedback(message: Any) -> None:
            if message.phase == "forming" and message.index == 1 and not killed:
                os.killpg(group[victim].popen.pid, signal.SIGKILL)
                killed.append(victim)

        return feedback

    result = formed_beside(kill_after_second_contour, tmp_path)
    assert killed == [victim]
    assert result.code == ErrorCode.NODE_DIED
    assert f"'{victim}'" in result.message
    assert result.contours >= 2
    record = read_bag(tmp_path / "bag")
    # what a process told last before it was killed need not have come to the recorder
    assert record.formed >= (1 if victim == "force_ctrl" else 2)
    if victim != "machine":
        assert record.faults, "the machine latched no fault"
    assert_nothing_left(tmp_path)


def formed_beside(
    disturbance: Callable[[ProcessGroup], Callable[[Any], None]], folder: Path, *, held_after: int | None = None
) -> Any:
    """Result of a quick cone in lockstep, formed while the feedback of ``disturbance`` acts on the cell's processes.

    ``held_after`` a contour, counted from 1, it waits: what the disturbance began comes while the part is there.
    """
    cone = quick_cone(step=LONGER)
    if held_after is not None:
        data = yaml.safe_load(cone.text)
        data["path"]["hold_after"] = [held_after]
        cone = JobFile(yaml.safe_dump(data), cone.base)
    client = graph_run.CellClient()
    try:
        with ProcessGroup(folder / "logs") as group:
            graph_run.start_cell(group, folder / "bag", lockstep=True)
            client.wait_ready(group)
            return client.form(cone, RunOptions(), disturbance(group), group)
    finally:
        client.close()


def assert_nothing_left(folder: Path) -> None:
    """No process with this test's folder on its command line is alive."""
    found = subprocess.run(["pgrep", "-f", str(folder)], capture_output=True, text=True, check=False).stdout.split()
    assert [pid for pid in found if int(pid) != os.getpid()] == []


def test_ctrl_c_cancels_the_part_and_keeps_what_was_formed(tmp_path: Path) -> None:
    output = tmp_path / "run"
    command = [sys.executable, "-m", "isf_cell.cli", "form", str(quick_cone_file(tmp_path, step=LONGER))]
    command += ["--json", "--no-compare", "-o", str(output)]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        assert process.stderr is not None
        reported: list[str] = []
        for line in process.stderr:
            reported.append(line)
            if "contour 2/" in line:
                break
        assert "contour 2/" in "".join(reported), "ended early: " + "".join(reported)
        os.kill(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=300)  # a bound against hanging: lifting, scan, report take their time
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == Exit.CANCELLED, out + err
    assert sum(line.startswith("warning the sheet is free for ") for line in reported) == 1  # of the planner
    data = json.loads(out)
    assert data["error"]["name"] == "CANCELLED"
    assert 2 <= data["contours"] < read_bag(output / "bag").planned
    assert data["sheet"] == {"model": "fast"}  # what stands behind the numbers
    assert Path(data["report"]).is_file()


def test_a_job_that_cannot_be_planned_ends_with_the_planner_s_reason(tmp_path: Path) -> None:
    text = JOB.read_text().replace("mini_cone.stl", "missing.stl")
    job = tmp_path / "job.yaml"
    job.write_text(text)
    result, failure = graph_run.form(load_job(job), RunOptions(), tmp_path / "run", quiet)
    assert failure is not None
    assert failure.code == ErrorCode.MESH_UNREADABLE
    assert "missing.stl" in failure.what
    assert result.contours == 0


def test_an_unknown_correction_is_refused_with_the_names_that_exist(tmp_path: Path) -> None:
    _, failure = graph_run.form(load_job(JOB), RunOptions(correction="magic"), tmp_path / "run", quiet)
    assert failure is not None
    assert failure.code == ErrorCode.METHOD_UNKNOWN
    assert "analytic" in failure.what


TOO_BUSY = (
    ErrorCode.WRENCH_LATE,
    ErrorCode.WRENCH_LOST,
    ErrorCode.TARGET_LOST,
    ErrorCode.TARGET_JUMP,
    ErrorCode.NO_TARE,
)
"""Codes with which a computer that keeps nodes waiting for tenths of a second ends a part in real time: see
docs/methods/machine.md."""


@pytest.mark.clock
def test_real_time_forms_the_part_and_counts_late_ticks(tmp_path: Path) -> None:
    """A computer that keeps a node waiting may stop the part, with a code that says so; it does not stop three."""
    for attempt in ("first", "second", "third"):
        folder = tmp_path / attempt
        job = quick_cone(step="2.5 mm")  # two contours: it is formed by the clock
        result, failure = graph_run.form(job, RunOptions(), folder, quiet, lockstep=False)
        if failure is None:
            break
        assert failure.code in TOO_BUSY, failure
    assert failure is None
    record = read_bag(folder / "bag")
    assert record.formed == record.planned
    assert not record.lockstep
    assert 0 <= result.late_ticks <= result.ticks
    # the machine tells its count ten times a second: the bag and the executive end with different ones
    assert record.late_ticks == pytest.approx(result.late_ticks, abs=0.05 * result.ticks)


def test_a_computer_that_paused_forms_the_part_to_its_end(tmp_path: Path) -> None:
    """Longer than any silence that ends a part in lockstep: what came meanwhile is received first."""
    paused: list[int] = []

    def pause_in_second_contour(group: ProcessGroup) -> Callable[[Any], None]:
        def feedback(message: Any) -> None:
            if message.phase == "forming" and message.index == 1 and not paused:
                for node in group.nodes:
                    os.killpg(node.popen.pid, signal.SIGSTOP)
                time.sleep(7.0)  # the fault itself: longer than the 5 s of silence after which a node counts as dead
                for node in group.nodes:
                    os.killpg(node.popen.pid, signal.SIGCONT)
                paused.append(message.index)

        return feedback

    result = formed_beside(pause_in_second_contour, tmp_path)
    assert paused
    assert (result.code, result.message) == (0, "")
    record = read_bag(tmp_path / "bag")
    assert record.formed == record.planned


def test_a_second_process_with_the_name_of_a_node_ends_the_part(tmp_path: Path) -> None:
    """As by a launch file that was started twice: the graph shows one name, and no more publishers of targets."""
    processes: list[int] = []

    def start_another_in_second_contour(group: ProcessGroup) -> Callable[[Any], None]:
        def feedback(message: Any) -> None:
            if message.phase == "forming" and message.index == 1 and not processes:
                processes.append(group["planner"].popen.pid)
                processes.append(group.start("isf_planner", "planner", {"autostart": True}).popen.pid)

        return feedback

    result = formed_beside(start_another_in_second_contour, tmp_path, held_after=3)
    assert result.code == ErrorCode.SECOND_PUBLISHER
    assert "node 'planner'" in result.message
    assert all(str(process) in result.message for process in processes), (processes, result.message)


def test_a_second_cell_in_the_same_domain_is_refused(tmp_path: Path) -> None:
    with ProcessGroup(tmp_path / "first") as group:
        group.start("isf_cell", "executive", {})
        client = graph_run.CellClient()
        try:
            client.wait_ready(group)  # else the second one may be up before the first
        finally:
            client.close()
        with pytest.raises(IsfError, match="another cell is running") as caught:
            graph_run.form(load_job(JOB), RunOptions(), tmp_path / "second", quiet)
    assert caught.value.code == ErrorCode.BUSY
