"""A small cell node whose configuration can be made to fail; started by test_lifecycle.py."""

import sys
import time
from dataclasses import dataclass

from isf_core.errors import ErrorCode, IsfError
from isf_ros import process
from isf_ros.lifecycle import CellNode
from isf_ros.parameters import parameter


@dataclass(frozen=True)
class SampleParameters:
    """Parameters of the sample."""

    broken: bool = parameter(False, "configuration fails")
    gain: float = parameter(1.5, "a number that may change", read_only=False)
    work: float = parameter(0.0, "s that configuration takes")
    closing_note: str = parameter("", "file written when the process ends")


class SampleNode(CellNode[SampleParameters]):
    def __init__(self) -> None:
        super().__init__("sample", SampleParameters)

    def configure(self) -> None:
        if self.values().broken:
            raise IsfError(ErrorCode.FILE_FIELD, "a wrong field", advice="correct it")
        began, work = time.monotonic(), self.values().work
        while time.monotonic() < began + min(work, 3.0):
            pass  # as a computation does, which leaves the interpreter to other threads only now and then
        left = max(0.0, began + work - time.monotonic())
        time.sleep(left)  # the fault itself: a callback that takes long; asleep it holds up this node alone

    def close(self) -> None:
        if self.values().closing_note:
            with open(self.values().closing_note, "w") as note:
                note.write("closed")

    def health_values(self) -> dict[str, object]:
        return {"gain": self.values().gain}


if __name__ == "__main__":
    sys.exit(process.run(SampleNode))
