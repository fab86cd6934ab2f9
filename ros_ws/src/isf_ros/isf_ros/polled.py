"""Subscriptions that are polled: a timer takes what has arrived, and the executor does not wake for each message."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription


class Polled(CallbackGroup):
    """Keeps the executor from waking for a subscription."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


def polled_subscription(
    node: Node, kind: Any, topic: str, profile: QoSProfile, group: Polled, *, raw: bool = False
) -> Subscription:
    """A subscription of ``group``, read by :func:`taken`; ``raw``: messages as bytes."""
    return node.create_subscription(
        kind,
        topic,
        _never,
        profile,
        callback_group=group,
        event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),  # polled as the messages are
        raw=raw,
    )


def taken(subscription: Subscription) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Messages that have arrived, each with what the middleware knows of it: ``received_timestamp`` (ns since 1970),
    ``publication_sequence_number``."""
    handle, kind, raw = subscription.handle, subscription.msg_type, subscription.raw
    with handle:
        while (found := handle.take_message(kind, raw)) is not None:
            yield found


def _never(_: Any) -> None:
    """Callback of polled subscriptions; the executor never calls it."""
