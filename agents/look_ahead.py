"""Rounds that are played late, with all that has come for them, and the copy of the belief that is moved on to now.

Rules. Gossips that come L ticks late are heard by a round that is played L ticks late. The gossip of tick k then states the claim and the
particles of tick k - 1 - L, because no later round has been played. So the round of tick k begins with particles that are L ticks older
than usual. Its agent moves them over these ticks itself, with the scans of all agents: it *replays* them around its cell. All agents replay
the same particles with the same scans, so their cells still tile one density. A scan that came too late for its own round is part of the
replays of later ones that reach back so far. Agents that have not heard the same gossips differ where these matter, as in any round.

Estimates and commands are those of now. A copy of the belief is moved on to the newest tick, with the own scans and those that have come
early. It is thrown away: the next round begins with what gossips state.
"""

from typing import Any

import numpy as np

from agents.gossip.table import GossipTable
from agents.gossip_history import GossipHistory, OpenRound
from agents.round import AgentContext, RoundCell, RoundResult, result_of
from agents.tracking.claims import NO_CLAIM
from agents.tracking.step import Step
from agents.tracking.tracker import Belief, KnownDiagram, RegionInput
from protocol.messages import Gossip

NOBODY = ""  # owns no cell: a replay corrects a density and draws no particles from it


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
