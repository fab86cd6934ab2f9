"""A support tool at the end of its offset: told when it lasts, not when it is brief."""

from __future__ import annotations

import numpy as np
import pytest
from contact_sandbox import make_config, ring, run
from isf_core.errors import ErrorCode
from isf_force_ctrl.supervision.contour_warnings import offset_warning


@pytest.mark.parametrize(("force", "reported"), [(120.0, False), (400.0, True)])
def test_a_force_out_of_reach_is_reported(force: float, reported: bool) -> None:
    """With a limit of 0.5 mm the contact of 0.45 N/um gives some 225 N beyond what the plan squeezes."""
    config = make_config(offset_limit=0.5e-3)
    (result,) = run([ring(force=force)], config, noise=False).results
    assert result.completed
    warning = offset_warning(result, config.offset_limit)
    assert (warning is not None) == reported
    if warning is not None:
        assert warning.code is ErrorCode.OFFSET_LIMIT
        assert "0.50 mm" in str(warning)
        assert "set-point 400 N" in str(warning)


def test_a_corner_at_the_limit_is_not_reported() -> None:
    config = make_config(offset_limit=0.5e-3)
    (result,) = run([ring(force=120.0)], config, noise=False).results
    result.force_offset[: len(result.force_offset) // 20] = -0.5e-3
    assert offset_warning(result, config.offset_limit) is None
    result.force_offset[: len(result.force_offset) // 5] = -0.5e-3
    assert offset_warning(result, config.offset_limit) is not None
    result.force_offset[...] = np.nan
    assert offset_warning(result, config.offset_limit) is None
