"""Node force_ctrl with a defect: its control law raises what nobody expects.

Where the file ``FAULT`` (environment) exists with the word "once", the next tick of a contour raises, with "always"
every tick does.
"""

import os
import sys
from pathlib import Path
from typing import Any

from isf_force_ctrl import node
from isf_force_ctrl.controller import ForceController


class DefectiveController(ForceController):
    def tick(self, *arguments: Any) -> Any:
        file = Path(os.environ["FAULT"])
        word = file.read_text() if file.exists() else ""
        if word == "once":
            file.write_text("")
        if word:
            raise IndexError("in a control law")
        return super().tick(*arguments)


if __name__ == "__main__":
    node.ForceController = DefectiveController  # type: ignore[misc]
    sys.exit(node.main())
