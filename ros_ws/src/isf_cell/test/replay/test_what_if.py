"""Names and values of other parameters, and what they change."""

from __future__ import annotations

import pytest
import yaml
from isf_cell.replay.what_if import parse
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_force_ctrl.control_config import ControlConfig
from quick_cone import FOLDER

JOB = load_job(FOLDER / "mini_cone.yaml")
CONFIG = ControlConfig.from_job(JOB)


def test_the_integral_gain_is_the_loop_gain_over_the_contact_stiffness() -> None:
    """Ren 2018, 2.3.3: K_c = 0.45 N/um on this rig, so 80 um/(N s) are 36 1/s."""
    assert parse(["force.integral_gain=80"]).control(CONFIG).loop_gain == pytest.approx(36.0, rel=1e-12)
    assert parse(["force_ctrl.loop_gain=30"]).control(CONFIG).loop_gain == 30.0
    assert parse(["force.adapt_stiffness=true"]).control(CONFIG).adapt_stiffness is True


def test_fields_of_the_job_take_their_unit() -> None:
    changes = parse(["control.compliance_compensation=0.5", "springback.mpc.largest_offset=4 mm"])
    job = yaml.safe_load(changes.job_text(JOB.text))
    assert job["control"]["compliance_compensation"] == 0.5
    assert job["springback"]["mpc"]["largest_offset"] == "4 mm"
    assert job["path"] == yaml.safe_load(JOB.text)["path"]
    assert parse([]).job_text(JOB.text) == JOB.text


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ("force.integral_gain", "NAME=VALUE"),
        ("force.integral_gian=80", "integral_gain"),
        ("force.loop_gain=fast", "number"),
        ("force.adapt_stiffness=2", "number"),
        ("path.incremental_depth=1 mm", "the plan"),
        ("control.rate=1 kHz", "the plan"),
        ("springbak.gain=1", r"springback\.gain"),
    ],
)
def test_what_cannot_be_changed_is_refused_with_what_can(change: str, named: str) -> None:
    with pytest.raises(IsfError, match=named) as caught:
        parse([change])
    assert caught.value.code == ErrorCode.FILE_FIELD


def test_a_gain_that_would_not_be_stable_is_refused() -> None:
    with pytest.raises(IsfError) as caught:
        parse(["force.loop_gain=400"]).control(CONFIG)
    assert caught.value.code == ErrorCode.UNSTABLE_GAIN


def test_parameters_survive_their_text() -> None:
    changed = parse(["force.feed_error=.inf", "force.loop_gain=23.7"]).control(CONFIG)
    assert ControlConfig.from_json(changed.to_json()) == changed
    for text in ("[]", '{"rate": 500.0}', "no"):
        with pytest.raises(ValueError, match=r".+"):
            ControlConfig.from_json(text)
