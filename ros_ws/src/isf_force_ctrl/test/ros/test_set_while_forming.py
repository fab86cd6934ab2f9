"""Parameters set while a contour is formed, over DDS: used from the next tick on, or refused together with a reason."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from isf_msgs.msg import ForceCtrlState
from isf_ros import conversion
from node_cell import Cell, long_ring, watched
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter

pytestmark = pytest.mark.graph


@pytest.fixture
def cell() -> Iterator[Cell]:
    with watched(Cell) as found:
        yield found


def test_gains_limits_and_set_point_in_mid_contour(cell: Cell) -> None:
    """120 N of the job become 80 N on the way, ramped at 400 N/s; what does not go together is refused as a whole."""
    client = cell.node.create_client(SetParametersAtomically, "force_ctrl/set_parameters_atomically")
    cell.start()

    def put(**values: Any) -> str:
        """Why the values are refused; empty: they are taken."""
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        future = client.call_async(SetParametersAtomically.Request(parameters=parameters))
        assert cell.wait(future.done)
        return str(future.result().result.reason)

    assert cell.wait(client.service_is_ready)
    cell.armed()
    cell._contours.publish(conversion.contour_to_message(long_ring()))
    assert cell.wait(lambda: any(state.mode == ForceCtrlState.CONTROL for state in cell.states))
    # first, since the contour goes on meanwhile, in lockstep faster than the clock
    assert put(set_point=80.0, loop_gain=16.0, filter_cutoff=30.0) == ""
    assert "UNSTABLE_GAIN" in put(loop_gain=400.0)
    assert "UNSTABLE_GAIN" in put(set_point=60.0, loop_gain=400.0)  # neither is taken
    assert "drift_stop" in put(drift_limit=40.0)
    assert "contact_threshold" in put(set_point=2.0)
    assert "out of range" in put(feed_floor=2.0)
    assert "read-only" in put(set_point=60.0, acceleration=1.0)
    assert put(drift_limit=40.0, drift_stop=60.0) == ""
    assert cell.wait(lambda: cell.results)
    result = conversion.result_from_message(cell.results[0])
    assert (result.completed, result.code) == (True, 0)
    engaged = result.tick_set_point[result.tick_engaged]
    assert engaged.max() == pytest.approx(120.0)
    assert engaged[-1] == pytest.approx(80.0)
    assert np.abs(np.diff(engaged)).max() <= 400.0 / 500.0 + 1e-9
    held = result.tick_normal_force[result.tick_engaged][-250:]  # the last half second
    assert held.mean() == pytest.approx(80.0, abs=5.0)
