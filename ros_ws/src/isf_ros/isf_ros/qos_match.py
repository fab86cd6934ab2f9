"""Publishers and subscriptions that the middleware keeps apart since one asks for more than the other offers."""

from __future__ import annotations

from typing import Any

from isf_core.errors import ErrorCode, IsfError
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible

_UNKNOWN = "_NODE_NAME_UNKNOWN_"
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
    """What to say of a topic that is taken as it is published."""
    return IsfError(
        ErrorCode.QOS_INCOMPATIBLE,
        f"{_names(_publishers(node, topic, profile))} publishes best effort; taken, but what is lost is not sent again",
        where=f"topic {topic}",
        advice="publish reliable, if the driver can",
    )


def nothing_comes(node: Node, topic: str, profile: QoSProfile, policy: str) -> IsfError:
    """What to say of a subscription that receives nothing; ``policy`` is the one that differs."""
    return IsfError(
        ErrorCode.QOS_INCOMPATIBLE,
        f"nothing comes from {_names(_publishers(node, topic, profile))}: it offers less {policy} than is asked for",
        where=f"topic {topic}",
        advice=f"publish {profile.reliability.name.lower()}, {profile.durability.name.lower()}",
    )


def nothing_goes(node: Node, topic: str, profile: QoSProfile, policy: str) -> IsfError:
    """What to say of a publisher that somebody listens to in vain."""
    infos = node.get_subscriptions_info_by_topic(node.resolve_topic_name(topic))
    apart = [i.node_name for i in infos if _apart(profile, i.qos_profile)]
    return IsfError(
        ErrorCode.QOS_INCOMPATIBLE,
        f"nothing goes to {_names(apart)}: it asks for more {policy} than is offered",
        where=f"topic {topic}",
        advice=f"subscribe {profile.reliability.name.lower()}, {profile.durability.name.lower()}",
    )


def kept_apart(node: Node, topic: str, profile: QoSProfile) -> bool:
    """True when a subscription with ``profile`` receives nothing from somebody who publishes ``topic``."""
    return bool(_publishers(node, topic, profile))


def _publishers(node: Node, topic: str, profile: QoSProfile) -> list[str]:
    infos = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    return [info.node_name for info in infos if _apart(info.qos_profile, profile)]


def _apart(offered: Any, asked: Any) -> bool:
    return bool(qos_check_compatible(offered, asked)[0] == QoSCompatibility.ERROR)


def _names(nodes: list[str]) -> str:
    known = sorted({f"node '{name}'" for name in nodes if name != _UNKNOWN})
    return " and ".join(known) or "a node"
