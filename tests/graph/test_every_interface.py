"""Every topic, service and action of every node, by what is in the graph and by docs/reference/nodes.md alone.

As the tools of ros2 do it: types are looked up by their names in the graph, messages are made of YAML, and a topic is
echoed with the delivery that its publishers offer. The test imports no message of the cell. First all is asked for
wrongly, then rightly.
"""

from __future__ import annotations

import importlib
import itertools
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from action_msgs.msg import GoalStatus
from isf_cell.processes.process_group import ProcessGroup
from isf_cell.run.graph_cell import NOT_HEARD_YET
from quick_cone import quick_cone, quick_cone_file
from rclpy.action import ActionClient, get_action_names_and_types
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from waiting import Waiting

pytestmark = [pytest.mark.graph, pytest.mark.clock, pytest.mark.usefixtures("forked_nodes")]

REFERENCE = Path(__file__).resolve().parents[2] / "docs" / "reference"
EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "jobs"

OF_EVERY_NODE = {
    *(f"{verb}_parameters" for verb in ("describe", "get", "list", "set")),
    *("get_parameter_types", "set_parameters_atomically", "get_type_description"),
    *("change_state", "get_state", "get_available_states", "get_available_transitions", "get_transition_graph"),
}
"""Services that any lifecycle node of ROS has, below its name."""


# -- what the pages say ----------------------------------------------------------------------------


def rows(head: str) -> Iterator[list[str]]:
    """Cells of the lines of the table of nodes.md that begins with ``head``."""
    text = (REFERENCE / "nodes.md").read_text(encoding="utf-8")
    for line in text[text.index(head) :].split("\n\n")[0].splitlines()[2:]:
        yield [cell.strip() for cell in line.strip("|").split(" | ")]


def documented(head: str) -> dict[str, tuple[str, str]]:
    """Name to type (``package/Type``) and third column."""
    found = {}
    for names, types, third, *_ in rows(head):
        listed = re.findall(r"`([^`]+)`", names)
        kinds = re.findall(r"\b(?:\w+_msgs|std_srvs|rcl_interfaces)/\w+", types)
        assert len(kinds) in (1, len(listed)), names
        found |= {name: (kind, third) for name, kind in zip(listed, kinds * len(listed), strict=False)}
    return found


TOPICS = {re.sub("tool_[12]/raw", "tool_k/raw", name): of for name, of in documented("| topic | type |").items()}
SERVICES = documented("| service | type |")
ACTIONS = documented("| action | type |")
CODES = {
    int(code) for code in re.findall(r"^\| (\d+) \|", (REFERENCE / "error_codes.md").read_text(), flags=re.MULTILINE)
}


# -- what tools of ros2 do -------------------------------------------------------------------------


@cache
def type_of(name: str) -> Any:
    """Class of ``package/kind/Type``."""
    package, folder, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), kind)


def filled(message: Any, values: dict[str, Any]) -> Any:
    """``message`` with the fields of a YAML text."""
    for name, value in values.items():
        inner = getattr(message, name)
        setattr(message, name, filled(inner, value) if isinstance(value, dict) else type(inner)(value))
    return message


def hidden(name: str) -> bool:
    return any(part.startswith("_") for part in name.split("/"))


@dataclass
class Answer:
    """Of an action: accepted or not, its feedback, and its end."""

    accepted: bool
    feedback: list[Any]
    status: int = GoalStatus.STATUS_UNKNOWN
    result: Any = None


class Tools:
    """``ros2 topic``, ``ros2 service`` and ``ros2 action``."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("tools")
        self._waiting = Waiting(self.node)
        self.heard: dict[str, list[Any]] = {}
        self._clients: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}
        self._actions: dict[str, ActionClient] = {}

    def close(self) -> None:
        for client in self._actions.values():
            client.destroy()
        self._waiting.close()
        self.node.destroy_node()

    def wait(self, condition: Callable[[], Any], what: object = "") -> None:
        assert self._waiting.until(condition), what

    def services(self) -> dict[str, str]:
        """``ros2 service list -t``."""
        return {name: kinds[0] for name, kinds in self.node.get_service_names_and_types() if not hidden(name)}

    def topics(self) -> dict[str, str]:
        """``ros2 topic list -t``."""
        return {name: kinds[0] for name, kinds in self.node.get_topic_names_and_types() if not hidden(name)}

    def actions(self) -> dict[str, str]:
        """``ros2 action list -t``."""
        return {name: kinds[0] for name, kinds in get_action_names_and_types(self.node)}

    def call(self, name: str, text: str = "{}") -> Any:
        """``ros2 service call``: a type from the graph, a request from YAML."""
        kind = type_of(self.services()[name])
        client = self._clients.get(name) or self._clients.setdefault(name, self.node.create_client(kind, name))
        self.wait(client.service_is_ready, name)
        future = client.call_async(filled(kind.Request(), yaml.safe_load(text)))
        self.wait(future.done, name)
        return future.result()

    def send_goal(self, name: str, text: str = "{}", during: Callable[[Any], bool] | None = None) -> Answer:
        """``ros2 action send_goal --feedback``; ``during`` is asked with the newest feedback until it is true."""
        answer, handle = self.begin_goal(name, text)
        if handle is None:
            return answer
        result = handle.get_result_async()
        if during is not None:
            self.wait(lambda: result.done() or (answer.feedback and during(answer.feedback[-1])), name)
        self.wait(result.done, name)
        answer.status, answer.result = result.result().status, result.result().result
        return answer

    def cancel(self, name: str, text: str) -> Answer:
        """``ros2 action send_goal``, and Ctrl-C as soon as there is feedback.

        A goal that force_ctrl refuses because it has not heard the machine for a second, as on a busy computer, is sent
        again, as the executive does; three times at most.
        """
        for _ in range(3):
            answer, handle = self.begin_goal(name, text)
            assert handle is not None, name
            result = handle.get_result_async()
            self.wait(lambda: answer.feedback or result.done(), name)  # noqa: B023
            if not result.done():
                break
            assert result.result().result.code in NOT_HEARD_YET, (name, result.result())
        cancelled = handle.cancel_goal_async()
        self.wait(cancelled.done, name)
        self.wait(result.done, name)
        answer.status, answer.result = result.result().status, result.result().result
        return answer

    def begin_goal(self, name: str, text: str) -> tuple[Answer, Any]:
        kind = type_of(self.actions()[name])
        client = self._actions.get(name) or self._actions.setdefault(name, ActionClient(self.node, kind, name))
        self.wait(client.server_is_ready, name)
        feedback: list[Any] = []
        goal = filled(kind.Goal(), yaml.safe_load(text))
        sent = client.send_goal_async(goal, feedback_callback=lambda message: feedback.append(message.feedback))
        self.wait(sent.done, name)
        handle = sent.result()
        return Answer(handle.accepted, feedback), handle if handle.accepted else None

    def echo(self, name: str) -> None:
        """``ros2 topic echo``, from now on: reliable and latched where all publishers are."""
        if name in self.heard:
            return
        infos = [info.qos_profile for info in self.node.get_publishers_info_by_topic(name)]
        reliable = all(info.reliability == ReliabilityPolicy.RELIABLE for info in infos)
        latched = all(info.durability == DurabilityPolicy.TRANSIENT_LOCAL for info in infos)
        profile = QoSProfile(
            depth=10,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        self.heard[name] = []
        self.node.create_subscription(type_of(self.topics()[name]), name, self.heard[name].append, profile)

    def publish(self, name: str, text: str = "{}") -> None:
        """``ros2 topic pub --once``: with the delivery that the tool has, reliable and volatile."""
        kind = type_of(self.topics()[name])
        publisher = self._publishers.get(name)
        if publisher is None:
            profile = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # all that may be asked for
            publisher = self._publishers[name] = self.node.create_publisher(kind, name, profile)
            self.wait(publisher.get_subscription_count, name)
        publisher.publish(filled(kind(), yaml.safe_load(text)))

    def stop_publishing(self) -> None:
        for publisher in self._publishers.values():
            self.node.destroy_publisher(publisher)
        self._publishers.clear()


# -- the cells ---------------------------------------------------------------------------------------


class Cells:
    """All nodes, in four cells of one domain, since some topics exclude each other."""

    def __init__(self, groups: ExitStack, folder: Path) -> None:
        self.folder = folder
        cells = ("whole", "joints", "driver", "legs")
        self.groups = {cell: groups.enter_context(ProcessGroup(folder / cell)) for cell in cells}
        self.tools = Tools()
        self.nodes: list[str] = []
        self.job = quick_cone_file(folder)
        cell = folder / "cell.yaml"
        cell.write_text("calibration_matrix: [[2, 0.1, 0], [0, -3, 0], [0, 0.2, 4]]\nrange: 1000\n", encoding="utf-8")
        whole = {"machine": "isf_sim", "planner": "isf_planner", "springback": "isf_springback"}
        whole |= {"force_ctrl": "isf_force_ctrl", "executive": "isf_cell", "recorder": "isf_analysis"}
        whole |= {"dashboard": "isf_dashboard", "cell_state_publisher": "isf_description"}
        options: dict[str, dict[str, object]] = {
            "recorder": {"output": str(folder / "bag"), "ring": 20.0},
            "dashboard": {"port": 0},
            "executive": {"set_up": str(folder / "set_up.yaml")},
        }
        for name in ("machine", "springback", "force_ctrl"):
            options[name] = {"state_folder": str(folder / f"{name}_states")}
        for name, package in whole.items():
            self.start("whole", package, name, **options.get(name, {}))
        by_clock = {"lockstep": False}
        self.start("joints", "isf_sim", "machine", **by_clock, follow="joints", job=str(self.job))
        self.start("joints", "isf_force_ctrl", "force_ctrl", **by_clock, output="joint_trajectory")
        self.start("driver", "isf_driver_example", "driver", name="machine", level=4, rate=100.0)
        self.start("driver", "isf_force_ctrl", "force_ctrl", **by_clock, output="twist")
        self.start("legs", "isf_sim", "machine", job=str(self.legged()), raw_cells=True)
        for tool, source in ((1, {"rig": "torrao2013"}), (2, {"file": str(cell)})):
            topics = [f"{topic}:=tool_{tool}/{topic}" for topic in ("raw", "raw_cells", "wrench")]
            self.start(
                "legs", "isf_load_cell", "load_cell", name=f"load_cell_{tool}", remap=topics, tool=tool, **source
            )

    def start(
        self, cell: str, package: str, program: str, name: str = "", remap: list[str] | None = None, **options: object
    ) -> None:
        rules = [f"__ns:=/{cell}", "/clock:=clock", *(remap or [])]
        if package != "isf_driver_example":
            options = {"autostart": True, **options}
        self.groups[cell].start(package, program, options, name=name, remap=rules)
        self.nodes.append(f"/{cell}/{name or program}")

    def legged(self) -> Path:
        """A job of one tool, on legs and on three cells."""
        job = yaml.safe_load(self.job.read_text(encoding="utf-8"))
        del job["tool_2"]
        job |= {"process": "SPIF", "rig": "torrao2013", "control": {"rate": "250 Hz"}}
        path = self.folder / "legged.yaml"
        path.write_text(yaml.safe_dump(job), encoding="utf-8")
        return path

    def relative(self, name: str) -> str:
        """As nodes.md names it: below the cell, ``/clock`` for a clock of its own; without numbers of load cells."""
        below = re.sub(r"^/(whole|joints|driver|legs)/", "", name)
        below = re.sub(r"^load_cell_\d/", "load_cell/", below)
        below = re.sub(r"^tool_\d/raw", "tool_k/raw", below)  # one tool of each kind is here
        return "/clock" if below == "clock" else below

    def is_standard(self, name: str) -> bool:
        node, _, last = name.rpartition("/")
        return node == "/tools" or (node in self.nodes and last in {*OF_EVERY_NODE, "transition_event"})

    def own(self, listed: dict[str, str]) -> dict[str, str]:
        """What nodes.md has to name, of what is in the graph."""
        mine = {name: kind for name, kind in listed.items() if not self.is_standard(name)}
        return {self.relative(name): re.sub("/(msg|srv|action)/", "/", kind) for name, kind in mine.items()}

    def published(self) -> set[str]:
        return {name for name in self.tools.topics() if self.publishers(name)}

    def publishers(self, name: str) -> list[Any]:
        infos = self.tools.node.get_publishers_info_by_topic(name)
        return [info for info in infos if info.node_name != "tools"]

    def subscribed(self) -> set[str]:
        """By nodes other than the recorder, which takes whatever may come."""
        others, infos = ("tools", "recorder"), self.tools.node.get_subscriptions_info_by_topic
        return {name for name in self.tools.topics() if any(info.node_name not in others for info in infos(name))}

    def all_live(self) -> None:
        """And none has told of a fault of its own."""
        for cell, group in self.groups.items():
            assert [(cell, node.name, node.end) for node in group.dead()] == []
            for node in group.nodes:
                text = node.log.read_text(encoding="utf-8")
                assert not re.findall(r".*INTERNAL.*|Traceback.*", text), (cell, node.name)


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cells]:
    folder = tmp_path_factory.mktemp("cells")
    rclpy.init()
    with ExitStack() as groups:
        found = Cells(groups, folder)
        tools = found.tools
        try:
            for name in found.nodes:
                tools.wait(lambda: f"{name}/get_state" in tools.services(), name)  # noqa: B023
            for transition in (1, 3):  # the driver does not bring itself up
                tools.call("/driver/machine/change_state", f"{{transition: {{id: {transition}}}}}")
            for name in found.nodes:
                tools.wait(lambda: tools.call(f"{name}/get_state").current_state.label == "active", name)  # noqa: B023
            yield found
        finally:
            tools.close()
    rclpy.try_shutdown()


def acceptable(answer: Any) -> bool:
    """A success, or a code of the page with a text."""
    if hasattr(answer, "code"):
        return (answer.code == 0 and not answer.message) or (answer.code in CODES and bool(answer.message))
    if hasattr(answer, "message"):  # of std_srvs
        code = re.match(r"\[(\d+) [A-Z_]+\] .", answer.message)
        return bool(answer.success) or (code is not None and int(code[1]) in CODES)
    return True


def test_the_graph_is_that_of_the_page(cells: Cells) -> None:
    tools = cells.tools
    of_page = {name: kind for name, (kind, _) in SERVICES.items()}
    tools.wait(lambda: set(cells.own(tools.services())) >= set(of_page), cells.own(tools.services()))
    assert cells.own(tools.services()) == of_page
    assert cells.own(tools.actions()) == {name: kind for name, (kind, _) in ACTIONS.items()}
    used = cells.published() | cells.subscribed()
    topics = {name: kind for name, kind in tools.topics().items() if name in used}
    assert cells.own(topics) == {name: kind for name, (kind, _) in TOPICS.items()}
    for name in cells.nodes:
        of_node = {service.rpartition("/")[2] for service in tools.services() if service.startswith(f"{name}/")}
        assert of_node >= OF_EVERY_NODE, name


def test_what_is_latched_by_the_page_is_latched(cells: Cells) -> None:
    told = {}
    for name in cells.published():
        (_, delivery) = TOPICS.get(cells.relative(name), ("", ""))
        told[name] = delivery
        for info in cells.publishers(name):
            profile = info.qos_profile
            latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            if delivery and name not in ("/rosout", "/tf", "/tf_static"):
                assert latched == delivery.startswith(("LATCHED", "CHANGES")), name
                best = profile.reliability == ReliabilityPolicy.BEST_EFFORT
                assert best == delivery.startswith(("SENSOR", "best effort")), name
    assert sum(bool(delivery) for delivery in told.values()) > 40


def test_a_service_that_is_asked_nothing_sensible_answers(cells: Cells) -> None:
    tools, wrong = cells.tools, {}
    for name in sorted(tools.services()):
        answer = tools.call(name)
        if not acceptable(answer):
            wrong[name] = answer
    assert wrong == {}
    cells.all_live()


def test_a_goal_that_says_nothing_is_refused(cells: Cells) -> None:
    tools, wrong = cells.tools, {}
    assert len(tools.actions()) > 10
    for name in sorted(tools.actions()):
        answer = tools.send_goal(name)
        if answer.accepted and not (answer.result.code in CODES and answer.result.message):
            wrong[name] = answer
    assert wrong == {}
    cells.all_live()


def test_empty_messages_on_every_topic_end_no_node(cells: Cells) -> None:
    tools = cells.tools
    heard = cells.subscribed()  # the recorder has what is in its bag
    assert {cells.relative(name) for name in heard} > {"tool_1/wrench", "contour/corrected", "jog", "tool_k/raw"}
    try:
        for name in sorted(heard):
            tools.publish(name)
        for name in cells.nodes:
            assert tools.call(f"{name}/list_parameters").result.names
    finally:
        tools.stop_publishing()
    cells.all_live()


def test_all_is_used_as_the_page_says(cells: Cells) -> None:
    """A part with its hold, and all that can be asked for before, in and after it."""
    tools = cells.tools
    for name in sorted(cells.published()):
        tools.echo(name)
    job_text = quick_cone("method: analytic\n  lift_every: 2").text
    job_text = job_text.replace("path:\n", "path:\n  hold_after: [1, 2]\n")
    assert "hold_after" in job_text
    job = yaml.safe_dump({"job_text": job_text, "base_folder": str(EXAMPLES)})
    tpif = yaml.safe_dump({"job_text": (EXAMPLES / "tpif_cone.yaml").read_text(), "base_folder": str(EXAMPLES)})
    used: set[str] = set()

    def ask(name: str, text: str = "{}") -> Any:
        answer = tools.call(f"/whole/{name}", text)
        used.add(name)
        assert getattr(answer, "code", 0) == 0, (name, answer)
        assert getattr(answer, "success", True), (name, answer)
        return answer

    def act(name: str, text: str = "{}", during: Callable[[Any], bool] | None = None) -> Any:
        answer = tools.send_goal(f"/whole/{name}", text, during)
        used.add(name)
        assert (answer.status, answer.result.code) == (GoalStatus.STATUS_SUCCEEDED, 0), (name, answer)
        assert answer.feedback, name
        return answer.result

    def cancelled(name: str, text: str = "{}") -> None:
        answer = tools.cancel(f"/whole/{name}", text)
        assert answer.status == GoalStatus.STATUS_CANCELED, (name, answer)
        assert answer.result.code in CODES, (name, answer)

    held: set[int] = set()

    def hold(feedback: Any) -> bool:
        """After the first and the second contour, the tools on the sheet."""
        if feedback.phase == "paused" and feedback.index not in held:
            held.add(feedback.index)
            if len(held) == 1:
                assert act("lift_tool", "{speed: 0.005, zero_force: 5.0, max_lift: 0.012}").force > 0.0
                ask("machine/save", "{path: held}")
                ask("force_ctrl/save", "{path: held}")
                ask("executive/go_on")
            else:
                ask("executive/pause", "{data: false}")
        return len(held) == 2

    # the machine
    ask("machine/reset", job + "new_blank: true\n")
    ask("machine/tare")
    assert ask("machine/scan", "{clamped: true}").points > 1000
    ask("machine/save", "{path: blank}")
    ask("machine/load", "{path: blank}")

    # a part
    plan = act("plan_part", job)
    assert ask("planner/get_contour", f"{{plan_id: {plan.plan_id}, index: 1}}").contour.index == 1
    formed = act("form_part", job + "support_force: 300.0\n", hold)  # so much that it sheds chips: an event
    assert formed.contours == plan.count == 3
    ask("springback/save", "{path: formed}")
    ask("springback/load", "{path: formed}")
    ask("recorder/snapshot")

    # between parts, with force control armed by hand of a tool
    for name in ("machine", "force_ctrl"):
        for transition in (1, 3):
            tools.call(f"/whole/{name}/change_state", f"{{transition: {{id: {transition}}}}}")
    ask("machine/load", "{path: held}")
    arm = f"plan_id: {plan.plan_id}\nfirst_index: 1\ncount: 3\nsupport_force: .nan\n"
    ask("force_ctrl/load", "{path: held}")
    ask("force_ctrl/arm", job + arm)
    act("move_aside")
    act("identify", "{property: 3, tool: 1, repeats: 1, max_force: 200.0}")
    cancelled("identify", "{property: 3, tool: 1, repeats: 9, max_force: 200.0}")
    ask("force_ctrl/stop")
    ask("machine/stop", "{reason: enough}")
    ask("force_ctrl/arm")

    # by hand, with a blank holder
    ask("executive/set_mode", tpif + "mode: 1\nnew_blank: true\n")
    act("move_to", "{tool: 1, position: {x: 0.01, z: 0.09}, speed: 0.03}")
    cancelled("move_to", "{tool: 1, position: {x: -0.05, z: 0.09}, speed: 0.005}")
    ask("executive/zero", "{system: 55, tool: 1}")
    ask("executive/set_mode", "{mode: 3}")
    program = "G21 G90 G54\nG0 X20 Y0 Z5\nG1 Z-1 F600\nG2 X20 Y0 I-20 J0\nG0 Z20\nM30\n"
    assert ask("executive/check_program", yaml.safe_dump({"text": program})).report
    ask("executive/set_mode", "{mode: 0}")

    # by the clock: trajectories of joints, and twists for a driver
    for cell in ("joints", "driver"):
        for service in ("machine/stop", "machine/reset", "machine/tare"):
            assert tools.call(f"/{cell}/{service}").code == 0, (cell, service)
        states = tools.heard[f"/{cell}/machine/state"]
        told = len(states)
        tools.wait(lambda: sum(state.tared for state in states[told:]) >= 3, cell)  # noqa: B023
        assert tools.call(f"/{cell}/force_ctrl/arm", job + "by_hand: true\nsupport_force: .nan\n").code == 0
        moved = tools.send_goal(f"/{cell}/move_to", "{tool: 1, position: {x: 0.005, z: 0.09}, speed: 0.03}")
        assert (moved.result.code, bool(moved.feedback)) == (0, True)
        assert tools.call(f"/{cell}/force_ctrl/arm").code == 0
    assert tools.call("/driver/machine/scan", "{clamped: true}").points > 0

    # what people and hardware publish
    by_us = ["/whole/joy", "/joints/machine/joint_commands"]
    for name in by_us:
        tools.publish(name)
    tools.publish("/whole/jog", "{client: test, tool: 1}")

    # raw readings, of a driver for one cell; the machine of the other one waits, and reads the same for ever
    def read_and(service: str) -> bool:
        for _ in range(5):
            force = f"{{x: 0.{next(number)}, y: 0.2, z: 0.3}}"
            tools.publish("/legs/tool_2/raw", f"{{header: {{frame_id: cell}}, wrench: {{force: {force}}}}}")
        return bool(tools.call(f"/legs/load_cell_2/{service}").success)

    number = itertools.count(1)
    for service in ("tare", "check_drift"):
        tools.wait(lambda: read_and(service), service)  # noqa: B023
        assert acceptable(tools.call(f"/legs/load_cell_1/{service}"))
        used.add(f"load_cell/{service}")
    tools.stop_publishing()

    assert (used & set(SERVICES), used & set(ACTIONS)) == (set(SERVICES), set(ACTIONS))
    came = lambda: {cells.relative(name) for name, messages in tools.heard.items() if messages}  # noqa: E731
    # the test's own; and what a sheet that yields publishes, in test_machine_node.py: none of these machines has one
    of_page = set(TOPICS) - {"joy", "machine/joint_commands", "tool_k/raw", "machine/released_part"}
    tools.wait(lambda: came() >= of_page, sorted(of_page - came()))
    for name in cells.nodes:
        assert tools.call(f"{name}/get_state").current_state.id, name
    cells.all_live()
