"""The table of peers: what they announced, their newest gossips, and which gossips a round waits for.

A *peer* is another agent that is known. The loss of its liveliness token suggests its death and does not prove it. When the token
vanishes, the peer stops being a generator at once. A later gossip of the same incarnation brings it back, if it cannot have been sent
before. A peer that falls silent with its token up stays a generator for the rounds of `ticks_of_silence` after the newest tick of which a
generator of it is known. Its own gossips state these, and so do the claims of its neighbours, with their ages. Only rounds in which this
agent was served in time count.

A peer whose token vanishes while this agent is late is suspected. It counts as gone at the end of the next round in which at least twice
as many peers are heard as are suspected. A suspicion about most peers is one about this agent: those are treated as silent ones.

With interest "all" every peer is in the interest set. With "neighbours" beacons make peers known, and the agent subscribes to the gossips
of those that it selects.
"""

import contextlib
import math
from collections import OrderedDict, deque
from collections.abc import Iterable
from itertools import compress
from operator import attrgetter

import numpy as np

from agents.config import AgentConfig
from agents.gossip.round_inbox import RoundInbox
from agents.interest.position_table import GENERATOR_X, NO_GENERATORS, POWER_RADIUS, PositionTable, UnsubscribedGenerators
from agents.interest.selection import Selection
from agents.membership.agreement import SettingsAgreement
from agents.membership.peer import Peer, all_acceptable, announced_by, plausible, same_sensor, with_newer_generator, with_peer
from protocol.fields import MAX_NAMES
from protocol.messages import Beacon, Gossip, Hello
from protocol.node import Batch
from protocol.settings import BadSetting

COMPLETE_SET_HASH = 1  # in place of a hash: agents that hear neighbours and have complete interest sets cut parts of one diagram
ACCEPTED = ""
OWN, UNASKED = "own", "unasked"  # reasons without a fault of the sender
UNKNOWN_SENSOR = "unknown_sensor"
MOST_STRANGERS = 256  # kept where the tokens of all peers are seen: more than may greet before their tokens are seen


class PeerTable:
    """The peers of one agent."""

    def __init__(self, config: AgentConfig, name: str) -> None:
        self.neighbours_only = config.timing.interest == "neighbours"
        self.peers: dict[str, Peer] = {}  # in the order of names; neighbours only: in any order
        self.interest_set: dict[str, Peer] = {}  # the peers whose gossips are received: all; neighbours only: chosen ones
        self.unsubscribed = NO_GENERATORS  # neighbours only: the generators of all other peers
        self.positions = PositionTable(config)  # neighbours only: the positions of live peers, by the newest message of each
        self.certified = False  # neighbours only: no unknown peer can own a point that matters in this round
        self.known_names = frozenset[str]()  # neighbours only: the peers with a known position at the last selection
        self._version = -1  # neighbours only: of the positions at that selection
        self.selection_outdated = False  # neighbours only: a peer has come or gone since the last selection
        self._config, self._silence_limit = config, config.ticks_of_silence  # rounds
        self._measures_pace = config.run.clock == "realtime"
        self._responsive_rounds: deque[int] = deque(maxlen=self._silence_limit)  # ticks of the last ones
        self._name, self._others = name, dict.fromkeys(config.others(name))
        self.agreement = SettingsAgreement(name, config.shared_settings())
        self.inbox = RoundInbox()
        self.pace = 1  # this agent shares the ticks that this number divides
        self._paces: dict[str, int] = {}  # of the peers that need a slower pace than every tick
        self.silence_timeouts = 0  # how often a peer with its token up has been silent for too long
        self._last_known: dict[str, Gossip] = {}  # of silent peers, with the newest generators that gossips and claims have stated
        self._all_acceptable = False  # all in the interest set are alive and missed no round, and nothing has changed since
        self._strangers = OrderedDict[str, None]()  # the peers that are not in the roster and have no token, the longest silent first
        self._most_strangers = MAX_NAMES if self.neighbours_only else MOST_STRANGERS  # the first sees few tokens

    def alive(self, name: str, incarnation: int) -> None:
        """A token appeared."""
        peer = self._get_or_create(name, incarnation, token=True)
        if peer:
            self.selection_outdated |= peer.is_gone
            self._strangers.pop(name, None)
            peer.token, peer.refused_until, peer.suspected = True, None, False
            if peer.beacon is not None:
                self.positions.note(peer, peer.beacon)

    def gone(self, name: str, incarnation: int, tick: int, *, suspected: bool = False) -> bool:
        """A token vanished in the round `tick`; whether the peer counts as gone now.

        `suspected`: this agent was late, and may itself be the reason.
        """
        peer = self.peers.get(name)
        if peer is None or peer.incarnation != incarnation:
            return False
        peer.token, peer.suspected, self._all_acceptable = False, suspected, False
        if not suspected:
            self._mark_left(peer, tick)
        self._limit_strangers(name)
        return not suspected

    def _mark_left(self, peer: Peer, tick: int) -> None:
        """A peer has left in the round `tick`. It may have been a tick ahead, and gossips of it may still be on their way."""
        peer.refused_until, peer.suspected = tick + 1, False
        self.positions.remove(peer.name)
        self.selection_outdated = True

    def _settle_suspicions(self, tick: int, heard: int) -> None:
        """Count the suspected peers as gone, unless they are too many beside the number of peers `heard` in this round."""
        suspected = [peer for peer in self.peers.values() if peer.suspected]
        if 2 * len(suspected) <= heard:
            for peer in suspected:
                self._mark_left(peer, tick)

    def take_hello(self, hello: Hello) -> str | None:
        """Take a Hello and remember the announced sensor. Returns the reason for refusing it; None: it is accepted.

        The newest Hello counts: it repairs an earlier one with wrong bits.
        """
        peer = self._get_or_create(hello.sender, hello.incarnation)
        if peer is None:
            return "incarnation"
        differs = self.agreement.differing(hello)
        if differs != peer.differs and peer.announced is None:  # a peer that agreed before stays: one wrong bit must not silence it
            self._exclude(peer, differs)
        if differs:
            return "settings"
        try:
            peer.announced = announced_by(hello, self._config)
        except BadSetting as error:
            peer.unusable = str(error)
            return "sensor"
        return None

    def _exclude(self, peer: Peer, differs: tuple[str, ...]) -> None:
        """Remove a peer from the interest set when some settings differ; add it again when none does."""
        peer.differs, self.selection_outdated = differs, True
        others = {name: other for name, other in self.interest_set.items() if name != peer.name}
        self.interest_set = others if differs else with_peer(others, peer)
        self._all_acceptable = False

    def accept(self, batch: Batch, start: int = 0, tick: int = -1, awaited: set[str] | None = None) -> list[str]:
        """Judge gossips that arrived together, from the row `start` on, and keep those that are accepted.

        A gossip of `tick` removes its sender from `awaited`. The row that empties `awaited` completes the round and is the last that is
        judged. Returns for each judged row the reason for refusing it; empty: it is accepted.

        * own: it is a gossip of this agent;
        * unasked: the sender is not in the interest set;
        * incarnation: another incarnation is alive, or a younger one is known;
        * unknown_sensor: the sender's sensor is unknown;
        * settings: the sender's settings differ;
        * closed: a round with a gossip of this peer, of this tick or a later one, is closed;
        * dead: it was sent before the peer's token vanished;
        * implausible: the sender's sensor cannot do what it states, or its goal lies outside of the arena.
        """
        accepted, reasons, judge = list[Gossip](), list[str](), self._judge
        for gossip in batch.messages[start:]:
            reason = judge(gossip)
            reasons.append(reason)
            if reason:
                continue
            accepted.append(gossip)
            if awaited and gossip.tick == tick:
                awaited.discard(gossip.sender)
                if not awaited:
                    break
        if UNKNOWN_SENSOR in reasons:  # this may be a younger incarnation of an earlier row's sender, which counts no more
            for row, gossip in enumerate(batch.messages[start : start + len(reasons)]):
                if not reasons[row] and gossip.incarnation != self.interest_set[gossip.sender].incarnation:
                    reasons[row] = "incarnation"
                    accepted.remove(gossip)
        self.inbox.put(accepted)
        return reasons

    def _judge(self, gossip: Gossip) -> str:
        """The reason for refusing a gossip; empty: it is accepted, and the record of its sender is updated."""
        name, tick = gossip.sender, gossip.tick
        peer = self.interest_set.get(name)
        if peer is None or peer.incarnation != gossip.incarnation:
            if name == self._name:
                return OWN
            if self.neighbours_only and name not in self.interest_set:
                return UNASKED
            if name not in self.peers:
                return UNKNOWN_SENSOR
            peer = self._get_or_create(name, gossip.incarnation)
            if peer is None:
                return "incarnation"
        if peer.announced is None:
            return "settings" if peer.differs else UNKNOWN_SENSOR
        if self.inbox.is_closed(name, tick):
            return "closed"
        if peer.refused_until is not None and tick <= peer.refused_until:
            return "dead"
        if not plausible(gossip, peer.announced, self._config.arena):
            return "implausible"
        was_gone = peer.is_gone
        if peer.note_life(tick, 1, is_wrong=self.inbox.is_far_ahead(tick)):
            self.selection_outdated |= was_gone
        return ACCEPTED

    def fresh(self, tick: int) -> dict[str, Gossip]:
        """The gossips of `tick` by live peers, in the order of names."""
        gossips = self.inbox.of(tick)
        return {name: gossips[name] for name, peer in self.interest_set.items() if name in gossips and not peer.is_gone}

    def missing(self, tick: int, *, newcomer: bool = False) -> set[str]:
        """The peers whose gossip of `tick` is missing: alive, heard before, and not silent for long.

        A newcomer waits for every live peer, since it has heard none of them yet.
        """
        missing = self._missing_at_full_pace(tick, newcomer=newcomer)
        return missing - {name for name, pace in self._paces.items() if tick % pace} if self._paces else missing

    def _missing_at_full_pace(self, tick: int, *, newcomer: bool) -> set[str]:
        """The peers whose gossip of `tick` would be missing if all played every tick."""
        gossips = self.inbox.of(tick)
        if self._all_acceptable:
            return self.interest_set.keys() - gossips.keys()
        if self.neighbours_only:  # a beacon of each has come lately
            return {
                name
                for name, peer in self.interest_set.items()
                if not peer.is_gone and peer.silent_rounds < self._silence_limit and name not in gossips
            }
        limit = self._silence_limit
        others = [peer for name, peer in self.interest_set.items() if name not in gossips and (peer.token or peer.suspected)]
        return {peer.name for peer in others if (peer.silent_rounds < limit if self.inbox.knows(peer.name) else newcomer or tick == 0)}

    def generator_gossips(self, tick: int, fresh: dict[str, Gossip]) -> dict[str, Gossip]:
        """For each generator of the diagram of `tick` the gossip that states it.

        It is a fresh gossip, or the newest one of a peer that has been silent for a short time: since its newest gossip, or since the
        newest claim of another that names its generator. A peer of a slower pace may be silent for the ticks between two of its own.
        """
        limit, served = self._silence_limit, self._responsive_rounds
        oldest = served[-limit] if len(served) >= limit else -1  # the tick so many rounds ago in which this agent was served in time
        found, claimed = {}, self._newest_known(tick, fresh)
        for name in self.interest_set:
            gossip = fresh.get(name) or claimed.get(name)
            if gossip is None or gossip.listening:
                continue
            if gossip.tick >= oldest - limit * max(0, gossip.pace - self.pace):
                found[name] = gossip
        return found

    def _newest_known(self, tick: int, fresh: dict[str, Gossip]) -> dict[str, Gossip]:
        """The newest gossip of each live peer that is not `fresh`; its generator is that of the newest claim that names it, if newer."""
        live = [name for name, peer in self.interest_set.items() if not peer.is_gone and name not in fresh]
        found = {name: gossip for name in live if (gossip := self.inbox.newest(name, tick)) is not None}
        found |= {name: known for name, known in self._last_known.items() if name in found and known.tick > found[name].tick}
        newest = [fresh.get(name) or self.inbox.newest(name, tick) for name in self.interest_set] if found else []
        for claim in [gossip for gossip in newest if gossip is not None and not found.keys().isdisjoint(gossip.claim_names)]:
            for row, (name, stated) in enumerate(zip(claim.claim_names, claim.claim_ticks)):
                if name in found and stated > found[name].tick:
                    moved = with_newer_generator(found[name], stated, claim.claim[row].tolist(), self._config.partition.kind)
                    announced = self.interest_set[name].announced
                    if announced is not None and plausible(moved, announced, self._config.arena):
                        found[name] = moved
        return found

    def close(self, tick: int, *, newcomer: bool = False, responsive: bool = True) -> int:
        """Close the round `tick`: drop its gossips and count the missing peers. Returns their number.

        `responsive` false: the agent was late, and the silence of its peers in this round says nothing.
        """
        missing = self.missing(tick, newcomer=newcomer)
        if responsive:
            self._responsive_rounds.append(tick)
            self._count_silent(missing)
        if missing or not self._all_acceptable:
            self._last_known = self._newest_known(tick, self.fresh(tick))
            self._forget_silent(tick)
        complete = self.interest_set.keys() <= self.inbox.of(tick).keys()  # a gossip of who has left the set may be there as well
        if not self._all_acceptable:
            self._settle_suspicions(tick, len(self.inbox.of(tick)))
        self._all_acceptable = complete and (self._all_acceptable or all_acceptable(self.interest_set.values(), self.neighbours_only))
        for gossips in self.inbox.close(tick, self.interest_set.keys()):
            if self.neighbours_only:
                self.positions.close(gossips)
            if self._measures_pace:
                self._note_paces(gossips.values())
        return len(missing)

    def _note_paces(self, gossips: Iterable[Gossip]) -> None:
        """Remember which peers do not play every tick."""
        for gossip in gossips:
            if gossip.pace > 1:
                self._paces[gossip.sender] = gossip.pace
            elif self._paces:
                self._paces.pop(gossip.sender, None)

    def slow_paces(self) -> list[int]:
        """The paces that peers have stated last, where they do not share every tick. Those that have left or fallen silent do not count."""
        peers = [(self.interest_set.get(name), pace) for name, pace in self._paces.items()]
        return [pace for peer, pace in peers if peer is not None and not peer.is_gone and peer.silent_rounds < self._silence_limit]

    def keep_pace(self, pace: int) -> None:
        """From now on share the ticks that `pace` divides: a silence of some seconds lasts fewer rounds."""
        timing = self._config.timing
        self.pace, self._silence_limit = pace, max(timing.silent_rounds, math.ceil(self._config.ticks_of_silence / pace))
        self.positions.silence_limit = self._silence_limit

    def _count_silent(self, missing: set[str]) -> None:
        """Count a round of silence of each missing peer."""
        for name in missing:
            self.peers[name].silent_rounds += 1
            if self.peers[name].silent_rounds >= self._silence_limit:
                self.silence_timeouts += 1

    def unheard(self) -> list[str]:
        """The peers in the interest set that this agent itself has not heard for too long, in the order of names."""
        return [name for name, peer in self.interest_set.items() if peer.silent_rounds >= self._silence_limit]

    def _forget_silent(self, tick: int) -> None:
        """Neighbours only: forget the positions of silent peers that are no generators of the round after `tick`."""
        silent = [name for name in self.unheard() if name in self.positions]
        generators = self.generator_gossips(tick + 1, self.fresh(tick + 1)) if silent else {}
        for name in silent:
            if name not in generators:
                self.positions.remove(name)

    def any_missed(self) -> bool:
        """Whether some peer was silent in the last round."""
        return not self._all_acceptable and any(peer.silent_rounds for peer in self.interest_set.values())

    def is_roster_alive(self) -> bool:
        """Whether the tokens of all others of the roster are up; neighbours only: always, as no other agent is awaited."""
        others, peers = self._others, self.peers
        return self.neighbours_only or (len(peers) >= len(others) and all(name in peers and peers[name].token for name in others))

    def lacks_announcements(self) -> bool:
        """Whether the sensor of a live peer is still unknown."""
        return not self.neighbours_only and any(peer.token and peer.announced is None and not peer.differs for peer in self.peers.values())

    def take_beacon(self, beacon: Beacon) -> bool:
        """Take a beacon, which states a position.

        Returns whether the peer is new, or was gone or silent: then it may not know this agent either.
        """
        peer = known = self.peers.get(beacon.sender)
        if peer is None or peer.incarnation != beacon.incarnation:
            before = self.selection_outdated
            peer = self._get_or_create(beacon.sender, beacon.incarnation)
            if known is None:
                self.selection_outdated = before or self.positions.matters(beacon)
        is_older = peer is not None and peer.beacon is not None and beacon.tick < peer.beacon.tick
        if peer is None or (is_older and peer.beacon is not None and not self.inbox.is_far_ahead(peer.beacon.tick)):
            return False
        if is_older:  # than one of a wrong tick, far ahead
            self.positions.remove(peer.name)
        if peer.announced is None or peer.beacon is None or not same_sensor(beacon, peer.beacon):  # the newest beacon counts
            with contextlib.suppress(BadSetting):
                peer.announced = announced_by(beacon, self._config)
        tick = beacon.tick - 1  # a beacon states the position of the next tick
        is_back = peer.note_life(tick, self._silence_limit, is_wrong=self.inbox.is_far_ahead(tick))
        self.selection_outdated |= is_back
        is_first, peer.beacon = peer.beacon is None, beacon
        if is_first and peer is known:  # its token came before
            self.selection_outdated |= self.positions.matters(beacon)
        self.positions.note(peer, beacon)
        return is_back or is_first

    def forget_outside(self, since: int, until: int) -> bool:
        """Forget the peers without a beacon or gossip of the ticks from `since` to `until`; whether there was one."""
        self.positions.catch_up(self.peers, all_live=self._all_acceptable)
        old = self.positions.forget_outside(since, until)
        if len(self.peers) - len(old) > len(self.positions):
            old += [name for name, peer in self.peers.items() if name not in self.positions and (peer.refused_until or -1) < since]
        if old:
            self._remove({*old})
        return bool(old)

    def _remove(self, names: set[str]) -> None:
        """Remove the records of some peers, and all that they have said."""
        for name in names:
            self.peers.pop(name, None)
            self.positions.remove(name)
            self.inbox.forget(name)
            for table in (self._paces, self._last_known, self._strangers):
                table.pop(name, None)
        if not names.isdisjoint(self.interest_set):
            self._set_interest([peer for name, peer in self.interest_set.items() if name not in names], [])
            self.selection_outdated = True

    def note_heard(self, names: Iterable[str]) -> None:
        """Note whose beacons have come: of too many strangers the one that has been silent for longest is forgotten."""
        for name in names if self._strangers else ():
            if name in self._strangers:
                self._strangers.move_to_end(name)

    def _limit_strangers(self, name: str) -> None:
        """Note a peer without a token as a stranger, unless it is in the roster; forget the first of too many: names can be made up."""
        if name in self._others:
            return
        self._strangers[name] = None
        if len(self._strangers) > self._most_strangers:
            self._remove({next(iter(self._strangers))})

    def choose(self, table: np.ndarray, choice: Selection) -> None:
        """Make the chosen ones of N peers the interest set; a table (N or more, 6) holds their positions."""
        chosen, self.positions.needed = choice
        positions, before, number = self.positions, self.unsubscribed, len(self.positions)
        if self._version != positions.version:
            self.known_names, self._version = positions.name_set(), positions.version
            names = tuple(positions.names)
        else:
            names = before.known_names
        if names is not before.known_names or chosen.tobytes() != before.chosen.tobytes():
            selected = set(compress(names, chosen.tolist()))
            if self.interest_set.keys() != selected:
                staying = [peer for name, peer in self.interest_set.items() if name in selected]
                added = [self.peers[name] for name in selected - self.interest_set.keys()]
                self._set_interest(sorted([*staying, *added], key=attrgetter("rank")) if added else staying, added)
        generators = table[:number].compress(~chosen, axis=0)[:, GENERATOR_X : POWER_RADIUS + 1]
        self.selection_outdated, self.unsubscribed = False, UnsubscribedGenerators(generators, names, chosen)

    def _set_interest(self, interest_set: list[Peer], added: list[Peer]) -> None:
        """Make these peers the interest set, in the order of names; some of them are `added`."""
        before, self.interest_set = self.interest_set, {peer.name: peer for peer in interest_set}
        if len(interest_set) < len(before) + len(added):
            self.inbox.drop_newest_closed(before.keys() - self.interest_set.keys())
        self._all_acceptable = all_acceptable(added if self._all_acceptable else interest_set, self.neighbours_only)

    def _get_or_create(self, name: str, incarnation: int, *, token: bool = False) -> Peer | None:
        """The record of a peer's incarnation, made if it is new; None if it is not the one that counts.

        While a token is up, only another token shows a younger incarnation: one wrong bit in a message must not silence a peer. An
        incarnation that messages alone have stated gives way to that of a token.
        """
        peer = self.peers.get(name)
        if peer is not None and peer.incarnation == incarnation:
            return peer
        younger = peer is not None and incarnation > peer.incarnation and (token or not peer.token)
        guessed = peer is not None and token and not (peer.token or peer.suspected or peer.is_gone)
        if peer is None or younger or guessed:
            is_new, peer = peer is None, Peer(name, incarnation)
            self.positions.remove(name)
            if self.neighbours_only:
                self.peers[name] = peer
            else:
                self.peers = with_peer(self.peers, peer)
            self.selection_outdated = True
            if not self.neighbours_only or name in self.interest_set:
                self.interest_set, self._all_acceptable = with_peer(self.interest_set, peer), False
                self.inbox.forget(name)
            if is_new and not token:
                self._limit_strangers(name)
        return peer if incarnation == peer.incarnation else None
