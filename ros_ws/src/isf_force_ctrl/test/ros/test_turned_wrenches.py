"""Load cells with axes of their own under the node, in processes of their own: their wrenches form the same contour.

The axes x, y, z of the cell are y, z, x of the sheet, which changes no number: the contour is the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from isf_core.contour import ContourResult
from isf_core.errors import ErrorCode
from isf_msgs.srv import Arm
from isf_ros import conversion, qos
from node_cell import Cell, small_ring, watched
from tf2_msgs.msg import TFMessage

pytestmark = pytest.mark.graph


def transform(parent: str, child: str, quaternion: tuple[float, float, float, float]) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    turn = message.transform.rotation
    turn.x, turn.y, turn.z, turn.w = quaternion
    return message


NONE = (0.0, 0.0, 0.0, 1.0)
IN_ROOM = transform("room", "ft_sensor", NONE)
SHEET_IN_ROOM = transform("room", "sheet", (-0.5, -0.5, -0.5, 0.5))
"""The room has the axes of the cell: x of the sheet is z of the room, y is x, z is y."""


class Room(Cell):
    """The cell, and what a description publishes of fixed frames."""

    def tell(self, *transforms: TransformStamped) -> None:
        if not hasattr(self, "_fixed"):
            self._fixed = self.node.create_publisher(TFMessage, "/tf_static", qos.TF_STATIC)
        self._fixed.publish(TFMessage(transforms=list(transforms)))

    def refused(self, code: ErrorCode, words: str) -> bool:
        """Wait until arming is refused so."""

        def answer() -> Arm.Response:
            response = self.ask_to_arm()
            return bool(response.code == code and words in response.message)

        return self.wait(answer)

    def takes(self) -> bool:
        """Wait until a part is armed."""
        return self.wait(lambda: self.ask_to_arm().code == ErrorCode.OK)

    def formed(self) -> ContourResult:
        result = conversion.result_from_message(self.form(small_ring()))
        assert (result.completed, result.code, result.message) == (True, 0, "")
        return result


@pytest.fixture
def cell() -> Iterator[Room]:
    with watched(Room) as found:
        yield found


@pytest.fixture(scope="module")
def plain() -> ContourResult:
    """What is formed where the cells have the axes of the sheet."""
    with watched(Room) as cell:
        cell.start()
        assert cell.takes()
        return cell.formed()


def test_a_cell_in_axes_of_its_own_forms_the_same_contour(plain: ContourResult, cell: Room) -> None:
    cell.start({"frame": "ft_sensor", "turned": True})
    assert cell.refused(ErrorCode.WRENCH_FRAME, "nothing is known of frame 'ft_sensor' and 'sheet' (known: none)")
    cell.tell(IN_ROOM)
    assert cell.refused(ErrorCode.WRENCH_FRAME, "nothing is known of frame 'sheet' (known: ft_sensor, room)")
    cell.tell(transform("clamp", "sheet", NONE))
    assert cell.refused(
        ErrorCode.WRENCH_FRAME, "'ft_sensor' hangs below 'room', 'sheet' below 'clamp', and nothing joins"
    )
    assert cell.targets == 0
    cell.tell(SHEET_IN_ROOM)
    assert cell.takes()
    turned = cell.formed()
    assert plain.forming_force.shape[0] > 50
    assert np.nanmean(plain.tick_normal_force) > 50.0
    for name in ("forming_force", "support_force", "tick_normal_force", "force_offset", "support_target"):
        np.testing.assert_array_equal(getattr(turned, name), getattr(plain, name), err_msg=name)


def test_a_cell_that_turns_while_it_forms(plain: ContourResult, cell: Room) -> None:
    """0.5 rad/s: the newest transform is up to 20 ms, 0.01 rad, behind, of a force that is mostly horizontal."""
    cell.start({"frame": "flange", "spin": 0.5})
    assert cell.takes()
    turning = cell.formed()
    assert abs(np.nanmean(turning.tick_normal_force) - np.nanmean(plain.tick_normal_force)) < 1.0  # N
    away = np.nanmax(np.linalg.norm(turning.support_target - plain.support_target, axis=1))
    assert away < 20e-6


def test_a_robot_that_falls_silent_ends_the_contour_with_why(cell: Room) -> None:
    cell.start({"frame": "flange", "spin": 0.5, "told_until": 600}, wrench_timeout=1.0)
    assert cell.takes()
    result = cell.form(small_ring())
    assert (result.completed, result.code) == (False, ErrorCode.POSE_LOST)
    assert "how 'flange' stands in 'sheet' was measured 0.25 s older than the reading" in result.message
