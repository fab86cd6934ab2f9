"""A method of another package that is slow or raises, in the node's process: it serves on and says what is."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from springback_parts import JOB_TEXT, cone_contour, result_of

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("isf_msgs.msg")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from isf_core.errors import ErrorCode  # noqa: E402
from isf_msgs.msg import JobInfo  # noqa: E402
from isf_ros.conversion import contour_to_message, result_to_message  # noqa: E402
from test_scan_node import Scanner  # noqa: E402
from test_springback_node import served  # noqa: E402

pytestmark = pytest.mark.graph

METHOD = """
import os
from pathlib import Path
import numpy as np
from isf_springback.estimators.estimator import Estimator, Prediction


class Faulty(Estimator):
    name = "faulty"
    uses_scans = True

    def estimate(self, contour, history):
        if contour.index == 2:  # the fault itself: a solution that lasts until the test has seen what it wants to see
            Path(os.environ["SOLVED"]).read_text()  # a pipe
        if contour.index == 4:
            raise ZeroDivisionError("in the method")
        return Prediction(np.full(len(contour), 0.7e-3))

    def add_shape(self, shape, history):
        if history.current is not None and history.current.contour.index == 0:
            raise KeyError("in the scan")
"""


def packed(site: Path, code: str) -> str:
    """PYTHONPATH with a package of one method, installed as pip leaves it."""
    info = site / "my_methods-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "my_methods.py").write_text(code)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-methods\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[isf.springback_methods]\nfaulty = my_methods:Faulty\n")
    return os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])


def test_a_slow_or_faulty_method_does_not_take_the_node_along(tmp_path: Path) -> None:
    solved = tmp_path / "solved"
    os.mkfifo(solved)
    python_path = packed(tmp_path / "site", METHOD)
    text = JOB_TEXT.replace("method: analytic", "scan_every: 1, method: faulty")
    with served(env={**os.environ, "PYTHONPATH": python_path, "SOLVED": str(solved)}) as cell:
        heard: list[str] = []

        def on_diagnostics(message: Any) -> None:
            heard.extend(status.message for status in message.status if status.name == "/springback")

        cell.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
        cell.info.publish(JobInfo(job_name="cone", job_text=text, plan_id="plan", correction="faulty"))
        scanner = Scanner(cell)

        # The scan after contour 0 raises in the method: told, and the next contour is corrected.
        assert scanner.form(0, None).code == 0
        cell.wait(lambda: any("KeyError: 'in the scan'" in text and "1 INTERNAL" in text for text in heard))
        assert scanner.form(1, None).code == 0

        # While a solution lasts the node shows that it is there and answers; then the contour comes.
        cell.nominal.publish(contour_to_message(cone_contour(2)))
        begun = len(heard)
        cell.wait(lambda: len(heard) >= begun + 4)
        assert not cell.set_method("magic").successful
        assert 2 not in cell.corrections
        solved.write_text("")
        cell.wait(lambda: 2 in cell.corrected)
        assert cell.corrections[2].code == 0
        scanner.sheet.form(cell.corrected[2])
        cell.result.publish(result_to_message(result_of(cell.corrected[2], 500.0)))
        scanner.scan.publish(scanner.seen())

        # A method that raises refuses its contour with a code at once, and corrects the next.
        scanner.form(3, None)
        refused = cell.correct(4)
        assert refused.code == ErrorCode.INTERNAL
        assert "ZeroDivisionError: in the method" in refused.message
        assert "'faulty'" in refused.message
        assert cell.correct(5).method == "faulty"
