"""Parts formed in process and replayed: formed again to the last bit, or with other parameters.

Bags of the node graph, with every target: tests/graph/test_whole_part.py and test_measurements_in_graph.py.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from isf_analysis.bag import topics
from isf_analysis.bag.bag_writer import write_bag
from isf_analysis.bag.topics import cell_types, make_message
from isf_analysis.measures.force_metrics import force_metrics
from isf_analysis.measures.record import PartRecord
from isf_cell import in_process
from isf_cell.commands.replay import replay_run
from isf_cell.options import RunOptions
from isf_cell.replay.force_replay import ForceReplay
from isf_cell.replay.outcome import Replay, replay
from isf_cell.replay.recorded_run import Ticks, read_run
from isf_cell.replay.what_if import parse
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_core.types import Array
from isf_force_ctrl.control_config import ControlConfig
from quick_cone import CONTOURS, FOLDER, quick_cone
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

GAIN = "force.loop_gain=10"


@pytest.fixture(scope="module")
def job() -> JobFile:
    return quick_cone("method: fused\n  scan_every: 2")


@pytest.fixture(scope="module")
def part(job: JobFile) -> PartRecord:
    return in_process.form(job, RunOptions(seed=7, variant=21))


@pytest.fixture(scope="module")
def run(part: PartRecord, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_bag(part, folder / "bag")
    return folder


def test_a_simulated_part_is_formed_again_to_the_last_bit(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replay_run(run, [], None, None, None, as_json=True)
    data = json.loads(capsys.readouterr().out)
    assert data["identical"] is True
    assert data["results"] == {"compared": CONTOURS, "differing_fields": {}, "first_contour": None, "in_one_alone": 0}
    assert data["corrections"]["differing_fields"] == {}


def test_scans_of_the_part_before_are_not_those_of_the_last_one(part: PartRecord, tmp_path: Path) -> None:
    bags = [write_bag(part, tmp_path / name, end=end * 10**9) for name, end in (("first", 2000), ("second", 4000))]
    with Writer(tmp_path / "both", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        written: dict[str, Any] = {}
        for path in bags:
            with Reader(path) as reader:
                for item, time, data in reader.messages():
                    if item.topic not in written:
                        written[item.topic] = writer.add_connection(item.topic, item.msgtype, typestore=cell_types())
                    writer.write(written[item.topic], time, data)
    alone, last = read_run(bags[1]), read_run(tmp_path / "both")
    assert len(last.scans) == len(alone.scans) > 1
    assert len(last.lifts) == len(alone.lifts)


@pytest.mark.parametrize(
    ("after", "node", "told"), [(1, "/force_ctrl", True), (1, "/other", False), (-1, "/force_ctrl", False)]
)
def test_a_parameter_set_while_forming_is_told(
    after: int, node: str, told: bool, part: PartRecord, run: Path, job: JobFile, tmp_path: Path
) -> None:
    """Set ``after`` ns from the arming: what was set before is what it was armed with."""
    settings = ControlConfig.from_job(job).to_json()
    armed = make_message(topics.ARMED.type, plan_id=part.plan_id, settings=settings, support_force=float("nan"))
    changed = make_message("rcl_interfaces/msg/Parameter", name="loop_gain")
    event = make_message("rcl_interfaces/msg/ParameterEvent", node=node, changed_parameters=[changed])
    with (
        Reader(run / "bag") as reader,
        Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        added = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=cell_types()) for c in reader.connections}
        messages = list(reader.messages())
        for connection, time, data in messages:
            writer.write(added[connection.id], time, data)
        results = [time for connection, time, _ in messages if connection.topic == "/contour/result"]
        for topic, kind, message, time in (
            (topics.ARMED.name, topics.ARMED.type, armed, results[-1] - 2),
            ("parameter_events", "rcl_interfaces/msg/ParameterEvent", event, results[-1] - 2 + after),
        ):
            connection = writer.add_connection(f"/{topic}", kind, typestore=cell_types())
            writer.write(connection, time, cell_types().serialize_cdr(message, kind))
    found = replay(read_run(tmp_path), parse([]))
    assert found.run.retuned == (("force_ctrl.loop_gain",) if told else ())
    assert any("force_ctrl.loop_gain" in note for note in found.notes) is told
    assert found.identical is (None if told else True)


def test_a_record_that_was_changed_is_not_identical(part: PartRecord, tmp_path: Path) -> None:
    """One number of one contour, in the last bit."""
    offset = part.corrections[1].offset.copy()
    offset[5, 2] = np.nextafter(offset[5, 2], 1.0)
    corrections = (part.corrections[0], replace(part.corrections[1], offset=offset), *part.corrections[2:])
    write_bag(replace(part, corrections=corrections), tmp_path / "bag")
    found = replay(read_run(tmp_path), parse([]))
    assert found.identical is False
    numbers = found.numbers()
    assert numbers["corrections"]["first_contour"] == 1
    assert set(numbers["corrections"]["differing_fields"]) == {"offset"}
    assert 0.0 < numbers["corrections"]["differing_fields"]["offset"] < 1e-15


def test_what_was_compared_with_nothing_is_not_identical(run: Path) -> None:
    """A target that the recorder lost keeps the answer open; one that differs, or that is no number, ends it."""
    read = read_run(run)
    recorded = np.arange(18.0).reshape(3, 6)

    def replayed(target: Array, answer: Array) -> Replay:
        ticks = Ticks(np.arange(3), np.zeros((3, 12)), target, np.empty(0, np.int64), np.empty((0, 4)), True, 0)
        force = ForceReplay(np.zeros(3, np.int64), np.arange(3), answer, read.part.results, 0)
        return Replay(replace(read, ticks=ticks), parse([]), force, read.part.corrections, None, ())

    def with_nan(row: int, column: int) -> Array:
        changed = recorded.copy()
        changed[row, column] = np.nan
        return changed

    assert replayed(recorded, recorded).identical is True
    assert replayed(with_nan(1, 4), recorded).identical is None  # of the second tool alone
    assert replayed(with_nan(1, 4), recorded + [[0.0], [0.0], [1e-9]]).identical is False
    no_answer = replayed(recorded, with_nan(2, 0))
    assert no_answer.identical is False
    assert no_answer.target_distance.tolist() == [0.0, 0.0, np.inf]
    assert no_answer.numbers()["targets"]["differing"] == 1


def test_what_a_gain_would_do_is_what_it_does(
    run: Path, job: JobFile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The force of the prediction against really forming with that gain: within 15 %, and here the same number."""
    replay_run(run, [GAIN], tmp_path / "out", None, None, as_json=True)
    data = json.loads(capsys.readouterr().out)
    formed = force_metrics(
        in_process.form(job, RunOptions(seed=7, variant=21), control={"loop_gain": 10.0}).results, 100.0
    )
    assert formed is not None
    predicted, recorded = (data["prediction"][which]["force_error_rms_N"] for which in ("what_if", "recorded"))
    assert predicted == pytest.approx(formed.rms_error, rel=1e-9)
    assert predicted > 1.1 * recorded  # a slower loop holds the force worse
    assert (tmp_path / "out" / "replay.png").stat().st_size > 20_000
    assert json.loads((tmp_path / "out" / "replay.json").read_text())["what_if"] == {"force.loop_gain": "10"}
    assert len((tmp_path / "out" / "contours.csv").read_text().splitlines()) == CONTOURS + 1


def test_a_real_part_is_not_formed_again(part: PartRecord, tmp_path: Path) -> None:
    write_bag(replace(part, variant=-1, sheet={}), tmp_path / "bag")
    found = replay(read_run(tmp_path), parse([GAIN]))
    assert found.again is None
    assert found.identical is None
    assert any("force control is not replayed" in note for note in found.notes)
    with pytest.raises(IsfError, match="real machine") as caught:
        replay(read_run(tmp_path), parse([GAIN]), replant=True)
    assert caught.value.code == ErrorCode.FILE_FIELD


def test_a_job_whose_files_are_elsewhere_needs_their_folder(part: PartRecord, tmp_path: Path) -> None:
    text = part.job_text.replace("rig: ren2018", "rig: own_rig.yaml")
    assert text != part.job_text
    write_bag(replace(part, job_text=text, base_folder="/nowhere"), tmp_path / "bag")
    with pytest.raises(IsfError, match="--base DIR") as caught:
        read_run(tmp_path).job_file()
    assert caught.value.code == ErrorCode.FILE_NOT_FOUND
    (tmp_path / "own_rig.yaml").write_text("based_on: ren2018\nname: own_rig\n")
    assert read_run(tmp_path).job_file(tmp_path).rig.name == "own_rig"


def test_the_folder_of_the_job_is_recorded(run: Path) -> None:
    assert Path(read_run(run).part.base_folder) == FOLDER
