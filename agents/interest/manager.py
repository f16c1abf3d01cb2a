"""The lookout of an agent that hears its neighbours only: it says beacons, hears those of the tiles around it, and chooses.

What it hears and keeps is that of the tiles around it, in a swarm of any size. Before its first word an agent asks who is there, waits,
chooses, and waits until the others have had the time to listen; afterwards it chooses anew every `CHOICE` s, and at once when somebody
comes or goes or it has no cell.
"""

import math
from functools import partial

import msgspec
import numpy as np

from agents.config import AgentConfig
from agents.coverage.capacity import place
from agents.interest.position_table import EAST, RADIUS, beacon_row
from agents.interest.selection import CHOICE, JUMP, MARGIN, PERIOD, Choice, Ground
from agents.interest.tiles import Bounds, Box, Rectangle, Tiling, bounds_of
from agents.membership.half_open_link import HalfOpenLinkDetector, LagDetector
from agents.membership.peer import Peer
from agents.membership.peer_table import PeerTable
from agents.round import HORIZON, AgentContext, RoundResult
from protocol.agreement import whole
from protocol.geometry import distances
from protocol.keys import beacons_in, one_of, order, tokens_of
from protocol.messages import Beacon, Gossip, Observation
from protocol.node import Effect, Reopen, Subscribe, Unsubscribe
from protocol.sensing import Pose, WedgeSensor
from protocol.streams import key

SETTLE = 0.25  # s for a question to reach everybody and for the answers to come back
ROUNDS = 4  # so many times SETTLE pass before anybody's first word, so that those who must ask again have subscribed as well
FIRST = 2  # tiles on every side of the own one that a newcomer listens to
BUSY, LONGEST = 8.0, 5.0  # an agent that is called late waits so many times longer, at most so many s: the others are late as well
UNHEARD = 3  # times that who hears nobody asks again before it looks farther: the others may only be late
MOST_QUESTIONS = 8  # in a row: then an agent speaks, certified or not
AHEAD = 16.0  # m: a tile is listened to before it is needed, so that a period of beacons has been heard when it is
FORGOTTEN = 2.5  # periods after which somebody whose beacons no longer come is gone
LOOK = 4  # ticks between two looks at whom the neighbours name
LINGER = 4.0  # s of world time for which the gossip of somebody who is needed no longer still comes: half of all are needed again by then


class InterestManager:
    """Whom one agent hears."""

    def __init__(self, me: AgentContext, neighbours: PeerTable, incarnation: int) -> None:
        config = me.config
        self._settings = whole(neighbours.settings)
        self.settled = False  # the first choice has been made and the others have had the time to make theirs
        self.due: float | None = None  # when to call `on_time`
        self._me, self._neighbours, self._incarnation = me, neighbours, incarnation
        self._tiling = Tiling(config.timing.tile, config.arena)
        self._ground = Ground(me.arena, bounds_of(me.sensor, me.facts), JUMP + config.limits.speed * config.run.dt, distances)
        self._period, self._between, self._linger = (max(1, round(seconds / config.run.dt)) for seconds in (PERIOD, CHOICE, LINGER))
        self._phase = key("beacon", me.name) % self._period
        self._young = 0  # until this tick the others may not know me
        self._questions, self._speak_at = 0, 0.0
        self._asking = True
        self._said: Beacon | None = None
        self._box: Box | None = None  # the tiles that I listen to
        self.known: Rectangle | None = None  # where I know of everybody; None: nowhere yet
        self._soon_known: list[tuple[int, Rectangle]] = []  # from which tick on I know what as well, the earliest and smallest first
        self._chosen_at = 0
        self._hearsay, self._behind = HalfOpenLinkDetector(me.name, 2 * self._period), LagDetector()
        self._heard: dict[str, Peer] = {}  # the circle of the last choice
        self._lingering: dict[str, int] = {}  # whose gossip comes all the same, and in which tick it was needed last
        self._watched: set[str] = set()  # whose token I see
        self._forgotten = False  # somebody has been forgotten since I looked at the tokens

    # ------------------------------------------------------------------ before the first word

    def arrive(self, observation: Observation, outcome: RoundResult, now: float) -> list[Effect]:
        """I have been told where I am: ask who else is there."""
        if self._box is not None:
            return []
        if observation.tick > 0:
            self._young = observation.tick + 2 * self._period
        self.due, self._speak_at = now + SETTLE, now + ROUNDS * SETTLE
        tile = self._tiling.tile(observation.pose[:2])
        self._said = question(self._mine(observation, outcome), tile)  # who has as many tiles around its own will hear it
        return [*self._listen(self._tiling.around(tile, FIRST)), self._said]

    def on_time(self, observation: Observation, outcome: RoundResult, now: float) -> list[Effect]:
        """The answers should have come."""
        overdue = now - self.due if self.due is not None else 0.0
        settle = min(max(SETTLE, BUSY * overdue), LONGEST)
        self.due = now + settle
        mine = self._mine(observation, outcome)
        if self._asking and not self._neighbours.peers and self._questions < UNHEARD:
            self._questions += 1
            return [self._said] if self._said else []
        if self._asking:
            choice, table = self._judge(self._first_cell(mine, observation.tick), mine, observation.tick)
            soon = choice.needed.wider(AHEAD)
            box = self._tiling.box(soon)
            self.known = self._tiling.ground(self._box) if self._box else None
            self._questions += 1
            if not self._tiling.ground(self._box or box).holds(soon) and self._questions < MOST_QUESTIONS:
                return self._listen(_union(box, self._box), mine)
            self._asking = False
            self.due = max(now + settle, self._speak_at)
            return self._choose(choice, table, observation.tick)
        late, self._questions = self._neighbours.changed and self._questions < MOST_QUESTIONS, self._questions + 1
        if late:  # somebody has been heard only now: both need time to listen
            return self.look(self._first_cell(mine, observation.tick), mine, observation.tick)
        self.settled, self.due = True, None
        return []

    def surroundings(self, observation: Observation, outcome: RoundResult) -> Rectangle:
        """Where I need particles in my first round: around the cell that I expect and around my sensor."""
        cell = self._first_cell(self._mine(observation, outcome), observation.tick)
        x, y = np.vstack([cell, [observation.pose[:2]]]).T
        around = Rectangle(float(x.min()), float(y.min()), float(x.max()), float(y.max()))
        return around.wider(max(HORIZON, self._me.sensor.reach + MARGIN))

    def _first_cell(self, mine: Beacon, tick: int) -> np.ndarray:
        generators = self._table(mine, tick)[:, EAST : RADIUS + 1]
        points, radii = generators[:, :2].copy(), generators[:, 2].copy()
        return self._me.backend.cut_cells([len(radii) - 1], points, radii, self._me.arena)[0].polygon

    def _table(self, mine: Beacon, tick: int) -> np.ndarray:
        """Where everybody is (`PositionTable.table`), after those who are not there any more have been forgotten."""
        self._forgotten |= self._neighbours.forget(tick - math.ceil(FORGOTTEN * self._period))
        return self._neighbours.places.table(beacon_row(mine, self._me.config.partition.kind))

    # ------------------------------------------------------------------ beacons

    def hear(self, beacon: Beacon) -> bool:
        """A beacon of somebody else; whether it should be answered.

        Who is new to me may not know me either, unless I have only now come to hear him: he has just entered the ground that I know, or
        I have just begun to listen where he is.
        """
        new = self._neighbours.see(beacon)
        self._learn_bounds(beacon)
        return beacon.asks or (new and self._knew(beacon.position))

    def hear_all(self, beacons: list[Beacon]) -> bool:
        """Beacons of others; whether one of them should be answered."""
        asking, widest = False, self._ground.bounds
        for beacon in beacons:
            if beacon.widest_reach > widest.reach or beacon.widest_offset > widest.offset or beacon.widest_radius > widest.radius:
                self._learn_bounds(beacon)
        for beacon in self._neighbours.places.see_all(beacons, self._neighbours.peers):
            asking |= self.hear(beacon)
        return asking

    def answer(self) -> list[Effect]:
        """My newest beacon again."""
        if self._said is None:
            return []
        reach, offset, radius = self._ground.bounds
        return [msgspec.structs.replace(self._said, asks=False, widest_reach=reach, widest_offset=offset, widest_radius=radius)]

    def _learn_bounds(self, beacon: Beacon) -> None:
        """Whoever is wider than all of whom I knew matters from farther away; my next beacon passes that on."""
        told = Bounds(beacon.widest_reach, beacon.widest_offset, beacon.widest_radius)
        peer = self._neighbours.peers.get(beacon.sender)
        if peer is not None and peer.announced is not None:
            told = told.wider(bounds_of(*peer.announced[:2]))
        known = self._ground.bounds
        wider = known.wider(told)
        if wider is not known:
            self._ground = self._ground._replace(bounds=wider)
            self._neighbours.changed = True

    def after(self, gossip: Gossip, outcome: RoundResult) -> list[Effect]:
        """At the end of a round: what follows from where I shall be in the next tick."""
        next_one = self._beacon(gossip.tick + 1, moved(gossip.pose, outcome.command, self._me.config), outcome.power_radius)
        return [*self._foretell(next_one, gossip), *self._turn(next_one, gossip, outcome)]

    def _foretell(self, next_one: Beacon, gossip: Gossip) -> list[Effect]:
        """A beacon, now and then and when that is a jump."""
        if (gossip.tick + self._phase) % self._period and self._said and not _jumped(self._said, next_one):
            return []
        self._said = next_one
        return [next_one]

    def _mine(self, observation: Observation, outcome: RoundResult) -> Beacon:
        return self._beacon(observation.tick, observation.pose, outcome.power_radius)

    def _beacon(self, tick: int, pose: Pose, radius: float) -> Beacon:
        me = self._me
        column, row = self._tiling.tile(pose[:2])
        widest = self._ground.bounds
        return Beacon(
            sender=me.name,
            incarnation=self._incarnation,
            tick=tick,
            position=pose[:2],
            cod=place(me.facts.cod_offset, pose),
            power_radius=radius,
            reach=me.sensor.reach,
            column=column,
            row=row,
            sensor_class=me.sensor_class,
            sensor=me.sensor if isinstance(me.sensor, WedgeSensor) else None,
            settings=self._settings,
            widest_reach=widest.reach,
            widest_offset=widest.offset,
            widest_radius=widest.radius,
        )

    # ------------------------------------------------------------------ the choice

    def _turn(self, next_one: Beacon, gossip: Gossip, outcome: RoundResult) -> list[Effect]:
        """Choose anew if it is time to."""
        if gossip.tick < self._chosen_at + self._between and not self._neighbours.changed and len(outcome.cell):
            return []  # an empty cell may appear anywhere, so who has none looks in every round
        return self.look(outcome.cell, next_one, gossip.tick)

    def doubt(self, tick: int, now: float) -> list[Effect]:
        """At the end of a round: a new session, if the others have long been naming somebody here of whom I hear nothing."""
        if tick % LOOK:
            return []
        gossips = [gossip for gossip in self._neighbours.inbox.last.values() if gossip.tick == tick]
        unheard = self._hearsay.listen(gossips, self._neighbours.acquainted, self._overlooks, tick, now)
        return [Reopen(f"the others hear {unheard}, {self._me.name} does not")] if unheard else []

    def lag(self, tick: int, now: float) -> list[Effect]:
        """A neighbour is more than one tick ahead of mine, `tick`: a new session, if that has been so for long."""
        return [Reopen(f"the others go on, and {self._me.name} has heard of no tick after {tick}")] if self._behind.hear(tick, now) else []

    def _knew(self, place: tuple[float, float]) -> bool:
        """Whether I should have heard of everybody who was lately there."""
        return self.known is None or self.known.holds(Rectangle(*place, *place).wider(self._ground.drift))

    def _overlooks(self, place: tuple[float, float]) -> bool:
        return self.known is not None and self.known.holds(Rectangle(*place, *place).wider(self._ground.bounds.offset + JUMP))

    def look(self, cell: np.ndarray, mine: Beacon, tick: int) -> list[Effect]:
        """Choose whom to hear from now on, and listen to the tiles that this takes; the subscriptions that follow."""
        choice, table = self._judge(cell, mine, tick)
        return [*self._choose(choice, table, tick), *self._look_around(choice.needed, tick)]

    def _judge(self, cell: np.ndarray, mine: Beacon, tick: int) -> tuple[Choice, np.ndarray]:
        me, table = self._me, self._table(mine, tick)
        return me.backend.select_peers(cell, mine.position, me.sensor.reach, me.config.filter.halo, table, self._ground), table

    def _choose(self, choice: Choice, table: np.ndarray, tick: int) -> list[Effect]:
        self._neighbours.choose(table, choice)
        while self._soon_known and tick >= self._soon_known[0][0]:
            self.known = self._soon_known.pop(0)[1]
        self._neighbours.certified = self.known is not None and self.known.holds(choice.needed) and tick >= self._young
        before, self._chosen_at = self._chosen_at, tick
        return self._subscribe(before, tick)

    def _subscribe(self, before: int, tick: int) -> list[Effect]:
        """Hear those who count now, and who counted a moment ago; see the tokens of all who have counted since I know of them.

        To listen and to cease costs more than to hear a few gossips too many, and who goes often comes back; a token costs nothing.
        """
        interest_set, run, lingering = self._neighbours.interest_set, self._me.config.run.name, self._lingering
        added: set[str] = set()
        seen: set[str] = set()
        if interest_set is not self._heard:
            needed, heard = interest_set.keys(), self._heard.keys()
            added, seen = needed - heard - lingering.keys(), needed - self._watched
            for name in lingering.keys() & needed:
                del lingering[name]
            lingering.update(dict.fromkeys(heard - needed, before))
            self._heard = interest_set
        dropped = [name for name, last in lingering.items() if last + self._linger <= tick]
        for name in dropped:
            del lingering[name]
        unseen = self._watched - self._neighbours.peers.keys() if self._forgotten else set()
        self._forgotten = False
        if not (added or dropped or seen or unseen):
            return []
        self._watched = (self._watched | seen) - unseen
        gossip, token = partial(one_of, run, "gossip"), partial(tokens_of, run, "agent")
        return [
            *(Subscribe(gossip(name)) for name in sorted(added, key=order)),
            *(Subscribe(token(name)) for name in sorted(seen, key=order)),
            *(Unsubscribe(gossip(name)) for name in sorted(dropped, key=order)),
            *(Unsubscribe(token(name)) for name in sorted(unseen, key=order)),
        ]

    def _look_around(self, needed: Rectangle, tick: int) -> list[Effect]:
        """Follow the needed ground with the tiles; a tile is given up when it lies a whole side outside."""
        assert self._box is not None
        soon = self._tiling.box(needed.wider(AHEAD))
        if soon == self._box:
            return []
        late = self._tiling.box(needed.wider(self._tiling.side))
        box = _union(soon, _common(self._box, late))
        if box == self._box:
            return []
        grown, ground = _union(box, self._box) != self._box, self._tiling.ground(box)
        self.known = _overlap(self.known, ground) if self.known else None
        self._soon_known = [(since, _overlap(some, ground)) for since, some in self._soon_known]
        if grown:  # the beacons of all newcomers will have come by then
            self._soon_known.append((tick + self._period + 1, ground))
        return self._listen(box)

    def _listen(self, box: Box, asking: Beacon | None = None) -> list[Effect]:
        """Listen to the tiles of a box and to no others; ask those who live in the new ones, if there is something to ask with."""
        run = self._me.config.run.name
        old = set(self._box.tiles()) if self._box else set()
        added, dropped = sorted(set(box.tiles()) - old), sorted(old - set(box.tiles()))
        self._box = box
        effects: list[Effect] = [Subscribe(beacons_in(run, tile)) for tile in added]
        effects += [Unsubscribe(beacons_in(run, tile)) for tile in dropped]
        if asking is None:
            return effects
        self._said = asking
        return [*effects, *(question(asking, tile) for tile in added)]


def question(mine: Beacon, tile: tuple[int, int]) -> Beacon:
    """A beacon said in another tile, to be answered."""
    return msgspec.structs.replace(mine, column=tile[0], row=tile[1], asks=True)


def moved(pose: Pose, command: tuple[tuple[float, float], float], config: AgentConfig) -> Pose:
    """The pose after a tick of a command, which is within the limits of the body."""
    (vx, vy), turn = command
    return pose[0] + vx * config.run.dt, pose[1] + vy * config.run.dt, pose[2] + turn * config.run.dt


def _jumped(old: Beacon, new: Beacon) -> bool:
    """Whether a beacon says something else than an older one."""
    apart = max(math.dist(old.position, new.position), math.dist(old.cod, new.cod), abs(old.power_radius - new.power_radius))
    wider = new.widest_reach > old.widest_reach or new.widest_offset > old.widest_offset or new.widest_radius > old.widest_radius
    return apart > JUMP or wider


def _union(one: Box, other: Box | None) -> Box:
    """The smallest block that holds both."""
    if other is None:
        return one
    return Box(min(one.west, other.west), min(one.south, other.south), max(one.east, other.east), max(one.north, other.north))


def _common(one: Box, other: Box) -> Box:
    """What lies in both blocks; at least a tile of the second."""
    west, south = max(one.west, other.west), max(one.south, other.south)
    return Box(west, south, max(west, min(one.east, other.east)), max(south, min(one.north, other.north)))


def _overlap(one: Rectangle, other: Rectangle) -> Rectangle:
    return Rectangle(max(one.west, other.west), max(one.south, other.south), min(one.east, other.east), min(one.north, other.north))
