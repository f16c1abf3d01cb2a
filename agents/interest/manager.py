"""The interest manager of an agent that hears neighbours only: beacons, selection of peers, and subscriptions.

The agent publishes beacons, and receives those of the tiles around it. Its subscriptions and its tables are those of its surroundings, in
a swarm of any size.

A new agent first asks for beacons, waits for the answers, and selects peers. Then it waits until the others have had the time to
subscribe to it. From then on it selects peers every `SELECTION_PERIOD` s, and at the end of a tick in which a peer has come or gone or in
which it has no cell.
"""

import math
from functools import partial

import msgspec
import numpy as np

from agents.config import AgentConfig
from agents.coverage.capacity import to_world
from agents.coverage.control import ControlInput
from agents.gossip.round_inbox import WINDOW_TICKS
from agents.interest.position_table import GENERATOR_X, POWER_RADIUS, beacon_row
from agents.interest.selection import BEACON_JUMP, BEACON_PERIOD, SELECTION_MARGIN, SELECTION_PERIOD, KnownArena, Selection
from agents.interest.tiles import Bounds, Rectangle, TileBlock, Tiling
from agents.membership.half_open_link import HalfOpenLinkDetector, WorldLinkDetector
from agents.membership.peer import Peer
from agents.membership.peer_table import PeerTable
from agents.round import COPY_DISTANCE, AgentContext, RoundResult
from protocol.keys import beacons_in, one_of, order, tokens_of
from protocol.messages import Beacon, Gossip, Observation
from protocol.node import Effect, Reopen, Subscribe, Unsubscribe
from protocol.pose import clip_velocity
from protocol.random_streams import random_key
from protocol.sensing import Pose, WedgeSensor

ANSWER_SECONDS = 0.25  # s of the clock for a question to reach all agents and for the answers to come back
JOIN_PERIODS = 4  # times `ANSWER_SECONDS` before the first gossip, so that agents that must ask again have subscribed as well
FIRST_TILES = 2  # tiles on every side of the own one to which a new agent subscribes
# an agent whose own timer came late takes the others for as late: it waits this many times its delay, and at most so many s
DELAY_FACTOR, LONGEST_WAIT = 8.0, 5.0
REPEATED_QUESTIONS = 3  # times that an agent without peers asks again before it asks in more tiles: the others may only be late
MOST_QUESTIONS = 8  # in all; then an agent takes part, certified or not
SUBSCRIBE_AHEAD = 16.0  # m: a tile is subscribed to this far before it is needed, so that a period of beacons has come by then
FORGET_PERIODS = 2.5  # periods, or rounds at a slower pace, without a beacon or gossip after which a peer is forgotten
LINK_CHECK_TICKS = 4  # ticks between two checks of the peers that neighbours name
LINGER_SECONDS = 4.0  # s of world time that a subscription outlives the need of its peer: half of all are needed again


class InterestManager:
    """The subscriptions of one agent to the gossips, tokens and beacons of others."""

    def __init__(self, context: AgentContext, peer_table: PeerTable) -> None:
        config = context.config
        self._settings = peer_table.agreement.digest
        self.settled = False  # the first selection is made and the others have had the time to make theirs
        self.due: float | None = None  # when to call `on_timer`
        self._context, self._peer_table = context, peer_table
        self._tiling = Tiling(config.timing.tile, config.arena)
        drift = BEACON_JUMP + config.limits.speed * config.run.dt
        self._ground = KnownArena(context.arena, context.announced.bounds, drift)
        periods = BEACON_PERIOD, SELECTION_PERIOD, LINGER_SECONDS
        self._period, self._selection_period, self._linger = (max(1, round(seconds / config.run.dt)) for seconds in periods)
        self._phase = random_key("beacon", context.name) % self._period  # of the beacon that each period brings
        self._period_number = 0  # of the newest beacon
        self._unknown_until = 0  # until this tick the others may not know this agent
        self._questions, self._join_at = 0, 0.0
        self._asking = True
        self._last_beacon: Beacon | None = None
        self._block: TileBlock | None = None  # the tiles to which the agent subscribes
        self.known_area: Rectangle | None = None  # the rectangle in which all agents are known; None: nowhere yet
        self._known_areas_from: list[tuple[int, Rectangle]] = []  # ticks from which on larger rectangles are known, the earliest first
        self._chosen_at = 0
        self._link_detector = HalfOpenLinkDetector(context.name, 2 * self._period, config.network.lease)
        self._world_link_detector = WorldLinkDetector(config.network.lease)
        self._last_interest_set: dict[str, Peer] = {}  # the interest set of the last selection
        self._lingering: dict[str, int] = {}  # by name of a peer that is subscribed still: the tick in which it was last needed
        self._token_names: set[str] = set()  # the peers to whose tokens the agent subscribes
        self._forgotten = False  # a peer has been forgotten since the last change of tokens

    # ------------------------------------------------------------------ before the first gossip

    def start(self, observation: Observation, outcome: RoundResult, now: float) -> list[Effect]:
        """Start to join with the first observation, which states the own pose: subscribe to the tiles around it and ask for beacons."""
        if self._block is not None:
            return []
        if observation.tick > 0:
            self._unknown_until = observation.tick + 2 * self._period
        self.due, self._join_at = now + ANSWER_SECONDS, now + JOIN_PERIODS * ANSWER_SECONDS
        self._period_number = self._period_number_of(observation.tick - 1)
        tile = self._tiling.tile(observation.pose[:2])
        # the question reaches all agents that have subscribed to `FIRST_TILES` tiles around their own
        self._last_beacon = question(self._own_beacon(observation, outcome), tile)
        return [*self._subscribe_tiles(self._tiling.around(tile, FIRST_TILES)), self._last_beacon]

    def on_timer(self, observation: Observation, outcome: RoundResult, now: float) -> list[Effect]:
        """Continue to join: ask again, ask in more tiles, select peers, or become `settled`. Sets `due` for the next call."""
        overdue = now - self.due if self.due is not None else 0.0
        settle = min(max(ANSWER_SECONDS, DELAY_FACTOR * overdue), LONGEST_WAIT)
        self.due = now + settle
        own = self._own_beacon(observation, outcome)
        if self._asking and not self._peer_table.peers and self._questions < REPEATED_QUESTIONS:
            self._questions += 1
            return [self._last_beacon] if self._last_beacon else []
        if self._asking:
            choice, table = self._select(self._first_cell(own, observation.tick), own, observation.tick)
            soon = choice.needed.wider(SUBSCRIBE_AHEAD)
            block = self._tiling.block(soon)
            self.known_area = self._tiling.rectangle_of(self._block) if self._block else None
            self._questions += 1
            if not self._tiling.rectangle_of(self._block or block).contains(soon) and self._questions < MOST_QUESTIONS:
                return self._subscribe_tiles(_union(block, self._block), own)
            self._asking = False
            self.due = max(now + settle, self._join_at)
            return self._apply(choice, table, observation.tick)
        late, self._questions = self._peer_table.selection_outdated and self._questions < MOST_QUESTIONS, self._questions + 1
        if late:  # a peer has appeared only now: both need time to subscribe
            return self.reselect(self._first_cell(own, observation.tick), own, observation.tick)
        self.settled, self.due = True, None
        return []

    def surroundings(self, observation: Observation, outcome: RoundResult) -> Rectangle:
        """The rectangle that needs particles in the first round: around the expected cell and around the sensor."""
        cell = self._first_cell(self._own_beacon(observation, outcome), observation.tick)
        x, y = np.vstack([cell, [observation.pose[:2]]]).T
        around = Rectangle(float(x.min()), float(y.min()), float(x.max()), float(y.max()))
        return around.wider(max(COPY_DISTANCE, self._context.sensor.reach + SELECTION_MARGIN))

    def _first_cell(self, own: Beacon, tick: int) -> np.ndarray:
        """The cell (V, 2) m that the known generators leave to this agent."""
        generators = self._table(own, tick)[:, GENERATOR_X : POWER_RADIUS + 1]
        return self._context.backend.cut_cells([len(generators) - 1], generators, self._context.arena)[0].polygon

    def _table(self, own: Beacon, tick: int) -> np.ndarray:
        """The positions of peers (`PositionTable.table`), after those without a recent beacon are forgotten."""
        since = tick - math.ceil(FORGET_PERIODS * max(self._period, self._peer_table.pace))
        self._forgotten |= self._peer_table.forget_outside(since, tick + WINDOW_TICKS)
        return self._peer_table.positions.table(beacon_row(own, self._context.config.partition.kind))

    # ------------------------------------------------------------------ beacons

    def take_beacon(self, beacon: Beacon) -> bool:
        """Take a beacon of another agent; whether it should be answered.

        A peer that is new here may not know this agent either. The exception is a peer that is new only because this agent did not
        receive beacons there before: the peer has just entered the known rectangle, or the subscription to its tile has just begun.
        """
        new, peer = self._peer_table.take_beacon(beacon), self._peer_table.peers.get(beacon.sender)
        if peer is not None and peer.announced is not None:
            self._learn_bounds(peer.announced.bounds)
        return beacon.asks or (new and self._covers_beacons(beacon.position))

    def take_beacons(self, beacons: list[Beacon]) -> bool:
        """Take beacons of other agents; whether one of them should be answered."""
        asking, widest = False, self._ground.bounds
        self._peer_table.note_heard([beacon.sender for beacon in beacons])
        for beacon in beacons:
            asking |= beacon.asks
            if beacon.widest_reach > widest.reach or beacon.widest_offset > widest.offset or beacon.widest_radius > widest.radius:
                widest = self._learn_bounds(Bounds(beacon.widest_reach, beacon.widest_offset, beacon.widest_radius))
        for beacon in self._peer_table.positions.note_all(beacons, self._peer_table.peers):
            asking |= self.take_beacon(beacon)
        return asking

    def answer(self) -> list[Effect]:
        """The effects of an answer: the newest own beacon once more."""
        if self._last_beacon is None:
            return []
        reach, offset, radius = self._ground.bounds
        return [msgspec.structs.replace(self._last_beacon, asks=False, widest_reach=reach, widest_offset=offset, widest_radius=radius)]

    def _learn_bounds(self, others: Bounds) -> Bounds:
        """Widen the bounds of all agents by those of others, and return them; the next own beacon passes them on.

        A larger agent matters from farther away.
        """
        known = self._ground.bounds
        wider = known.wider(others)
        if wider is not known:
            self._ground = self._ground._replace(bounds=wider)
            self._peer_table.selection_outdated = True
        return wider

    def close_round(self, gossip: Gossip, outcome: RoundResult, command: ControlInput) -> list[Effect]:
        """The effects at the end of a round: a beacon and a new selection, where they are due for the pose to which the command leads."""
        next_one = self._beacon(gossip.tick + 1, pose_after(gossip.pose, command, self._context.config), outcome.power_radius)
        return [*self._beacon_if_due(next_one, gossip), *self._reselect_if_due(next_one, gossip, outcome)]

    def _beacon_if_due(self, next_one: Beacon, gossip: Gossip) -> list[Effect]:
        """A beacon once in a period, and when the position, generator or bounds have jumped."""
        number = self._period_number_of(gossip.tick)
        if number == self._period_number and self._last_beacon and not _jumped(self._last_beacon, next_one):
            return []
        self._period_number, self._last_beacon = number, next_one
        return [next_one]

    def _period_number_of(self, tick: int) -> int:
        """The number of the period in which a tick lies: no tick itself is sure to be played, at a slower pace for example."""
        return (tick + self._phase) // self._period

    def _own_beacon(self, observation: Observation, outcome: RoundResult) -> Beacon:
        """The beacon of this agent at an observed pose."""
        return self._beacon(observation.tick, observation.pose, outcome.power_radius)

    def _beacon(self, tick: int, pose: Pose, radius: float) -> Beacon:
        """The beacon of this agent at a pose, with a power radius in m."""
        context = self._context
        column, row = self._tiling.tile(pose[:2])
        widest = self._ground.bounds
        return Beacon(
            sender=context.name,
            incarnation=context.incarnation,
            tick=tick,
            position=pose[:2],
            cod=to_world(context.announced.facts.cod_offset, pose),
            power_radius=radius,
            reach=context.sensor.reach,
            column=column,
            row=row,
            sensor_class=context.sensor_class,
            sensor=context.sensor if isinstance(context.sensor, WedgeSensor) else None,
            settings=self._settings,
            widest_reach=widest.reach,
            widest_offset=widest.offset,
            widest_radius=widest.radius,
        )

    # ------------------------------------------------------------------ the selection

    def _reselect_if_due(self, next_one: Beacon, gossip: Gossip, outcome: RoundResult) -> list[Effect]:
        """Select peers anew if that is due."""
        if gossip.tick < self._chosen_at + self._selection_period and not self._peer_table.selection_outdated and len(outcome.cell):
            return []  # an empty cell may appear anywhere, so an agent without a cell selects in every round
        cell = self._first_cell(next_one, gossip.tick) if gossip.listening else outcome.cell  # a newcomer gets its first cell soon
        return self.reselect(cell, next_one, gossip.tick)

    def reopen_if_unheard(self, tick: int, now: float) -> list[Effect]:
        """A new session, if neighbours have long been naming a peer that this agent should hear and does not; else no effects."""
        if tick % LINK_CHECK_TICKS:
            return []
        gossips = [gossip for gossip in self._peer_table.inbox.newest_closed.values() if gossip.tick == tick]
        known = self._peer_table.known_names.difference(self._peer_table.unheard())  # claims may tell of the unheard
        unheard = self._link_detector.find_unheard(gossips, known, self._covers_generator, tick, now)
        return [Reopen(f"the others hear {unheard}, {self._context.name} does not")] if unheard else []

    def reopen_if_behind(self, tick: int, now: float) -> list[Effect]:
        """A neighbour is more than one tick ahead of the own `tick`: a new session, if that has lasted long; else no effects."""
        if not self._world_link_detector.should_reopen(tick, now):
            return []
        return [Reopen(f"the others go on, and {self._context.name} has heard of no tick after {tick}")]

    def _covers_beacons(self, place: tuple[float, float]) -> bool:
        """Whether all agents that were lately at a place are known; true before the first selection, when nothing is."""
        return self.known_area is None or self.known_area.contains(Rectangle(*place, *place).wider(self._ground.drift))

    def _covers_generator(self, place: tuple[float, float]) -> bool:
        """Whether all agents with a generator at a place are known."""
        around = Rectangle(*place, *place).wider(self._ground.bounds.offset + BEACON_JUMP)
        return self.known_area is not None and self.known_area.contains(around)

    def reselect(self, cell: np.ndarray, own: Beacon, tick: int) -> list[Effect]:
        """Select peers for a cell and follow it with the tiles; the subscriptions that change."""
        choice, table = self._select(cell, own, tick)
        return [*self._apply(choice, table, tick), *self._follow_tiles(choice.needed, tick)]

    def _select(self, cell: np.ndarray, own: Beacon, tick: int) -> tuple[Selection, np.ndarray]:
        """The selection for a cell, and the table of positions behind it."""
        context, table = self._context, self._table(own, tick)
        return context.backend.select_peers(
            cell, own.position, context.sensor.reach, context.config.filter.halo, table, self._ground
        ), table

    def _apply(self, choice: Selection, table: np.ndarray, tick: int) -> list[Effect]:
        """Make a selection the interest set; the subscriptions that change."""
        self._peer_table.choose(table, choice)
        while self._known_areas_from and tick >= self._known_areas_from[0][0]:
            self.known_area = self._known_areas_from.pop(0)[1]
        self._peer_table.certified = self.known_area is not None and self.known_area.contains(choice.needed) and tick >= self._unknown_until
        before, self._chosen_at = self._chosen_at, tick
        return self._subscribe_peers(before, tick)

    def _subscribe_peers(self, before: int, tick: int) -> list[Effect]:
        """Subscribe to the gossips and tokens of the interest set, and end subscriptions that are no longer needed.

        A change of subscription costs more than some gossips too many, and many peers are soon needed again. So gossips stay subscribed
        for `LINGER_SECONDS` s, and tokens until the peer is forgotten.
        """
        interest_set, run, lingering = self._peer_table.interest_set, self._context.config.run.name, self._lingering
        added: set[str] = set()
        seen: set[str] = set()
        if interest_set is not self._last_interest_set:
            needed, heard = interest_set.keys(), self._last_interest_set.keys()
            added, seen = needed - heard - lingering.keys(), needed - self._token_names
            for name in lingering.keys() & needed:
                del lingering[name]
            lingering.update(dict.fromkeys(heard - needed, before))
            self._last_interest_set = interest_set
        dropped = [name for name, last in lingering.items() if last + self._linger <= tick]
        for name in dropped:
            del lingering[name]
        unseen = self._token_names - self._peer_table.peers.keys() if self._forgotten else set()
        self._forgotten = False
        if not (added or dropped or seen or unseen):
            return []
        self._token_names = (self._token_names | seen) - unseen
        gossip, token = partial(one_of, run, "gossip"), partial(tokens_of, run, "agent")
        return [
            *(Subscribe(gossip(name)) for name in sorted(added, key=order)),
            *(Subscribe(token(name)) for name in sorted(seen, key=order)),
            *(Unsubscribe(gossip(name)) for name in sorted(dropped, key=order)),
            *(Unsubscribe(token(name)) for name in sorted(unseen, key=order)),
        ]

    def _follow_tiles(self, needed: Rectangle, tick: int) -> list[Effect]:
        """Subscribe to the tiles of the needed rectangle. A tile is dropped when it lies a whole side outside of it."""
        assert self._block is not None
        soon = self._tiling.block(needed.wider(SUBSCRIBE_AHEAD))
        if soon == self._block:
            return []
        late = self._tiling.block(needed.wider(self._tiling.side))
        block = _union(soon, _common(self._block, late))
        if block == self._block:
            return []
        grown, ground = _union(block, self._block) != self._block, self._tiling.rectangle_of(block)
        self.known_area = _overlap(self.known_area, ground) if self.known_area else None
        self._known_areas_from = [(since, _overlap(some, ground)) for since, some in self._known_areas_from]
        if grown:  # by then every agent in the new tiles has sent a beacon
            self._known_areas_from.append((tick + self._period + self._peer_table.pace, ground))
        return self._subscribe_tiles(block)

    def _subscribe_tiles(self, block: TileBlock, asking: Beacon | None = None) -> list[Effect]:
        """Subscribe to the beacons of the tiles in a block and to no others; `asking`: a beacon that asks in each new tile."""
        run = self._context.config.run.name
        old = set(self._block.tiles()) if self._block else set()
        added, dropped = sorted(set(block.tiles()) - old), sorted(old - set(block.tiles()))
        self._block = block
        effects: list[Effect] = [Subscribe(beacons_in(run, tile)) for tile in added]
        effects += [Unsubscribe(beacons_in(run, tile)) for tile in dropped]
        if asking is None:
            return effects
        self._last_beacon = asking
        return [*effects, *(question(asking, tile) for tile in added)]


def question(own: Beacon, tile: tuple[int, int]) -> Beacon:
    """A beacon published in another tile, to be answered."""
    return msgspec.structs.replace(own, column=tile[0], row=tile[1], asks=True)


def pose_after(pose: Pose, command: tuple[tuple[float, float], float], config: AgentConfig) -> Pose:
    """The pose after a tick of a command, whose velocity the body clips to its limit."""
    (vx, vy), turn = clip_velocity(command[0], config.limits.speed), command[1]
    return pose[0] + vx * config.run.dt, pose[1] + vy * config.run.dt, pose[2] + turn * config.run.dt


def _jumped(old: Beacon, new: Beacon) -> bool:
    """Whether a beacon differs from an older one by more than `BEACON_JUMP` m, or states wider bounds."""
    apart = max(math.dist(old.position, new.position), math.dist(old.cod, new.cod), abs(old.power_radius - new.power_radius))
    wider = new.widest_reach > old.widest_reach or new.widest_offset > old.widest_offset or new.widest_radius > old.widest_radius
    return apart > BEACON_JUMP or wider


def _union(one: TileBlock, other: TileBlock | None) -> TileBlock:
    """The smallest block that holds both."""
    if other is None:
        return one
    return TileBlock(min(one.west, other.west), min(one.south, other.south), max(one.east, other.east), max(one.north, other.north))


def _common(one: TileBlock, other: TileBlock) -> TileBlock:
    """The tiles that lie in both blocks; at least a tile of the second."""
    west, south = min(max(one.west, other.west), other.east), min(max(one.south, other.south), other.north)
    return TileBlock(west, south, max(west, min(one.east, other.east)), max(south, min(one.north, other.north)))


def _overlap(one: Rectangle, other: Rectangle) -> Rectangle:
    """The rectangle that lies in both."""
    return Rectangle(max(one.west, other.west), max(one.south, other.south), min(one.east, other.east), min(one.north, other.north))
