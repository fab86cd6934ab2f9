"""The scan between two contours through the node graph: the action of force_ctrl, and the service of the machine."""

from __future__ import annotations

from collections.abc import Callable

from isf_core.contour import contour_label
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import JobFile
from isf_msgs.action import MoveAside
from isf_msgs.srv import Scan

from isf_cell.graph_client import GraphClient, Watch
from isf_cell.scan_between import tools_aside


def scan_in_graph(
    client: GraphClient,
    watch: Watch,
    job_file: JobFile,
    index: int,
    timeout: float,
    tell: Callable[[str], None],
    *,
    closed: bool,
) -> None:
    """Measure the shape after contour ``index``, ``closed`` or not, for springback; ``timeout`` s of the tools' move.

    Tools that cannot be moved aside and a scanner that fails are told, and the part goes on with what there is.

    Raises
    ------
    IsfError : NODE_DIED, CANCELLED
    """
    after = contour_label(index)
    if tools_aside(job_file, closed=closed):
        try:
            moved = client.run_action(MoveAside, "move_aside", MoveAside.Goal(), watch, lambda _: None, timeout=timeout)
            if moved.code:
                tell(f"the tools were not moved aside after {after}: {moved.message}")
        except IsfError as error:
            _unless_over(error)
            tell(f"the tools were not moved aside after {after}: {error}")
    request = Scan.Request(clamped=True, sensor=job_file.job.springback.scan_sensor)
    try:
        client.checked_call(Scan, "machine/scan", request, watch)
    except IsfError as error:
        _unless_over(error)
        tell(f"no scan after {after}: {error}")


def _unless_over(error: IsfError) -> None:
    if error.code in (ErrorCode.NODE_DIED, ErrorCode.CANCELLED):
        raise error
