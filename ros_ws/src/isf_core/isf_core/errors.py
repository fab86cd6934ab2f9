"""The one catalogue of error codes: what went wrong, and what a person can do about it.

Codes are disjoint by owner: files 1000-1099, planner 1100-1199, force control
1200-1299, springback 1300-1399, machine 1400-1499, executive 1500-1599, recorder and
analysis 1600-1699. Code 0 means success. Action results, services and the ``isf``
command all use these codes.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from enum import IntEnum


class ErrorCode(IntEnum):
    """Numeric codes as they appear in messages, bags and exit reports."""

    OK = 0
    INTERNAL = 1
    """A fault of this software."""

    # files (job, rig, material, checkpoint)
    FILE_NOT_FOUND = 1001
    FILE_SYNTAX = 1002
    FILE_FIELD = 1003
    FILE_UNIT = 1004
    FILE_NOT_WRITABLE = 1005
    FILE_OUTSIDE = 1006
    CHECKPOINT_UNUSABLE = 1007
    PART_FINISHED = 1008

    # planner
    MESH_UNREADABLE = 1101
    MESH_EMPTY = 1102
    MESH_NOT_FINITE = 1103
    MESH_UNIT_SUSPECT = 1104
    MESH_INVERTED = 1105
    MESH_OPEN = 1106
    MESH_NOT_HEIGHT_FIELD = 1107
    PART_DOES_NOT_FIT = 1108
    PART_TOO_SMALL_FOR_TOOL = 1109
    WALL_TOO_STEEP = 1110
    CONTOUR_LOST = 1111
    PROCESS_NOT_SUPPORTED = 1112
    PLAN_UNKNOWN = 1113
    PLAN_CANCELLED = 1114
    MESH_UNIT_UNKNOWN = 1115
    MESH_NOT_MANIFOLD = 1116
    ADSIF_NOT_REACHABLE = 1130
    ADSIF_SURFACE_MISMATCH = 1131
    DIE_COLLISION = 1132
    PATH_BROKEN = 1133
    FEATURES_MIXED = 1134
    ISLAND_WITHOUT_FLOOR = 1135
    MORPH_NOT_REACHED = 1136
    PARTIAL_PATH_MISSING = 1137
    TOOL_AXIS_REFUSED = 1138
    SHANK_COLLISION = 1139
    ARM_COLLISION = 1140
    ARM_TOO_FAST = 1141
    TARGET_FOLDS = 1142
    LEGS_TOO_FAST = 1143
    PLAN_FILE_UNREADABLE = 1150
    EXPORT_FORMAT_UNKNOWN = 1151
    EXPORT_UNREADABLE = 1152
    COMPENSATION_FAILED = 1153
    PROGRAM_UNREADABLE = 1160
    PROGRAM_WORD_UNKNOWN = 1161
    PROGRAM_ARC_OPEN = 1162
    PROGRAM_OUT_OF_REACH = 1163
    PROGRAM_TOOL_UNKNOWN = 1164

    # force control
    WRENCH_NOT_FINITE = 1201
    WRENCH_LOST = 1202
    WRENCH_OUT_OF_RANGE = 1203
    NOT_ARMED = 1204
    NO_TARE = 1205
    CONTOUR_REJECTED = 1206
    STOPPED = 1207
    UNSTABLE_GAIN = 1208
    OFFSET_LIMIT = 1209
    WRENCH_FROZEN = 1210
    WRENCH_FRAME = 1211
    LOAD_CELL_SIGN = 1212
    CONTOUR_NOT_JOINED = 1213
    MEASUREMENT_FAILED = 1214
    WRENCH_INCONSISTENT = 1215
    WRENCH_LATE = 1220
    WRENCH_CLOCK = 1221
    POSE_LOST = 1222
    CONTOUR_OVERDUE = 1223
    EXECUTIVE_LOST = 1224
    MEASUREMENT_REFUSED = 1230
    SUPPORT_FORCE_WINDOW = 1240
    MOVE_OUT_OF_REACH = 1250
    MOVE_INTO_SHEET = 1251
    MOVE_INTO_TOOL = 1252
    TOUCHED = 1253
    HAND_LOST = 1254
    HAND_TAKEN = 1255

    # springback
    METHOD_UNKNOWN = 1301
    NO_FORCE_HISTORY = 1302
    CORRECTION_LIMITED = 1303
    CORRECTION_FAILED = 1304
    CONTOUR_OUT_OF_ORDER = 1305
    SCAN_MISSING = 1320
    SCAN_NOT_FINITE = 1321
    SCAN_UNIT_SUSPECT = 1322
    SCAN_INCOMPLETE = 1323
    SCAN_SHIFTED = 1324
    SCAN_OF_ANOTHER_PART = 1325
    QP_INFEASIBLE = 1326
    LEARNING_UNUSABLE = 1327
    LIFT_MISSING = 1328
    SHEET_MESH_FAILED = 1340
    SHELL_NOT_SOLVED = 1341
    DATABASE_UNUSABLE = 1342
    PUSH_CURVE_UNUSABLE = 1343

    # machine
    TARGET_NOT_FINITE = 1401
    TARGET_JUMP = 1402
    TARGET_OUT_OF_WORKSPACE = 1403
    TARGET_LOST = 1404
    FORCE_LIMIT = 1405
    STOP_REQUESTED = 1406
    TOOL_COLLISION = 1407
    NO_BLANK = 1408
    BLANK_DOES_NOT_FIT = 1409
    MACHINE_FAULTED = 1410
    LOAD_CELL_RANGE = 1411
    UNATTENDED = 1412
    SHEET_TORN = 1413
    SHEET_NOT_RELEASED = 1414
    SOLUTION_FAILED = 1420
    SHEET_MODEL_FAILED = 1421
    SHEET_MESH_COARSE = 1422
    LEG_NOT_FOLLOWING = 1430
    ENCODER_RANGE = 1431
    ENCODERS_DISAGREE = 1432
    SUPPLY_PRESSURE = 1433
    POWER_LOST = 1434
    OIL_HOT = 1435

    # executive
    NODE_MISSING = 1501
    NODE_DIED = 1502
    TRANSITION_FAILED = 1503
    CANCELLED = 1504
    BUSY = 1505
    SERVICE_TIMEOUT = 1506
    CONTOUR_TIMEOUT = 1507
    NODE_INACTIVE = 1508
    QOS_INCOMPATIBLE = 1509
    SECOND_PUBLISHER = 1510
    VERSION_MISMATCH = 1511
    ROS_NOT_STARTED = 1512
    MODE_REFUSED = 1513

    # recorder and analysis
    BAG_UNREADABLE = 1601
    BAG_INCOMPLETE = 1602
    BAG_NOT_WRITABLE = 1603
    PORT_UNAVAILABLE = 1610

    @property
    def owner(self) -> str:
        """Name of the part of the system that raises this code."""
        for start, name in _OWNERS:
            if self.value >= start:
                return name
        return "ok"


_OWNERS = (
    (1600, "analysis"),
    (1500, "executive"),
    (1400, "machine"),
    (1300, "springback"),
    (1200, "force_ctrl"),
    (1100, "planner"),
    (1000, "files"),
    (1, "software"),
)


class IsfError(Exception):
    """An expected failure with a code, a place and an advice; never shown as a traceback.

    Attributes
    ----------
    code : ErrorCode
    what : what went wrong, one sentence
    where : file, line, field, contour or point ("" when there is no place)
    advice : what to do about it ("" when nothing better than the sentence is known)
    """

    def __init__(self, code: ErrorCode, what: str, *, where: str = "", advice: str = "") -> None:
        self.code = ErrorCode(code)
        self.what = what
        self.where = where
        self.advice = advice
        super().__init__(self.message)

    @property
    def message(self) -> str:
        """One line for people: place, what, advice."""
        text = f"{self.where}: {self.what}" if self.where else self.what
        return f"{text} ({self.advice})" if self.advice else text

    def __reduce__(self) -> tuple[Callable[..., IsfError], tuple[int, str, str, str]]:
        return _restored, (self.code.value, self.what, self.where, self.advice)  # for a failure in another process

    def __str__(self) -> str:
        return f"[{self.code.value} {self.code.name}] {self.message}"


def _restored(code: int, what: str, where: str, advice: str) -> IsfError:
    return IsfError(ErrorCode(code), what, where=where, advice=advice)


def told(text: str) -> IsfError | None:
    """The failure that ``str`` of one says somewhere in ``text``, all of it as the sentence; None without a code."""
    found = re.search(r"\[(\d+) [A-Z_]+\] ", text)
    if found is None or int(found[1]) not in set(ErrorCode):
        return None
    return IsfError(ErrorCode(int(found[1])), text[: found.start()] + text[found.end() :])


def failure(
    code: ErrorCode | int, text: str, *, where: str = "", otherwise: ErrorCode = ErrorCode.TRANSITION_FAILED
) -> IsfError:
    """The failure ``code`` that another process or a record tells with ``text``.

    One that is not of this catalogue (of a driver, of another version) is ``otherwise``, with its number in the text.
    """
    if code and code in set(ErrorCode):
        return IsfError(ErrorCode(code), text, where=where)
    return IsfError(otherwise, f"unknown error code {code}: {text or 'without a text'}", where=where)


def coded(error: Exception, *, where: str = "", advice: str = "a fault of this software") -> IsfError:
    """``error`` itself when it was expected, else INTERNAL with its kind and text."""
    if isinstance(error, IsfError):
        return error
    return IsfError(ErrorCode.INTERNAL, f"{type(error).__name__}: {error}", where=where, advice=advice)
