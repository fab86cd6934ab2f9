"""Load cells from calibration to forming: files of ``isf calibrate-cell`` in the node, and the node in a cell."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
from isf_cell.commands.calibrate_cell import calibrate_file
from isf_core.files.job import load_job
from isf_load_cell.cell_file import load_cell_set_up
from isf_load_cell.three_cells import readings_of
from isf_planner import plan

ROOT = Path(__file__).resolve().parents[2]

RESPONSE = np.array([[1.02, 0.03, -0.01], [-0.02, 0.97, 0.02], [0.01, -0.03, 1.05]])
ZERO = np.array([12.0, -7.0, 30.0])
LOADS = np.vstack([np.zeros((2, 3)), *(size * np.eye(3) for size in (300.0, -300.0, 500.0))])


def calibrated(folder: Path, header: str, rows: np.ndarray, added: str) -> str:
    """The file of the cell: as the command writes it, and what is ``added`` to it."""
    np.savetxt(folder / "loads.csv", rows, delimiter=",", header=header, comments="")
    calibrate_file(folder / "loads.csv", None, folder / "cell.yaml", as_json=False)
    path = folder / "cell.yaml"
    path.write_text(path.read_text(encoding="utf-8") + added, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("unit", [1.0, 2400.0], ids=["N", "V"])
def test_a_calibrated_cell_reads_the_loads_again(tmp_path: Path, unit: float) -> None:
    """Readings in N give the piece for a rig, readings in V a calibration matrix: the node takes both."""
    readings = (LOADS @ RESPONSE.T + ZERO) / unit
    rows = np.column_stack([LOADS, readings])
    cell = load_cell_set_up(calibrated(tmp_path, "fx,fy,fz,u1,u2,u3", rows, "range: 5000\n"), "", 1)
    assert cell.channels is None
    cell.reading.tare(np.column_stack([np.tile(ZERO / unit, (4, 1)), np.zeros((4, 3))]))
    found = [cell.reading.wrench(np.concatenate([reading, np.zeros(3)]))[:3] for reading in readings]
    np.testing.assert_allclose(found, LOADS, atol=0.01)  # six digits in the file


def test_three_calibrated_cells_read_the_force_again(tmp_path: Path) -> None:
    names = [f"{axis}{k}" for k in (1, 2, 3) for axis in "xyz"]
    gains = 2400.0 + 10.0 * np.arange(9)
    load = np.array([0.0, 500.0, -500.0, 2000.0, -2000.0, 5000.0])
    rows = np.column_stack([load, load[:, None] / gains])
    added = "three_cells: {height: 280 mm}\nrange: 9.5\n"
    cell = load_cell_set_up(calibrated(tmp_path, ",".join(["load", *names]), rows, added), "", 1)
    assert cell.channels == tuple(names)
    cell.reading.tare(np.zeros((4, 9)))
    force = np.array([300.0, -200.0, 1500.0])
    found = cell.reading.wrench(readings_of(force, 0.28).ravel() / gains)
    assert found[:3] == pytest.approx(force, rel=1e-4)  # gains stand in the file to 0.1 N per V


# -- in a cell -----------------------------------------------------------------------------------


@pytest.mark.graph
@pytest.mark.slow
def test_the_simulated_machine_is_controlled_through_two_load_cells(tmp_path: Path) -> None:
    """Machine, two load_cell nodes by the rig's own file, force control: the force of a small cone is held as it is
    without the nodes. One contour is formed under position control, two under force control."""
    import rclpy
    from isf_msgs.msg import Contour, ContourResult
    from isf_msgs.srv import Arm, Tare
    from isf_ros import conversion, qos
    from std_srvs.srv import Trigger

    text = (ROOT / "examples" / "jobs" / "mini_cone.yaml").read_text(encoding="utf-8")
    for old, new in (
        ("../parts", str(ROOT / "examples" / "parts")),
        ("incremental_depth: 0.5 mm", "incremental_depth: 1 mm"),
        ("engage_depth: 2 mm", "engage_depth: 1 mm"),
    ):
        assert old in text
        text = text.replace(old, new)
    job = tmp_path / "job.yaml"
    job.write_text(text, encoding="utf-8")
    contours = plan(load_job(job)).contours
    rclpy.init()
    node = rclpy.create_node("observer")

    def wait(condition: Callable[[], Any], timeout: float = 120.0) -> bool:
        deadline = time.monotonic() + timeout
        while not (done := bool(condition())) and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.05)
        return done

    def ask(kind: Any, name: str, request: Any) -> Any:
        client = node.create_client(kind, name)
        assert client.wait_for_service(120.0)
        future = client.call_async(request)
        assert wait(future.done)
        return future.result()

    results: list[Any] = []
    node.create_subscription(ContourResult, "contour/result", results.append, qos.EVENT)
    publisher = node.create_publisher(Contour, "contour/corrected", qos.LATCHED)

    def started(package: str, remap: dict[str, str] | None = None, **parameters: object) -> Any:
        return forked_process.node("-m", f"{package}.node", remap=remap, autostart=True, **parameters)

    def cell(k: int) -> Any:
        names = {"__node": f"load_cell_{k}", "raw": f"tool_{k}/raw", "wrench": f"tool_{k}/wrench"}
        return started("isf_load_cell", names, rig="ren2018", tool=k, tare_readings=1)

    try:
        raw = {f"tool_{k}/wrench": f"tool_{k}/raw" for k in (1, 2)}
        with started("isf_sim", raw, job=job), cell(1), cell(2), started("isf_force_ctrl"):
            ask(Tare, "machine/tare", Tare.Request())
            for k in (1, 2):
                assert wait(lambda k=k: ask(Trigger, f"load_cell_{k}/tare", Trigger.Request()).success)
            request = Arm.Request(plan_id=contours[0].plan_id, count=len(contours), job_text=text)
            request.support_force = float("nan")
            assert wait(lambda: ask(Arm, "force_ctrl/arm", request).code == 0)
            for index, contour in enumerate(contours[:3]):
                publisher.publish(conversion.contour_to_message(contour))
                assert wait(lambda index=index: len(results) > index, 300.0)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    found = [conversion.result_from_message(result) for result in results]
    assert [(result.completed, result.code) for result in found] == [(True, 0)] * 3
    for result in found[1:]:
        force = result.tick_normal_force[result.tick_engaged]
        within = float(np.mean(np.abs(force - 120.0) <= 10.0))
        assert force.mean() == pytest.approx(120.0, abs=3.0)
        assert within > 0.99
        assert result.contact_fraction > 0.95
