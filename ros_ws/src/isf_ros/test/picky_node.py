"""A cell node with one topic of each delivery; started by test_qos_match.py.

It hears the name of a node only with the third look at the publishers of a topic, as happens on a busy computer.
"""

import sys
from collections import Counter
from dataclasses import dataclass
from typing import Any

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
        self._looks: Counter[str] = Counter()

    def configure(self) -> None:
        self.create_subscription(String, "stream", lambda m: self._received.update(stream=m.data), qos.STREAM)
        self.create_subscription(String, "latched", lambda m: self._received.update(latched=m.data), qos.LATCHED)
        self.create_publisher(String, "sensor", qos.SENSOR)

    def get_publishers_info_by_topic(self, topic_name: str, *args: Any, **options: Any) -> Any:
        infos = super().get_publishers_info_by_topic(topic_name, *args, **options)
        self._looks[topic_name] += bool(infos)
        if self._looks[topic_name] < 3:
            for info in infos:
                info.node_name = "_NODE_NAME_UNKNOWN_"
        return infos

    def health_values(self) -> dict[str, object]:
        return dict(self._received)


if __name__ == "__main__":
    sys.exit(process.run(PickyNode, streams="streams:=true" in sys.argv))
