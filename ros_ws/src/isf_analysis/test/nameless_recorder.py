"""The recorder where the middleware never tells whose a topic is; started by test_recorder.py."""

import sys
from typing import Any

from isf_analysis import recorder_node


class NamelessRecorder(recorder_node.RecorderNode):
    def get_publishers_info_by_topic(self, topic_name: str, *args: Any, **options: Any) -> Any:
        infos = super().get_publishers_info_by_topic(topic_name, *args, **options)
        for info in infos:
            info.node_name = "_NODE_NAME_UNKNOWN_"
        return infos


recorder_node.RecorderNode = NamelessRecorder  # type: ignore[misc]

if __name__ == "__main__":
    sys.exit(recorder_node.main())
