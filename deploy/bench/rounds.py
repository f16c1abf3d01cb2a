"""`covey bench round`: what one agent's round costs, by phase, on inputs captured from a simulation."""

from collections.abc import Callable
from typing import Any

from agents.arithmetic import Arithmetic
from agents.round import play
from agents.words import forget, learn
from deploy.bench.capture import Captured, capture, cold
from deploy.bench.timing import Row, median_seconds
from deploy.scenario import Scenario, resolve
from protocol import codec
from protocol.keys import message_key

Call = tuple[Callable[..., Any], tuple[Any, ...]]
TEAMS = {"5": 50, "20E+4H": 30, "A12,C48,D36": 100}  # 48, 24 and 96 agents, and their targets
SIDES = {"A12,C48,D36": 141.4}  # m: the density of team 5


def scenario_of(team: str, seconds: float = 60.0) -> Scenario:
    """The scenario in which a team's rounds are captured."""
    side = SIDES.get(team, 100.0)
    options = {"team.composition": team, "targets.count": TEAMS[team], "run.dt": 0.5, "run.seconds": seconds}
    return resolve("efficacy", {**options, "arena.width": side, "arena.height": side})


def recorded(arithmetic: Arithmetic, calls: dict[str, list[Call]]) -> Arithmetic:
    """The arithmetic, noting every call and its arguments."""

    def noting(name: str, function: Any) -> Callable[..., Any]:
        def noted(*arguments: Any) -> Any:
            calls.setdefault(name, []).append((function, arguments))
            return function(*arguments)

        return noted

    return Arithmetic(*(noting(name, function) for name, function in zip(Arithmetic._fields, arithmetic)))


def replay(captured: Captured) -> None:
    """One round, from the arrival of the decoded gossips to the outcome."""
    me, peers = captured.me, captured.neighbours.peers
    forget()
    learn(captured.mine, me.sensor, me.config)
    for name, gossip in captured.heard.items():
        outfit = peers[name].outfit
        assert outfit is not None
        learn(gossip, outfit.sensor, me.config)
    play(*captured)


def phases(rounds: list[Captured]) -> Row:
    """Milliseconds of CPU per round of one agent: the whole, its parts, and what lies between them."""
    calls: dict[str, list[Call]] = {}
    for captured in cold(rounds):
        me = captured.me._replace(arithmetic=recorded(captured.me.arithmetic, calls))
        replay(captured._replace(me=me))
    fresh: list[Captured] = []

    def ready() -> None:
        fresh[:] = cold(rounds)

    def all_rounds() -> None:
        for captured in fresh:
            replay(captured)

    number = 1000.0 / len(rounds)
    parts = {name: number * median_seconds(lambda called=called: [f(*a) for f, a in called]) for name, called in calls.items()}  # type: ignore[misc]
    whole = number * median_seconds(all_rounds, ready=ready)
    shared = number * median_seconds(all_rounds)
    return {"play": whole, "play, shared": shared, **parts, "between": whole - sum(parts.values())}


def wire(rounds: list[Captured]) -> Row:
    """Milliseconds of CPU per round for encoding the own gossip and decoding those that were heard."""
    run = rounds[0].me.config.run.name
    mine = [captured.mine for captured in rounds]
    payloads = [(message_key(run, gossip), codec.encode(gossip)) for gossip in mine]
    encode = median_seconds(lambda: [codec.encode(gossip) for gossip in mine]) / len(mine)
    decode = median_seconds(lambda: [codec.decode(key, payload) for key, payload in payloads]) / len(mine)
    heard = sum(len(captured.heard) for captured in rounds) / len(rounds)
    return {"heard": heard, "encode": 1000.0 * encode, "decode": 1000.0 * decode * heard, "decode one": 1000.0 * decode}


def measure(teams: list[str] | None = None, tick: int = 60) -> list[Row]:
    """One row per team: ms of CPU per agent-round, each gossip decoded and predicted by the agent itself."""
    rows = []
    for team in teams or list(TEAMS):
        rounds = capture(scenario_of(team), tick)
        rows.append({"team": team, "agents": len(rounds), **wire(rounds), **phases(rounds)})
    return rows


def codec_rows() -> list[Row]:
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
