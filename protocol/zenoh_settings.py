"""The Zenoh configuration of a peer, as data."""

from typing import Any

from protocol.codec import MAX_BYTES
from protocol.settings import NetworkSettings

HANDSHAKE_MS = 15000  # over UDP, where a lost packet is not sent again; its four packets may each be 3 s late


def over_udp_alone(settings: NetworkSettings) -> bool:
    """Whether all links that a session listens for or dials are UDP."""
    return all(endpoint.startswith("udp/") for endpoint in (*settings.listen, *settings.seeds))


def session_values(settings: NetworkSettings) -> dict[str, Any]:
    """Zenoh's settings for a peer, by key; docs/reference/protocol.md gives the reason for each value."""
    return {
        "mode": settings.mode,
        "listen/endpoints": settings.listen if settings.mode != "client" else (),
        "listen/exit_on_failure": True,
        "connect/endpoints": settings.seeds,
        "connect/timeout_ms": -1,  # with 0 a seed that restarts would be missed
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "scouting/gossip/autoconnect_strategy": {"peer": {"to_peer": "greater-zid", "to_router": "always"}},
        "transport/link/tx/lease": round(1000.0 * settings.lease),
        "transport/link/tx/keep_alive": 4,
        "transport/link/tx/queue/size/data": 16,  # of 64 kB: the messages of a round arrive almost at once
        "transport/link/rx/max_message_size": MAX_BYTES,
        "transport/unicast/open_timeout": HANDSHAKE_MS if over_udp_alone(settings) else 60000,
        "transport/unicast/accept_timeout": 60000,
        "transport/unicast/accept_pending": 1000,
        "transport/unicast/max_sessions": 1000,
        "transport/shared_memory/enabled": False,
    }
