"""Node force_ctrl that writes the file ``LAST_TARGETS`` (environment) before the last targets of a move go out."""

import os
import sys
from pathlib import Path
from typing import Any

from isf_force_ctrl import node
from isf_force_ctrl.controller import ForceController


class MarkingController(ForceController):
    def tick(self, *arguments: Any) -> Any:
        targets = super().tick(*arguments)
        if not self.busy:
            Path(os.environ["LAST_TARGETS"]).touch()
        return targets


if __name__ == "__main__":
    node.ForceController = MarkingController  # type: ignore[misc]
    sys.exit(node.main())
