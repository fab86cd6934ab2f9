"""A parameter tool beside a part: it reads all parameters of all nodes, and sets them to what they are, in rounds."""

from __future__ import annotations

import threading
import time
from typing import Any

import rclpy
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

ANSWER = 60.0
"""s; a busy computer may keep a node from answering for so long."""


class ParameterRounds:
    """Rounds over ``nodes`` in a thread, from :meth:`start` until ``wanted`` are done or :meth:`stop` is called."""

    def __init__(self, nodes: list[str], wanted: int) -> None:
        self.nodes, self.wanted = nodes, wanted
        self.done = 0
        """Complete rounds."""
        self.parameters = 0
        """Of all nodes together."""
        self.seconds = 0.0
        self.failure = ""
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name="parameter rounds", daemon=True)

    def start(self) -> None:
        """Begin, once."""
        if not self._thread.is_alive() and self._thread.ident is None:
            self._thread.start()

    def stop(self) -> None:
        """End after the call that is under way."""
        self._ends.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        context = Context()  # of its own: the command that forms the part has the one of this process
        rclpy.init(context=context)
        node = rclpy.create_node("parameter_tool", context=context, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(node)
        begin = time.monotonic()
        try:
            kinds = {
                "list_parameters": ListParameters,
                "get_parameters": GetParameters,
                "set_parameters_atomically": SetParametersAtomically,
            }
            clients = {
                name: {service: node.create_client(kind, f"{name}/{service}") for service, kind in kinds.items()}
                for name in self.nodes
            }
            listed = self._answers({own["list_parameters"]: ListParameters.Request() for own in clients.values()})
            names = [list(answer.result.names) for answer in listed]
            self.parameters = sum(map(len, names))
            getters, setters = (
                [own[service] for own in clients.values()]
                for service in ("get_parameters", "set_parameters_atomically")
            )
            while self.done < self.wanted and not self._ends.is_set():
                asked = [GetParameters.Request(names=own) for own in names]
                values = [answer.values for answer in self._answers(dict(zip(getters, asked, strict=True)))]
                same = [
                    SetParametersAtomically.Request(
                        parameters=[Parameter(name=key, value=value) for key, value in zip(own, found, strict=True)]
                    )
                    for own, found in zip(names, values, strict=True)
                ]
                for name, answer in zip(self.nodes, self._answers(dict(zip(setters, same, strict=True))), strict=True):
                    assert answer.result.successful, f"{name}: {answer.result.reason}"
                self.done += 1
        except EndedError:
            pass
        except Exception as error:  # told where the rounds are waited for
            self.failure = f"{type(error).__name__}: {error}"
        finally:
            self.seconds = time.monotonic() - begin
            self._executor.shutdown()
            node.destroy_node()
            rclpy.shutdown(context=context)

    def _answers(self, requests: dict[Any, Any]) -> list[Any]:
        """Of clients that are asked at the same time."""
        deadline = time.monotonic() + ANSWER
        for client in requests:
            while not client.wait_for_service(0.1):
                self._go_on(deadline, client)
        sent = {client: client.call_async(request) for client, request in requests.items()}
        for client, future in sent.items():
            while not future.done():
                self._executor.spin_once(timeout_sec=0.1)
                self._go_on(deadline, client)
        return [future.result() for future in sent.values()]

    def _go_on(self, deadline: float, client: Any) -> None:
        if self._ends.is_set():
            raise EndedError
        if time.monotonic() > deadline:
            raise TimeoutError(f"{client.srv_name} does not answer")


class EndedError(Exception):
    """The part has ended first."""
