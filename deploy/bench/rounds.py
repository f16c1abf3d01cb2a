"""`covey bench round`: what one agent's round costs, by phase, on inputs captured from a simulation."""

import statistics
from collections.abc import Callable
from functools import partial
from typing import Any

from agents.backend import Backend
from agents.gossip.round_inbox import RoundInbox
from agents.gossip.table import announced_sensor, forget, gossip_table, newest_table
from agents.membership.peer_table import PeerTable
from agents.round import run_round
from agents.tracking.belief import ParticlePhd
from deploy.bench.capture import Captured, capture, cold
from deploy.bench.timing import BenchRow, cpu_seconds, median_seconds
from deploy.scenario import Scenario, resolve
from protocol import codec
from protocol.keys import message_key
from protocol.messages import Gossip
from protocol.node import Batch

Work = Callable[[Captured], None]
Call = tuple[Callable[..., Any], tuple[Any, ...]]
TEAMS = {"5": 50, "20E+4H": 30, "A12,C48,D36": 100}  # 48, 24 and 96 agents, and their targets
BATCHES = 6  # how often each round is played
SIDES = {"A12,C48,D36": 141.4}  # m: the density of team 5


def scenario_of(team: str, seconds: float = 60.0) -> Scenario:
    """The scenario in which a team's rounds are captured."""
    side = SIDES.get(team, 100.0)
    options = {"team.composition": team, "targets.count": TEAMS[team], "run.dt": 0.5, "run.seconds": seconds}
    return resolve("efficacy", {**options, "arena.width": side, "arena.height": side})


def recorded(backend: Backend, calls: dict[str, list[Call]]) -> Backend:
    """The backend, noting every call and its arguments."""

    def noting(name: str, function: Any) -> Callable[..., Any]:
        def noted(*arguments: Any) -> Any:
            calls.setdefault(name, []).append((function, arguments))
            return function(*arguments)

        return noted

    functions: dict[str, Any] = {name: noting(name, function) for name, function in backend._asdict().items() if callable(function)}
    return backend._replace(**functions)


def read(captured: Captured) -> None:
    """Put what was said side by side."""
    me, peers = captured.me, captured.peer_table.peers
    forget()
    own = announced_sensor(me.name, me.sensor, me.config.detection.clutter)
    sensors = [own, *(peers[name].announced for name in captured.heard)]
    _ = gossip_table([captured.mine, *captured.heard.values()], sensors, me.config).table  # type: ignore[arg-type]


def per_round(rounds: list[Captured], work: Work, first: Work | None = None) -> float:
    """CPU time of `work` on one round, s: the least of several times, because others disturb it, and of that the median over the rounds.

    The gossips are decoded just before, as in a process of its own; what `first` does is not counted either.
    """
    found = []
    for captured in rounds:
        times = []
        for _ in range(BATCHES):
            [fresh] = cold([captured])
            if first is not None:
                first(fresh)
            times.append(cpu_seconds(partial(work, fresh)))
        found.append(min(times))
    return statistics.median(found)


def whole(captured: Captured) -> None:
    """One round, from the accepted gossips to the outcome."""
    forget()
    run_round(*captured)


def lay(captured: Captured) -> None:
    """Play a round, so that all gossips lie side by side, and forget that anybody has asked for what they share."""
    whole(captured)
    newest_table().batched = None


def again(captured: Captured) -> None:
    """The round of one for whom another has laid the gossips side by side, as in a simulation."""
    run_round(*captured)


def phases(rounds: list[Captured]) -> BenchRow:
    """Milliseconds of CPU per round of one agent, in the median over rounds: the whole, its phases, and what lies between them."""
    play_it = per_round(rounds, whole)
    shared = per_round(rounds, again, first=lay)
    parts = {"read": per_round(rounds, read)}
    calls: dict[str, list[Call]] = {}
    for captured in cold(rounds):
        read(captured)
        noted = recorded(captured.me.backend, calls)
        run_round(*captured._replace(me=captured.me._replace(backend=noted, tracker=ParticlePhd(noted))))
    for name in ("cut_cells", "update_regions"):
        parts[name] = statistics.median(median_seconds(partial(function, *arguments)) for function, arguments in calls[name])
    row = {"play": play_it, "play, shared": shared, **parts, "between": play_it - sum(parts.values())}
    return {name: 1000.0 * seconds for name, seconds in row.items()}


def wire(rounds: list[Captured]) -> BenchRow:
    """Milliseconds of CPU per round for encoding the own gossip and decoding those that were heard."""
    run = rounds[0].me.config.run.name
    mine = [captured.mine for captured in rounds]
    payloads = [(message_key(run, gossip), codec.encode(gossip)) for gossip in mine]
    encode = median_seconds(lambda: [codec.encode(gossip) for gossip in mine]) / len(mine)
    decode = median_seconds(lambda: [codec.decode(key, payload) for key, payload in payloads]) / len(mine)
    heard = sum(len(captured.heard) for captured in rounds) / len(rounds)
    return {"heard": heard, "encode": 1000.0 * encode, "decode": 1000.0 * decode * heard, "decode one": 1000.0 * decode}


def from_bytes(rounds: list[Captured]) -> BenchRow:
    """Milliseconds of CPU per round from the bytes of what was heard to the outcome, and how much of it goes by until all is accepted."""
    whole_times, accepted = [], []
    for captured in cold(rounds):
        run, peer_table = captured.me.config.run.name, captured.peer_table
        arrivals = [(message_key(run, gossip), codec.encode(gossip)) for gossip in captured.heard.values()]

        def accept(arrivals: list[tuple[str, bytes]] = arrivals, peer_table: PeerTable = peer_table) -> None:
            forget()
            peer_table.inbox = RoundInbox()
            reasons = peer_table.accept(Batch([one for one in codec.decode_all(arrivals) if isinstance(one, Gossip)]))
            if any(reasons):
                raise RuntimeError(f"a captured gossip was refused: {', '.join(sorted(set(reasons)))}")

        def round_of(captured: Captured = captured, accept: Callable[[], None] = accept) -> None:
            accept()
            run_round(*captured._replace(heard=captured.peer_table.fresh(captured.mine.tick)))

        accepted.append(median_seconds(accept))
        whole_times.append(median_seconds(round_of))
    return {"bytes to accepted": 1000.0 * statistics.median(accepted), "bytes to outcome": 1000.0 * statistics.median(whole_times)}


def measure(teams: list[str] | None = None, tick: int = 60) -> list[BenchRow]:
    """One row per team: ms of CPU per agent-round, each gossip decoded and predicted by the agent itself."""
    rows = []
    for team in teams or list(TEAMS):
        rounds = capture(scenario_of(team), tick)
        rows.append({"team": team, "agents": len(rounds), **wire(rounds), **phases(rounds), **from_bytes(rounds)})
    return rows


def codec_rows() -> list[BenchRow]:
    """Microseconds of CPU per message of a real round, and its bytes."""
    rounds = capture(scenario_of("5"), 60)
    run = rounds[0].me.config.run.name
    gossips = [captured.mine for captured in rounds]
    payloads = [(message_key(run, gossip), codec.encode(gossip)) for gossip in gossips]
    scale = 1.0e6 / len(gossips)
    return [
        {
            "message": "gossip",
            "bytes, mean": sum(len(payload) for _, payload in payloads) / len(payloads),
            "bytes, most": max(len(payload) for _, payload in payloads),
            "encode, us": scale * median_seconds(lambda: [codec.encode(gossip) for gossip in gossips]),
            "decode and check, us": scale * median_seconds(lambda: [codec.decode(key, payload) for key, payload in payloads]),
        }
    ]
