"""The node ``springback`` in its own process over DDS."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import forked_process
import numpy as np
import pytest
from springback_parts import JOB_TEXT, cone_contour, result_of

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("isf_msgs.msg")

from isf_core.errors import ErrorCode  # noqa: E402
from isf_msgs.msg import Contour, ContourCorrection, ContourResult, JobInfo  # noqa: E402
from isf_ros import qos  # noqa: E402
from isf_ros.conversion import (  # noqa: E402
    contour_from_message,
    contour_to_message,
    correction_from_message,
    result_to_message,
)
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.node import Node  # noqa: E402

pytestmark = pytest.mark.graph

LIMIT = 120.0
"""s; only to end a test that hangs."""


class Cell:
    """The neighbours of the node: executive and force control."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.corrections: dict[int, Any] = {}
        self.corrected: dict[int, Any] = {}
        self.info = node.create_publisher(JobInfo, "part/info", qos.LATCHED)
        self.nominal = node.create_publisher(Contour, "contour/nominal", qos.LATCHED)
        self.result = node.create_publisher(ContourResult, "contour/result", qos.EVENT)
        node.create_subscription(ContourCorrection, "contour/correction", self._on_correction, qos.EVENT)
        node.create_subscription(Contour, "contour/corrected", self._on_corrected, qos.LATCHED)
        self.parameters = node.create_client(SetParameters, "springback/set_parameters")

    def _on_correction(self, message: ContourCorrection) -> None:
        self.corrections[message.index] = correction_from_message(message)

    def _on_corrected(self, message: Contour) -> None:
        self.corrected[message.index] = contour_from_message(message)

    def wait(self, condition: Callable[[], Any]) -> None:
        deadline = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < deadline, "the node did not answer"
            rclpy.spin_once(self.node, timeout_sec=0.1)

    def set_method(self, name: str) -> Any:
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=name)
        request = SetParameters.Request(parameters=[Parameter(name="method", value=value)])
        future = self.parameters.call_async(request)
        self.wait(future.done)
        return future.result().results[0]

    def correct(self, index: int) -> Any:
        """Send contour ``index``; its correction."""
        self.nominal.publish(contour_to_message(cone_contour(index)))
        self.wait(lambda: index in self.corrections)
        return self.corrections[index]

    def form(self, index: int) -> Any:
        """Send contour ``index``, then the result of what came back; its correction."""
        correction = self.correct(index)
        self.wait(lambda: index in self.corrected)
        self.result.publish(result_to_message(result_of(self.corrected[index], 500.0)))
        return correction


@contextmanager
def served(env: dict[str, str] | None = None, **parameters: object) -> Iterator[Cell]:
    """The node in a process of its own, and its neighbours; it has to live at the end."""
    with forked_process.node("-m", "isf_springback.node", env=env, autostart=True, **parameters) as process:
        rclpy.init()
        node = rclpy.create_node("neighbours")
        cell = Cell(node)
        try:
            cell.wait(lambda: cell.info.get_subscription_count() and cell.result.get_subscription_count())
            cell.wait(
                lambda: node.count_publishers("contour/correction") and node.count_publishers("contour/corrected")
            )
            cell.wait(cell.parameters.service_is_ready)
            yield cell
            assert process.poll() is None
        finally:
            node.destroy_node()
            rclpy.try_shutdown()


@pytest.fixture
def cell() -> Iterator[Cell]:
    with served(result_timeout=4.0) as found:
        yield found


def test_a_part_over_the_wire(cell: Cell) -> None:
    cell.info.publish(JobInfo(job_name="cone", job_text=JOB_TEXT, plan_id="plan", correction="analytic"))

    # an unknown method is rejected with the names that exist, and nothing changes
    refused = cell.set_method("magic")
    assert not refused.successful
    assert "analytic" in refused.reason
    assert "none" in refused.reason
    assert cell.set_method("analytic").successful

    corrections = [cell.form(index) for index in range(6)]
    assert [c.code for c in corrections] == [0] * 6
    assert {c.method for c in corrections} == {"analytic"}
    assert not corrections[0].offset.any()
    assert corrections[5].offset[:, 2].max() < -3e-3
    # what the machine gets is the nominal contour moved by what was told: exact in double precision
    moved = cell.corrected[5].forming_tip - cone_contour(5).forming_tip
    assert moved == pytest.approx(corrections[5].offset, abs=1e-15)
    assert cell.corrected[5].support_tip - cone_contour(5).support_tip == pytest.approx(moved, abs=1e-15)

    # no result of contour 6: contour 7 keeps its correction and tells why
    kept = cell.correct(6)
    late = cell.correct(7)
    assert late.code == ErrorCode.NO_FORCE_HISTORY
    assert late.offset[:, 2].mean() == pytest.approx(kept.offset[:, 2].mean(), abs=20e-6)
    cell.wait(lambda: 7 in cell.corrected)
    cell.result.publish(result_to_message(result_of(cell.corrected[7], 500.0)))

    # not finite forces: as above with another code
    assert cell.form(8).code == 0
    assert cell.correct(9).code == 0
    cell.wait(lambda: 9 in cell.corrected)
    spoiled = result_of(cell.corrected[9], 500.0)
    spoiled.forming_force[3] = np.nan
    cell.result.publish(result_to_message(spoiled))
    assert cell.form(10).code == ErrorCode.CORRECTION_FAILED

    # another method from the next contour on, without a jump
    assert cell.set_method("none").successful
    last = cell.corrections[10].offset[:, 2].mean()
    eleven = cell.form(11)
    assert eleven.method == "none"
    assert eleven.offset[:, 2].mean() == pytest.approx(last + 1e-3, abs=20e-6)


def test_without_a_job_the_contour_is_refused(cell: Cell) -> None:
    correction = cell.correct(0)
    assert correction.code == ErrorCode.CORRECTION_FAILED
    assert "part/info" in correction.message
    assert 0 not in cell.corrected
