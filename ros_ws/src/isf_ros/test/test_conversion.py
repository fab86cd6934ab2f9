"""Conversion between core dataclasses and messages: exact, without copies on reading, through real DDS."""

from __future__ import annotations

import math
import os
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import fields as dataclass_fields
from pathlib import Path
from typing import Any

import forked_process
import numpy as np
import pytest
import rclpy
from isf_core.contour import Contour, ContourCorrection, ContourResult, Process
from isf_core.geometry.height_map import HeightMap
from isf_msgs.action import FormPart
from isf_msgs.msg import Contour as ContourMessage
from isf_msgs.msg import ContourCorrection as CorrectionMessage
from isf_msgs.msg import ContourResult as ResultMessage
from isf_msgs.msg import MachineState
from isf_msgs.srv import Arm
from isf_ros import conversion, fields, qos, stamps
from sensor_msgs.msg import PointField

RANDOM = np.random.default_rng(1)


def contour(n: int = 2000, *, support: bool = True) -> Contour:
    def xyz() -> np.ndarray:
        return RANDOM.normal(size=(n, 3))

    return Contour(
        plan_id="cone-é",
        index=3,
        count=42,
        process=Process.DSIF,
        feed=0.03,
        contact=xyz(),
        normal=xyz(),
        wall_angle=RANDOM.random(n),
        thickness=RANDOM.random(n),
        forming_tip=xyz(),
        support_tip=xyz() if support else np.empty((0, 3)),
        support_force=np.full(n, 120.0) if support else np.empty(0),
        forming_tool=2,
        closed=False,
        feature=5,
        stage=1,
    )


def correction(n: int = 50) -> ContourCorrection:
    return ContourCorrection(
        plan_id="cone",
        index=3,
        method="analytic",
        offset=RANDOM.normal(size=(n, 3)),
        springback=RANDOM.random(n),
        control_point=RANDOM.random((4, 3)),
        control_point_springback=RANDOM.random(4),
        control_point_force=RANDOM.random(4),
        saturated=RANDOM.random(n) > 0.5,
        code=1303,
        message="limited",
        solve_time=0.002,
    )


def result(n: int = 50, ticks: int = 321) -> ContourResult:
    def xyz() -> np.ndarray:
        return RANDOM.normal(size=(n, 3))

    return ContourResult(
        plan_id="cone",
        index=3,
        start=12.5,
        end=13.142,
        completed=True,
        forming_force=xyz(),
        support_force=xyz(),
        forming_target=xyz(),
        support_target=xyz(),
        force_offset=RANDOM.random(n),
        compliance_offset=xyz(),
        tick_time=np.arange(ticks) / 500,
        tick_set_point=np.full(ticks, 120.0),
        tick_normal_force=RANDOM.random(ticks),
        tick_engaged=np.arange(ticks) > 20,
        contact_fraction=0.99,
        saturations=7,
        late_ticks=1,
        lost_messages=2,
    )


SAMPLES = [contour(), contour(support=False), correction(), result()]


def assert_same(first: Any, second: Any) -> None:
    assert type(first) is type(second)
    for item in dataclass_fields(first):
        a, b = getattr(first, item.name), getattr(second, item.name)
        if isinstance(a, np.ndarray):
            assert a.shape == b.shape, item.name
            assert a.dtype == b.dtype, item.name
            np.testing.assert_array_equal(a, b, err_msg=item.name)
        elif item.name in ("start", "end"):
            assert abs(a - b) < 1e-9  # stamps are whole nanoseconds
        else:
            assert a == b, item.name


TO_MESSAGE = {
    Contour: conversion.contour_to_message,
    ContourCorrection: conversion.correction_to_message,
    ContourResult: conversion.result_to_message,
}
FROM_MESSAGE = {
    Contour: conversion.contour_from_message,
    ContourCorrection: conversion.correction_from_message,
    ContourResult: conversion.result_from_message,
}


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda sample: type(sample).__name__)
def test_there_and_back_is_exact(sample: Any) -> None:
    kind = type(sample)
    assert_same(sample, FROM_MESSAGE[kind](TO_MESSAGE[kind](sample)))


@pytest.mark.parametrize(
    ("table", "core", "message", "by_design"),
    [
        (fields.CONTOUR, Contour, ContourMessage, set()),
        (fields.CORRECTION, ContourCorrection, CorrectionMessage, {"inputs", "horizon"}),
        (fields.RESULT, ContourResult, ResultMessage, set()),
    ],
)
def test_the_table_names_every_field_of_both_sides(
    table: dict[str, str], core: type, message: Any, by_design: set[str]
) -> None:
    assert set(table) == {item.name for item in dataclass_fields(core)}
    assert set(table) == set(message.get_fields_and_field_types()) - {"header"} - by_design


def test_reading_a_message_does_not_copy_its_arrays() -> None:
    message = conversion.contour_to_message(contour())
    read = conversion.contour_from_message(message)
    for name in ("contact", "wall_angle", "support_force"):
        assert np.shares_memory(getattr(read, name), np.asarray(getattr(message, name))), name


@pytest.mark.parametrize(
    ("codes", "texts", "code", "words"),
    [
        ([1405, 1402], ["too much", "far"], 1405, "too much"),
        ([9001], ["door open"], 1410, "unknown error code 9001: door open"),  # a driver's own
        ([9001], [], 1410, "9001"),
        ([0], ["?"], 1410, "unknown error code 0"),
    ],
)
def test_the_fault_of_a_driver_is_told_whatever_its_code(
    codes: list[int], texts: list[str], code: int, words: str
) -> None:
    fault = conversion.machine_fault(MachineState(fault_codes=codes, fault_messages=texts))
    assert (int(fault.code), fault.where) == (code, "machine")
    assert words in fault.what


def test_a_set_point_that_was_left_out_is_that_of_the_job() -> None:
    for request in (Arm.Request(), FormPart.Goal(), Arm.Request(support_force=math.nan)):
        assert conversion.set_point_of(request.support_force) is None
    assert conversion.set_point_of(Arm.Request(support_force=0.0).support_force) == 0.0  # position control
    assert conversion.set_point_of(120.0) == 120.0
    assert conversion.set_point_of(-2.0) == -2.0  # to be refused by whoever gets it


def test_a_height_map_goes_through_a_point_cloud() -> None:
    x, y = np.linspace(-0.1, 0.1, 7), np.linspace(-0.2, 0.2, 5)
    shape = HeightMap(x, y, RANDOM.normal(size=(5, 7)))
    cloud = conversion.height_map_to_message(shape, stamps.to_stamp(5))
    assert (cloud.height, cloud.width) == (5, 7)
    back = conversion.height_map_from_message(cloud)
    np.testing.assert_array_equal(back.z, shape.z)
    cloud.point_step = 12
    with pytest.raises(ValueError, match="float64"):
        conversion.height_map_from_message(cloud)


def test_a_target_takes_the_shapes_of_the_stages_along() -> None:
    x, y = np.linspace(-0.1, 0.1, 7), np.linspace(-0.2, 0.2, 5)
    target, *preforms = (HeightMap(x, y, RANDOM.normal(size=(5, 7))) for _ in range(4))
    for some in ([], preforms):
        cloud = conversion.target_to_message(target, some, stamps.to_stamp(5))
        part, back = conversion.target_from_message(cloud)
        assert len(back) == len(some)
        for a, b in zip([part, *back], [target, *some], strict=True):
            np.testing.assert_array_equal(a.z, b.z)
            np.testing.assert_array_equal(a.x, x)
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "z_stage_1", "z_stage_2", "z_stage_3"]
    cloud.fields[4].name = "z_stage_4"
    with pytest.raises(ValueError, match="z_stage_2"):
        conversion.target_from_message(cloud)


def test_a_target_of_another_planner_may_have_other_fields() -> None:
    """float32, in an order of its own, with a field that nobody here knows."""
    x, y = np.linspace(-0.125, 0.125, 3), np.linspace(-0.25, 0.25, 5)
    gx, gy = np.meshgrid(x, y)
    names = ["intensity", "z", "y", "x"]
    table = np.column_stack([np.ones(15), np.arange(15.0), gy.ravel(), gx.ravel()]).astype("<f4")
    cloud = conversion.height_map_to_message(HeightMap(x, y, gx), stamps.to_stamp(5))
    cloud.fields = [PointField(name=n, offset=4 * k, datatype=7, count=1) for k, n in enumerate(names)]
    cloud.point_step, cloud.row_step, cloud.data = 16, 48, table.tobytes()
    part, preforms = conversion.target_from_message(cloud)
    assert preforms == ()
    np.testing.assert_array_equal(part.x, x)
    np.testing.assert_array_equal(part.z, np.arange(15.0).reshape(5, 3))


def test_tick_stamps_do_not_drift() -> None:
    for rate in (250.0, 440.0, 500.0, 1000.0):
        for tick in (0, 1, 3, 10**7):
            stamp = stamps.to_stamp(stamps.tick_nanoseconds(tick, rate))
            assert stamps.to_nanoseconds(stamp) == stamps.tick_nanoseconds(tick, rate)
            assert abs(stamps.to_seconds(stamp) - tick / rate) <= 0.5e-9 + 1e-16 * tick


@pytest.fixture
def echo_process() -> Iterator[forked_process.ForkedProcess]:
    process = forked_process.start(
        [sys.executable, str(Path(__file__).with_name("echo_node.py"))], start_new_session=True
    )
    yield process
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(120) == 0


@pytest.mark.graph
def test_messages_survive_a_round_trip_through_another_process(echo_process: forked_process.ForkedProcess) -> None:
    rclpy.init()
    node = rclpy.create_node("round_trip")
    received: dict[type, Any] = {}
    samples = {Contour: contour(), ContourCorrection: correction(), ContourResult: result()}
    names = {Contour: "contour", ContourCorrection: "correction", ContourResult: "result"}
    messages = {Contour: ContourMessage, ContourCorrection: CorrectionMessage, ContourResult: ResultMessage}
    try:
        for kind, sample in samples.items():

            def keep(message: Any, kind: type = kind) -> None:
                received[kind] = FROM_MESSAGE[kind](message)

            node.create_subscription(messages[kind], f"{names[kind]}_back", keep, qos.LATCHED)
            node.create_publisher(messages[kind], names[kind], qos.LATCHED).publish(TO_MESSAGE[kind](sample))
        deadline = time.monotonic() + 120
        while len(received) < 3 and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.1)
        assert set(received) == set(samples)
        for kind, sample in samples.items():
            assert_same(sample, received[kind])
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
