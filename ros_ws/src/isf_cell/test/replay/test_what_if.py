"""Names and values of other parameters, and what they change."""

from __future__ import annotations

from dataclasses import fields

import pytest
import yaml
from isf_cell.replay.what_if import OF_FORCE, RANGES, parse
from isf_core.errors import ErrorCode, IsfError
from isf_core.files.job import load_job
from isf_force_ctrl.control_config import SET_WHILE_FORMING, ControlConfig
from isf_force_ctrl.ros.parameters import ForceCtrlParameters
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
        ("force.adapt_stiffness=2", "true nor false"),
        ("path.incremental_depth=1 mm", "the plan"),
        ("control.rate=1 kHz", "the plan"),
        ("springbak.gain=1", r"springback\.gain"),
        ("force.set_point=120", r"control\.support_force"),
        ("force.vertical=true", r"control\.components"),
        ("force.vertical_force=40", r"control\.vertical_force"),
        ("force.tangential=true", r"control\.components"),
        ("force.tangential_force=5", r"control\.tangential_force"),
        ("springback.gain=[1", "no value"),
        ("force.loop_gain=[1", "no value"),
        ("force.loop_gain=[1,2]", "number"),
        ("force.support_compliance=3", "2 numbers"),
        ("force.support_compliance=[1e-8,-1e-8]", "range"),
        ("force.loop_gain=.nan", "range"),
        ("force.loop_gain=-5", "range"),
        ("force.loop_gain=true", "number"),
        ("force.filter_cutoff=0", "range"),
        ("force.acceleration=-1", "range"),
        ("force.blend_time=0", "range"),
        ("force.learning=7", "range"),
    ],
)
def test_what_cannot_be_changed_is_refused_with_what_can(change: str, named: str) -> None:
    with pytest.raises(IsfError, match=named) as caught:
        parse([change])
    assert caught.value.code == ErrorCode.FILE_FIELD


def test_ranges_are_those_of_the_parameters_of_the_node() -> None:
    declared = {item.name: item.metadata for item in fields(ForceCtrlParameters)}
    same = [name for name in OF_FORCE if name in declared and isinstance(getattr(ControlConfig, name), float)]
    assert {"loop_gain", "learning", "acceleration"} < set(same)
    assert {name: RANGES[name] for name in same} == {
        name: (declared[name]["minimum"], declared[name]["maximum"]) for name in same
    }


def test_what_may_change_in_the_middle_of_a_part_is_what_the_node_lets_set() -> None:
    names = {item.name for item in fields(ControlConfig)}
    declared = {item.name for item in fields(ForceCtrlParameters) if not item.metadata["read_only"]}
    assert set(SET_WHILE_FORMING) == names & declared


def test_a_section_of_the_job_may_be_empty() -> None:
    """``springback:`` with nothing below it is a job as well."""
    data = yaml.safe_load(JOB.text) | {"springback": None}
    changed = parse(["springback.gain=0.5"]).job_text(yaml.safe_dump(data))
    assert yaml.safe_load(changed)["springback"] == {"gain": 0.5}
    with pytest.raises(IsfError, match="no fields") as caught:
        parse(["springback.method.x=1"]).job_text(JOB.text)
    assert caught.value.code == ErrorCode.FILE_FIELD
    with pytest.raises(IsfError, match="range") as caught:
        parse(["force.integral_gain=-1"]).control(CONFIG)
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
