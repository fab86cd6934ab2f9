"""The driver on hardware that is lost while the tools form; started by test_driver_node.py."""

from isf_driver_example import driver_node
from isf_driver_example.hardware import Array, Hardware

DEEP = -1.2e-3
"""m: below it a target has the next cycle fail."""


class Lost(Hardware):
    """Raises an exception in a cycle, and once more when it is to stop for it; in its first scan, too."""

    lost = to_fail = False
    scanned = False

    def move(self, tool: int, tip: tuple[float, float, float]) -> None:
        super().move(tool, tip)
        self.to_fail = tip[2] < DEEP

    def cycle(self) -> Array:
        if self.to_fail:
            self.to_fail, self.lost = False, True
            raise ConnectionError("the field bus has lost a cycle")
        return super().cycle()

    def stop(self, reason: str) -> None:
        if self.lost:
            self.lost = False
            raise ConnectionError("the field bus does not answer")
        super().stop(reason)

    def scan(self) -> Array:
        if not self.scanned:
            self.scanned = True
            raise TimeoutError("no answer from the scanner")
        return super().scan()


if __name__ == "__main__":
    driver_node.Hardware = Lost  # type: ignore[misc]
    driver_node.main()
