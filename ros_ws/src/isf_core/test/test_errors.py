"""The error catalogue: ranges, owners, wording."""

import pickle

from isf_core.errors import ErrorCode, IsfError

RANGES = {
    "software": range(1, 2),
    "files": range(1000, 1100),
    "planner": range(1100, 1200),
    "force_ctrl": range(1200, 1300),
    "springback": range(1300, 1400),
    "machine": range(1400, 1500),
    "executive": range(1500, 1600),
    "analysis": range(1600, 1700),
}


def test_codes_lie_in_the_range_of_their_owner() -> None:
    for code in ErrorCode:
        if code != ErrorCode.OK:
            assert code.value in RANGES[code.owner], code


def test_an_error_reports_code_place_what_and_advice() -> None:
    error = IsfError(ErrorCode.MESH_OPEN, "3 holes", where="cone.stl", advice="repair the mesh")
    assert str(error) == "[1106 MESH_OPEN] cone.stl: 3 holes (repair the mesh)"
    assert str(IsfError(ErrorCode.MESH_OPEN, "3 holes")) == "[1106 MESH_OPEN] 3 holes"


def test_a_failure_of_another_process_arrives_whole() -> None:
    sent = IsfError(ErrorCode.FILE_FIELD, "is 3", where="job.yaml:4", advice="take 2")
    arrived = pickle.loads(pickle.dumps(sent))
    assert vars(arrived) == vars(sent)
    assert str(arrived) == str(sent)
