"""Several nodes of a cell in one process: less memory and fewer participants of the middleware than one each.

    ros2 run isf_cell together planner springback cell_state_publisher --ros-args -p springback:autostart:=true

ROS arguments for one of them begin with its name (``-p NODE:NAME:=VALUE``, ``-r NODE:FROM:=TO``). Each node has a
thread and an executor of its own, but they share the interpreter, so nodes that tick or record are not among them. They
end together, too.
"""

from __future__ import annotations

import sys
from importlib.metadata import entry_points

from isf_core.errors import ErrorCode, IsfError
from isf_ros import process
from rclpy.utilities import remove_ros_args

NODES = {
    "cell_state_publisher": "isf_description",
    "dashboard": "isf_dashboard",
    "executive": "isf_cell",
    "planner": "isf_planner",
    "springback": "isf_springback",
}
"""Name and package. Those that tick or record have the interpreter for themselves."""


def wanted(names: list[str]) -> list[process.Wanted]:
    """The nodes of that ``names``; raises IsfError NODE_MISSING."""
    found: list[process.Wanted] = []
    wrong = sorted({name for name in names if name not in NODES or names.count(name) > 1})
    if wrong or not names:
        raise IsfError(
            ErrorCode.NODE_MISSING,
            f"{', '.join(wrong)}: no node to run together with others, or named twice" if wrong else "no node is named",
            where="together",
            advice=f"name some of {', '.join(NODES)}, once each",
        )
    for name in names:
        scripts = [item for item in entry_points(group="console_scripts", name=name) if item.module.startswith("isf_")]
        if not scripts:
            what = f"package '{NODES[name]}' is not installed"
            raise IsfError(ErrorCode.NODE_MISSING, what, where="together", advice="build the workspace")
        found += process.wanted_by(scripts[0].load())
    return found


def main() -> int:
    """Entry point of ``ros2 run isf_cell together``."""
    try:
        nodes = wanted(remove_ros_args(sys.argv)[1:])
    except IsfError as error:
        print(error, file=sys.stderr)
        return process.EXIT_ERROR
    return process.run_together(nodes)


if __name__ == "__main__":
    sys.exit(main())
