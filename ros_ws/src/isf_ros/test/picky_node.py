"""A cell node with one topic of each delivery; started by test_qos_match.py."""

import sys
from dataclasses import dataclass

from isf_ros import process, qos
from isf_ros.lifecycle import CellNode
from isf_ros.parameters import parameter
from std_msgs.msg import String


@dataclass(frozen=True)
class PickyParameters:
    """Parameters of the node."""

    streams: bool = parameter(False, "served as the nodes with streams are")


class PickyNode(CellNode[PickyParameters]):
    def __init__(self) -> None:
        super().__init__("picky", PickyParameters, autostart=True)
        self._received: dict[str, str] = {"stream": "", "latched": ""}

    def configure(self) -> None:
        self.create_subscription(String, "stream", lambda m: self._received.update(stream=m.data), qos.STREAM)
        self.create_subscription(String, "latched", lambda m: self._received.update(latched=m.data), qos.LATCHED)
        self.create_publisher(String, "sensor", qos.SENSOR)

    def health_values(self) -> dict[str, object]:
        return dict(self._received)


if __name__ == "__main__":
    sys.exit(process.run(PickyNode, streams="streams:=true" in sys.argv))
