"""What the page of nodes names as a topic of the cell is in a recording, with its type and delivery."""

from __future__ import annotations

import re
from pathlib import Path

from isf_analysis.bag.topics import CELL

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "nodes.md"


def named_topics() -> dict[str, tuple[str, str]]:
    """Name to type and words on delivery, from the table of topics; without those that it says are not recorded."""
    text = PAGE.read_text(encoding="utf-8")
    found = {}
    for line in re.findall(r"^\| (`.*) \|$", text[text.index("| topic | type |") :].split("\n\n")[0], re.MULTILINE):
        names, kind, delivery = line.split(" | ")[:3]
        for name in re.findall(r"`([^`]+)`", names):
            if not kind.endswith("not recorded"):
                found[name] = (kind, delivery)
    return found


def test_every_topic_of_the_page_of_nodes_is_recorded() -> None:
    named = named_topics()
    assert len(named) > 15
    assert set(named) == {topic.name for topic in CELL}


def test_lifts_are_recorded_as_the_executive_publishes_them() -> None:
    (lift,) = [topic for topic in CELL if topic.name == "tool_lift"]
    kind, delivery = named_topics()["tool_lift"]
    assert kind.startswith("sensor_msgs/PointCloud2")
    assert (lift.type, lift.delivery) == ("sensor_msgs/msg/PointCloud2", delivery)
