"""Rounds that are played late, with all that has come for them, and the copy of the belief that is moved on to now.

Data types: `GossipHistory` hold the gossips and the beliefs of the last ticks. An `OpenRound` is a round that is still to be played.

Rules. Gossips that come L ticks late are heard by a round that is played L ticks late. The gossip of tick k then states the claim and the
particles of tick k - 1 - L, because no later round has been played. So the round of tick k begins with particles that are L ticks older
than usual. Its agent moves them over these ticks itself, with the scans of all agents: it *replays* them around its cell. All agents replay
the same particles with the same scans, so their cells still tile one density. A scan that came too late for its own round is part of the
replays of later ones that reach back so far. Agents that have not heard the same gossips differ where these matter, as in any round.

Estimates and commands are those of now. A copy of the belief is moved on to the newest tick, with the own scans and those that have come
early. It is thrown away: the next round begins with what gossips state.
"""

from collections import deque
from typing import Any, NamedTuple

import msgspec
import numpy as np

from agents.config import AgentConfig
from agents.gossip.inbox import WINDOW_TICKS
from agents.gossip.message_builders import without_scan
from agents.gossip.table import AnnouncedSensor, GossipTable, gossip_table
from agents.round import AgentContext, RoundCell, RoundResult, result_of
from agents.tracking.claims import NO_CLAIM
from agents.tracking.step import Step
from agents.tracking.tracker import Belief, KnownDiagram, RegionInput
from protocol.keys import order
from protocol.messages import Gossip

BLUR = 0.6  # per s: what the peak of a target that is out of view loses to its surroundings
BESIDE = 0.6  # expected targets: least mass of a peak near another one, for a low threshold would count the rest of a target as another
NOBODY = ""  # owns no cell: a replay corrects a density and draws no particles from it


class OpenRound(NamedTuple):
    """A round that is still to be played."""

    gossip: Gossip  # the own one
    belief: Belief  # when that was published


class GossipHistory:
    """The gossips that an agent has accepted, its own ones and its beliefs, of the last ticks."""

    def __init__(self, context: AgentContext, most: int) -> None:
        """`most`: ticks that a round is played late at most."""
        self._context, self._most = context, most
        self.ticks_ahead = most + WINDOW_TICKS  # after the newest belief, of which gossips are kept
        self._most_ticks = 2 * (2 * most + WINDOW_TICKS)  # twice what `keep` leaves
        self._said: dict[int, dict[str, tuple[Gossip, AnnouncedSensor]]] = {}
        self._blurred: dict[int, AgentConfig] = {}  # by ticks
        self._beliefs: deque[Belief] = deque(maxlen=most + 2 if most else 0)  # none where no round is played late

    def put(self, gossip: Gossip, announced: AnnouncedSensor) -> bool:
        """Keep a gossip; whether it is the first one of its sender and tick.

        An agent without observations plays no round, and so drops no gossip: of too many ticks the one goes in which the fewest have
        spoken, of several the one that came first. A peer can make up ticks, so those of own gossips go last.
        """
        heard = self._said.setdefault(gossip.tick, {})
        if len(self._said) > self._most_ticks:
            others = [tick for tick in self._said if tick != gossip.tick]
            del self._said[min(others, key=lambda tick: (self._context.name in self._said[tick], len(self._said[tick])))]
        is_new = gossip.sender not in heard
        heard[gossip.sender] = gossip, announced
        return is_new

    def keep(self, belief: Belief) -> None:
        """Keep the belief after a round. Drop the gossips that no round will need, and those of a tick so far ahead that it is wrong."""
        self._beliefs.append(belief)
        oldest = belief.tick - self._most  # the next replay begins with the belief of this tick
        newest = belief.tick + self.ticks_ahead
        self._said = {tick: heard for tick, heard in self._said.items() if oldest <= tick <= newest}

    def has_later(self, name: str, tick: int) -> bool:
        """Whether a gossip of a peer has come that is later than `tick`."""
        return any(name in heard for other, heard in self._said.items() if other > tick)

    def stated_lags(self, tick: int) -> list[int]:
        """The lags in ticks that the newest gossips state, the own one included. Gossips older than the longest lag do not count."""
        newest: dict[str, int] = {}
        for old in sorted(self._said):
            if old >= tick - self._most:
                newest |= {name: gossip.lag for name, (gossip, _) in self._said[old].items()}
        return list(newest.values())

    def table(self, own: Gossip) -> GossipTable:
        """The gossips of a tick that have come so far, the own one included."""
        heard = {**self._said.get(own.tick, {}), own.sender: (own, self._context.announced)}
        said = [heard[name] for name in sorted(heard, key=order)]
        return gossip_table([gossip for gossip, _ in said], [sensor for _, sensor in said], self._context.config)

    def own_gossip(self, tick: int, nearest: Gossip) -> Gossip:
        """The own gossip of a tick; without one the `nearest` without its scan, for the agent was skipped by that tick."""
        found = self._said.get(tick, {}).get(self._context.name)
        return found[0] if found else without_scan(nearest, tick)

    def at_or_before(self, tick: int, newest: Belief) -> Belief:
        """The newest belief that is not later than a tick, `newest` included; the oldest that is kept if all are later."""
        if newest.tick <= tick:
            return newest
        earlier = [belief for belief in self._beliefs if belief.tick <= tick]
        return earlier[-1] if earlier else self._beliefs[0] if self._beliefs else newest

    def blurred_config(self, ticks: int) -> AgentConfig:
        """The settings to read targets off a density that was moved on by some ticks: a target is spread wider, and its peak is lower.

        What is left when one expected target has been taken from a peak must be more than that to be another one.
        """
        ticks = min(ticks, self.ticks_ahead + 1)  # a jump over more ticks blurs no more
        if ticks not in self._blurred:
            config, now = self._context.config, self._context.config.extraction
            share = 1.0 / (1.0 + BLUR * ticks * config.run.dt)
            extraction = msgspec.structs.replace(now, threshold=share * now.threshold, beside=max(now.beside, BESIDE))
            self._blurred[ticks] = msgspec.structs.replace(config, extraction=extraction)
        return self._blurred[ticks]


def replayed_density(
    recent: GossipHistory, context: AgentContext, opened: OpenRound, most: int, table: GossipTable, polygon: np.ndarray
) -> Any:
    """The density that counts one tick before a round, around its cell `polygon` (K, 2) m; `table`: the gossips of the round.

    It begins with the oldest claims that the gossips state, at most `most` ticks old, and is moved on with the scans of the ticks since.
    So the agent that is furthest behind sets the length of all replays around it.
    """
    tick, config, tracker = table.gossips[0].tick, context.config, context.tracker
    oldest = tick - 1 - most
    ticks = [gossip.claim_tick for gossip in table.gossips if gossip.behind and gossip.claim_names and gossip.claim_tick >= oldest]
    belief = recent.at_or_before(min(ticks, default=opened.belief.tick), opened.belief)
    if belief.tick < oldest:
        belief = tracker.catch_up(belief, Step(config, oldest + 1))  # the step that follows the belief of `oldest`
    density = tracker.merge(belief, table, Step(config, belief.tick + 1))
    for past in range(belief.tick + 1, tick):
        own = recent.own_gossip(past, opened.gossip)
        margin = _influence(Step(config, tick)) * (tick - past)
        belief = advance(context, density, recent.table(own), rectangle_around(polygon, opened.gossip, context.sensor.reach, margin))
        density = tracker.merge(belief, table, Step(config, past + 1))
    return density


def advance(context: AgentContext, density: Any, table: GossipTable, polygon: np.ndarray) -> Belief:
    """The belief of nobody at the tick of `table`, from the density one tick before: corrected around a polygon, elsewhere only moved."""
    step = Step(context.config, table.gossips[0].tick)
    row = table.names.index(context.name)
    region = RegionInput(NOBODY, row, context.sensor, table.gossips[row].pose, polygon, NO_CLAIM)
    update = context.tracker.update(density, table, [region], step)[0]
    return context.tracker.belief_after(density, region, update, KnownDiagram(0, frozenset(), None, np.inf), step)


def _influence(step: Step) -> float:
    """How far away a particle may be in m that matters for a place one tick later."""
    return step.config.filter.halo + step.max_displacement


def rectangle_around(polygon: np.ndarray, own: Gossip, reach: float, margin: float) -> np.ndarray:
    """The rectangle (4, 2) around a cell and the footprint of a sensor, `margin` m wider, counter-clockwise."""
    (x, y, _), half = own.pose, reach + margin
    low, high = np.array([x - half, y - half]), np.array([x + half, y + half])
    if len(polygon):
        low, high = np.minimum(low, polygon.min(axis=0) - margin), np.maximum(high, polygon.max(axis=0) + margin)
    (west, south), (east, north) = low.tolist(), high.tolist()
    return np.array([[west, south], [east, south], [east, north], [west, north]])


def look_ahead(recent: GossipHistory, context: AgentContext, last: RoundResult, own: Gossip, ticks: int) -> RoundResult:
    """The result of a round as it stands at the tick of `own`, a later one: all of now but the belief, which stays that of the round.

    Of a longer pause only the last ticks are replayed, as many as gossips are kept of; before them the belief only moves.
    `ticks`: how long the command is to last; 0: there is none.
    """
    round_cell, tracker, config = last.round_cell, context.tracker, context.config
    if round_cell is None:  # no round has been played yet
        return last
    region, belief = round_cell.region, tracker.catch_up(last.belief, Step(config, own.tick - recent.ticks_ahead))
    for tick in range(belief.tick + 1, own.tick):
        table = recent.table(recent.own_gossip(tick, own))
        density = tracker.merge(belief, table, Step(config, tick))
        margin = _influence(Step(config, tick)) * (own.tick - tick)
        belief = advance(context, density, table, rectangle_around(region.polygon, own, context.sensor.reach, margin))
    table, step = recent.table(own), Step(recent.blurred_config(own.tick - last.belief.tick), own.tick)
    density = tracker.merge(belief, table, step)
    now = region._replace(row=table.names.index(context.name), pose=own.pose)
    update = tracker.update(density, table, [now], step)[0]
    return result_of(context, own, RoundCell(now, round_cell.generator_table), update, table, density, last.belief, ticks)
