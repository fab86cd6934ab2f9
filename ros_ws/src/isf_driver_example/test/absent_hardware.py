"""The driver on hardware that cannot be reached at first; started by test_driver_node.py."""

from isf_driver_example import driver_node
from isf_driver_example.hardware import Hardware

TRIED: list[float] = []


class Absent(Hardware):
    """Raises an exception when it is made for the first time."""

    def __init__(self, cycle: float) -> None:
        TRIED.append(cycle)
        if len(TRIED) == 1:
            raise ConnectionError("no answer from the field bus")
        super().__init__(cycle)


if __name__ == "__main__":
    driver_node.Hardware = Absent  # type: ignore[misc]
    driver_node.main()
