"""Scans at the node ``springback`` in its own process over DDS: used, missing, spoiled; never a jump."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from springback_parts import cone_contour, result_of

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("isf_msgs.msg")

from isf_core.errors import ErrorCode  # noqa: E402
from isf_core.geometry.height_map import HeightMap  # noqa: E402
from isf_msgs.msg import JobInfo  # noqa: E402
from isf_ros import qos, stamps  # noqa: E402
from isf_ros.conversion import height_map_to_message, result_to_message  # noqa: E402
from rclpy.duration import Duration  # noqa: E402
from scanned_sheet import TARGET, Sheet  # noqa: E402
from sensor_msgs.msg import PointCloud2, PointField  # noqa: E402
from springback_parts import JOB_TEXT  # noqa: E402
from test_springback_node import LIMIT, Cell, served  # noqa: E402

pytestmark = pytest.mark.graph

TEXT = JOB_TEXT.replace("method: analytic", "scan_every: 1, method: fused, open_loop_contours: 0")


@pytest.fixture
def cell() -> Iterator[Cell]:
    """The node with a timeout that a scan cannot exceed on a busy computer."""
    with served(result_timeout=8.0) as found:
        yield found


class Scanner:
    """Planner and machine as far as shapes are concerned."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self.target = cell.node.create_publisher(PointCloud2, "part/target", qos.LATCHED)
        self.scan = cell.node.create_publisher(PointCloud2, "scan", qos.LATCHED)
        self.sheet = Sheet(lambda depth, around: 1.0e-3 * (1 - np.exp(-depth / 1.5e-3)))
        cell.wait(lambda: self.target.get_subscription_count() and self.scan.get_subscription_count())
        self.target.publish(height_map_to_message(TARGET, stamps.from_seconds(0.0)))
        assert self.target.wait_for_all_acked(Duration(seconds=LIMIT))  # before any contour, on a busy computer too

    def form(self, index: int, cloud: PointCloud2 | None) -> Any:
        """Correct and form contour ``index``, then show ``cloud`` (None: the sheet as it is); its correction."""
        correction = self.cell.correct(index)
        self.cell.wait(lambda: index in self.cell.corrected)
        corrected = self.cell.corrected[index]
        self.sheet.form(corrected)
        self.cell.result.publish(result_to_message(result_of(corrected, 500.0)))
        self.scan.publish(cloud or self.seen())
        return correction

    def seen(self) -> PointCloud2:
        return height_map_to_message(HeightMap(TARGET.x, TARGET.y, self.sheet.z), stamps.from_seconds(1.0))

    def single_precision(self) -> PointCloud2:
        """The same points unordered, as float32 with an intensity."""
        points = np.random.default_rng(0).permutation(HeightMap(TARGET.x, TARGET.y, self.sheet.z).points())
        data = np.column_stack([points, np.ones(len(points))]).astype("<f4")
        cloud = PointCloud2(height=1, width=len(points), point_step=16, row_step=16 * len(points), data=data.tobytes())
        cloud.header.stamp = stamps.from_seconds(1.0)
        cloud.fields = [
            PointField(name=n, offset=4 * k, datatype=7, count=1) for k, n in enumerate(("x", "y", "z", "i"))
        ]
        return cloud


def test_scans_over_the_wire(cell: Cell) -> None:
    cell.info.publish(JobInfo(job_name="cone", job_text=TEXT, plan_id="plan", correction="fused"))
    scanner = Scanner(cell)
    corrections = [scanner.form(index, None) for index in range(6)]
    assert [c.code for c in corrections] == [0] * 6
    assert {c.method for c in corrections} == {"fused"}
    assert corrections[5].uncertainty.mean() < corrections[0].uncertainty.mean()

    # an unordered cloud of a scanner is as good
    scanner.form(6, scanner.single_precision())
    seventh = scanner.form(7, height_map_to_message(shifted(scanner.sheet), stamps.from_seconds(1.0)))
    assert seventh.code == 0

    # shifted by 5 mm: a code, and no jump
    eighth = scanner.form(8, PointCloud2())
    assert eighth.code == ErrorCode.SCAN_SHIFTED
    assert abs(mean_push(eighth) - mean_push(seventh)) < 0.5e-3

    # not a cloud at all counts as none: waited for, told, gone on without
    ninth = scanner.form(9, None)
    assert ninth.code == ErrorCode.SCAN_MISSING
    assert abs(mean_push(ninth) - mean_push(eighth)) < 0.5e-3
    assert scanner.form(10, None).code == 0


def shifted(sheet: Sheet) -> HeightMap:
    return HeightMap(TARGET.x + 5e-3, TARGET.y, sheet.z)


def mean_push(correction: Any) -> float:
    return float(-correction.offset[:, 2].mean())


def test_contours_that_wait_for_scans_stay_in_order(cell: Cell) -> None:
    cell.info.publish(JobInfo(job_name="cone", job_text=TEXT, plan_id="plan", correction="mpc_vertical"))
    scanner = Scanner(cell)
    first = scanner.form(0, None)
    assert first.code == 0
    # contour 2 without contour 1: told, nothing moves
    skipped = cell.correct(2)
    assert skipped.code == ErrorCode.CONTOUR_OUT_OF_ORDER
    assert np.abs(skipped.offset).max() < 1e-9
    assert len(skipped.offset) == len(cone_contour(2))
