"""Publishers and subscriptions that the middleware keeps apart since one asks for more than the other offers."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from isf_core.errors import ErrorCode, IsfError
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible

UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""What the middleware says of a node whose topics it has heard of before its name."""


def profile_of(profile: QoSProfile | int) -> QoSProfile:
    """The profile itself, or the default one of a queue of that depth."""
    return QoSProfile(depth=profile) if isinstance(profile, int) else profile


def best_effort(profile: QoSProfile) -> QoSProfile | None:
    """``profile`` as a subscription that takes best-effort publishers, too; None where a lost message would be missed:
    of a latched topic no other comes."""
    if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL or profile.reliability != ReliabilityPolicy.RELIABLE:
        return None
    return QoSProfile(
        history=profile.history,
        depth=profile.depth,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.VOLATILE,
    )


def taken_best_effort(node: Node, topic: str, profile: QoSProfile) -> IsfError:
    """What to say of a topic that is subscribed to best effort, since it is published so."""
    return IsfError(
        ErrorCode.QOS_INCOMPATIBLE,
        f"{_names(_publishers(node, topic, profile))} publishes best effort; its messages are used, but a lost one is "
        "not sent again",
        where=f"topic {topic}",
        advice="publish with reliability reliable, if the driver can",
    )


def nothing_comes(node: Node, topic: str, profile: QoSProfile, policy: str = "QoS") -> IsfError:
    """What to say of a subscription that receives nothing; ``policy`` is the one that differs, as far as is known."""
    apart = _publishers(node, topic, profile)
    return IsfError(
        ErrorCode.QOS_INCOMPATIBLE,
        f"nothing is received from {_names(apart)}: {_differing([(info, profile) for info in apart.values()], policy)}",
        where=f"topic {topic}",
        advice=f"publish with {_delivery(profile)}",
    )


def nothing_goes(node: Node, topic: str, profile: QoSProfile, policy: str = "QoS") -> IsfError:
    """What to say of a publisher that somebody listens to in vain; ``policy`` as of :func:`nothing_comes`."""
    infos = node.get_subscriptions_info_by_topic(node.resolve_topic_name(topic))
    apart = {info.node_name: info.qos_profile for info in infos if _apart(profile, info.qos_profile)}
    return IsfError(
        ErrorCode.QOS_INCOMPATIBLE,
        f"{_names(apart)} receives nothing: {_differing([(profile, info) for info in apart.values()], policy)}",
        where=f"topic {topic}",
        advice=f"subscribe with {_delivery(profile)}",
    )


def names_known(node: Node, topic: str) -> bool:
    """True once the middleware knows the nodes of all publishers and subscriptions of ``topic``."""
    name = node.resolve_topic_name(topic)
    ends = [*node.get_publishers_info_by_topic(name), *node.get_subscriptions_info_by_topic(name)]
    return all(end.node_name != UNKNOWN for end in ends)


def kept_apart(node: Node, topic: str, profile: QoSProfile) -> bool:
    """True when a subscription with ``profile`` receives nothing from somebody who publishes ``topic``."""
    return bool(_publishers(node, topic, profile))


def _publishers(node: Node, topic: str, profile: QoSProfile) -> dict[str, Any]:
    """Profiles of the publishers that a subscription with ``profile`` receives nothing from, by node."""
    infos = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    return {info.node_name: info.qos_profile for info in infos if _apart(info.qos_profile, profile)}


def _apart(offered: Any, asked: Any) -> bool:
    return bool(qos_check_compatible(offered, asked)[0] == QoSCompatibility.ERROR)


def _differing(pairs: list[tuple[Any, Any]], policy: str) -> str:
    """Policies of which less is offered than required, by the (offered, required) profiles; else says ``policy``."""
    found = {}
    for offered, required in pairs:
        if (offered.reliability, required.reliability) == (ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE):
            found["reliability"] = "reliability best_effort is offered, reliable is required"
        if (offered.durability, required.durability) == (DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL):
            found["durability"] = "durability volatile is offered, transient_local is required"
    return "; ".join(found.values()) or f"less {policy} is offered than is required"


def _delivery(profile: QoSProfile) -> str:
    return f"reliability {profile.reliability.name.lower()}, durability {profile.durability.name.lower()}"


def _names(nodes: Iterable[str]) -> str:
    known = sorted({f"node '{name}'" for name in nodes if name != UNKNOWN})
    return " and ".join(known) or "a node"
