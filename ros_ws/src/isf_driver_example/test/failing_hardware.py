"""The driver on hardware that fails once, in the first cycle of a release; started by test_driver_node.py."""

from isf_driver_example import driver_node
from isf_driver_example.hardware import Array, Hardware

FAILED: list[str] = []


class Failing(Hardware):
    """Raises an exception when it is to move for the first time after a stop."""

    def cycle(self) -> Array:
        if self.stopped and not FAILED:
            FAILED.append(self.stopped)
            raise ConnectionError("the field bus has lost a cycle")
        return super().cycle()


if __name__ == "__main__":
    driver_node.Hardware = Failing  # type: ignore[misc]
    driver_node.main()
