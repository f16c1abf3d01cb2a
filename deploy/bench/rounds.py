"""`covey bench round`: what one agent's round costs, by phase, on inputs captured from a simulation."""

import statistics
from collections.abc import Callable
from functools import partial
from typing import Any

from agents.arithmetic import Arithmetic, in_steps
from agents.calm import CalmRound, Roll
from agents.round import play
from agents.words import forget, learn
from deploy.bench.capture import Captured, capture, cold
from deploy.bench.timing import BenchRow, cpu_seconds, median_seconds
from deploy.scenario import Scenario, resolve
from protocol import codec
from protocol.keys import message_key
from protocol.messages import Gossip

Work = Callable[[Captured], None]
Call = tuple[Callable[..., Any], tuple[Any, ...]]
Texts = tuple[str, ...]
Payloads = tuple[bytes, ...]
TEAMS = {"5": 50, "20E+4H": 30, "A12,C48,D36": 100}  # 48, 24 and 96 agents, and their targets
BATCHES = 6  # how often each round is played
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

    functions: dict[str, Any] = {name: noting(name, function) for name, function in arithmetic._asdict().items() if callable(function)}
    return arithmetic._replace(**functions)


def read(captured: Captured) -> None:
    """What an agent notes of every gossip when it arrives."""
    me, peers = captured.me, captured.neighbours.peers
    forget()
    learn(captured.mine, me.sensor, me.config)
    for name, gossip in captured.heard.items():
        outfit = peers[name].outfit
        assert outfit is not None
        learn(gossip, outfit.sensor, me.config)


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
    """One round, from the arrival of the decoded gossips to the outcome."""
    read(captured)
    play(*captured)


def again(captured: Captured) -> None:
    """A round whose gossips have already been put side by side, as in a simulation."""
    play(*captured)


def phases(rounds: list[Captured]) -> BenchRow:
    """Milliseconds of CPU per round of one agent, in the median over rounds: the whole, its phases, and what lies between them; then
    the steps of the phase `refresh` one by one, in the mean."""
    play_it = per_round(rounds, whole)
    shared = per_round(rounds, again, first=whole)
    parts = {"read": per_round(rounds, read)}
    calls: dict[str, list[Call]] = {}
    steps: dict[str, list[Call]] = {}
    for captured in cold(rounds):
        read(captured)
        arithmetic, noted = captured.me.arithmetic, recorded(captured.me.arithmetic, steps)
        play(*captured._replace(me=captured.me._replace(arithmetic=recorded(arithmetic, calls))))
        play(*captured._replace(me=captured.me._replace(arithmetic=noted._replace(refresh=partial(in_steps, noted)))))
    for name in ("cut", "refresh"):
        parts[name] = statistics.median(median_seconds(partial(function, *arguments)) for function, arguments in calls[name])
    each = {name: median_seconds(lambda called=called: [f(*a) for f, a in called]) / len(rounds) for name, called in steps.items()}  # type: ignore[misc]
    row = {"play": play_it, "play, shared": shared, **parts, "between": play_it - sum(parts.values())}
    row |= {f"step {name}": seconds for name, seconds in each.items() if name != "cut"}
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
    """Milliseconds of CPU per round from the bytes of what was heard to the outcome: read one by one, and together as in calm rounds."""
    by_themselves, together = [], []
    for captured in cold(rounds):
        reader, run = captured.me.arithmetic.reader, captured.me.config.run.name
        if reader is None:
            return {}
        roll = captured.neighbours.call_roll(reader)
        keys, payloads = zip(*[(message_key(run, gossip), codec.encode(gossip)) for gossip in captured.heard.values()])
        learn(captured.mine, captured.me.sensor, captured.me.config)

        def one_by_one(captured: Captured = captured, keys: Texts = keys, payloads: Payloads = payloads) -> None:
            found = codec.decode_all(list(zip(keys, payloads)))
            heard = {gossip.sender: gossip for gossip in found if isinstance(gossip, Gossip)}
            read(captured._replace(heard=heard))
            play(*captured._replace(heard=heard))

        def at_once(captured: Captured = captured, roll: Roll = roll, keys: Texts = keys, payloads: Payloads = payloads) -> None:
            reading = CalmRound(roll, captured.mine.tick)
            if reading.read(keys, payloads) is None:
                raise RuntimeError("a captured round is not calm")
            play(captured.me, captured.last, captured.neighbours, captured.mine, reading)

        by_themselves.append(median_seconds(one_by_one))
        together.append(median_seconds(at_once))
    return {
        "from bytes, one by one": 1000.0 * statistics.median(by_themselves),
        "from bytes, together": 1000.0 * statistics.median(together),
    }


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
