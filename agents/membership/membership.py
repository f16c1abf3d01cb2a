"""Who is there: the liveliness tokens and Hellos of others, and when this agent announces itself.

Data type: `Membership`. It keeps the peer table, the session watchdog and the schedule of the own Hellos up to date. It stops this
agent when a younger incarnation of its name appears.
"""

from collections import Counter

from agents.gossip import message_builders
from agents.membership.agreement import MOST_WARNINGS
from agents.membership.announcements import AnnouncementSchedule
from agents.membership.body_tokens import BodyTokens
from agents.membership.peer_table import PeerTable
from agents.round import AgentContext
from protocol.messages import Hello
from protocol.node import NO_EFFECTS, Alive, Batch, Effect, Gone, Reopen, Stop, Warn
from protocol.session_watchdog import SessionWatchdog

EXIT_FENCED = 3


class Membership:
    """The tokens and Hellos that concern one agent. Times are `now` of its node, s."""

    def __init__(self, context: AgentContext, peer_table: PeerTable, counters: Counter[str]) -> None:
        """`counters`: those of the agent."""
        others, neighbours_only = context.config.others(context.name), peer_table.neighbours_only
        watched = ["world"] if neighbours_only else [*others, "world"]
        self.session_watchdog = SessionWatchdog(context.name, watched, context.config.network.lease)
        self.announcements = AnnouncementSchedule(0 if neighbours_only else len(others), peer_table.is_roster_alive)
        self.world_incarnation = 0
        self._warned: set[tuple[str, int]] = set()  # names and incarnations of peers that are refused
        self._context, self._peer_table, self._counters = context, peer_table, counters
        self._bodies = BodyTokens(peer_table)

    def alive(self, event: Alive, now: float) -> list[Effect]:
        """A token has appeared; the effects are the end of this agent if the token is its successor's."""
        if event.role == "agent" and event.name == self._context.name:
            return self.fence(event.incarnation)
        if event.role == "body":
            self._bodies.appear(event.name, event.incarnation)
            return []
        if event.role == "agent":
            self._bodies.agent_replaced(event.name, event.incarnation)
            self.session_watchdog.token_appeared(event.name, event.incarnation)
            self._peer_table.alive(event.name, event.incarnation)
        warnings = self._warn_of_older(event.name, event.incarnation) if event.role == "agent" else []
        if event.role != "agent" or not self._peer_table.neighbours_only:
            self.announcements.peer_appeared(len(self._peer_table.peers), now)
        return warnings

    def _warn_of_older(self, name: str, incarnation: int) -> list[Effect]:
        """A warning, the first time that a peer is refused for good: its former process, which has gone, had a larger incarnation."""
        peer = self._peer_table.peers.get(name)
        is_refused = peer is not None and incarnation < peer.incarnation and not (peer.token or peer.suspected)
        if peer is None or not is_refused:
            return []
        text = f"{name} is refused: its incarnation {incarnation} is smaller than {peer.incarnation}, that of its former process"
        return self._warn(name, incarnation, f"{text}. Set the clock of its machine, or start it with --incarnation {peer.incarnation + 1}")

    def _warn_of_sensor(self, hello: Hello) -> list[Effect]:
        """A warning, the first time that a peer announces a sensor that cannot be used here."""
        why = self._peer_table.peers[hello.sender].unusable
        return self._warn(hello.sender, hello.incarnation, f"{hello.sender} is refused: its sensor cannot be used here: {why}")

    def _warn(self, name: str, incarnation: int, text: str) -> list[Effect]:
        """A warning about a process: one for each incarnation, and at most `MOST_WARNINGS` in all."""
        if (name, incarnation) in self._warned or len(self._warned) >= MOST_WARNINGS:
            return []
        self._warned.add((name, incarnation))
        return [Warn(text)]

    def gone(self, event: Gone, tick: int, *, suspected: bool) -> bool:
        """A token has vanished in the round `tick`; whether its agent counts as gone now. `suspected`: this agent was late itself."""
        if event.role == "body":
            return self._bodies.leave(event.name, event.incarnation, tick, suspected=suspected)
        if event.role != "agent":
            return False
        self._bodies.agent_left(event.name, event.incarnation)
        self.session_watchdog.token_vanished(event.name, event.incarnation)
        return self._peer_table.gone(event.name, event.incarnation, tick, suspected=suspected)

    def take_hellos(self, batch: Batch, now: float) -> list[Effect]:
        """Take Hellos that arrived together: all senders are heard before one Hello is judged."""
        self.session_watchdog.note_messages(batch.senders, now)
        effects: list[Effect] = NO_EFFECTS
        for hello in batch.messages:
            more = self.take_hello(hello, now)
            effects = more if effects is NO_EFFECTS else [*effects, *more]
        return effects

    def take_hello(self, hello: Hello, now: float) -> list[Effect]:
        """Take a Hello: remember the announced sensor, compare the settings, and check the session for a half-open link."""
        if hello.sender == self._context.name:
            return self.fence(hello.incarnation)
        agreement = self._peer_table.agreement
        reason = self._peer_table.take_hello(hello) if hello.role == "agent" else "settings" if agreement.differing(hello) else None
        if reason and reason != "settings":
            self._counters[f"rejected.{reason}"] += 1
            return self._warn_of_sensor(hello) if reason == "sensor" else self._warn_of_older(hello.sender, hello.incarnation)
        # a sender with other settings still counts as heard, and the own Hello lists it
        warnings = agreement.refuse([hello], self._counters) if reason else []
        is_new = self.session_watchdog.note_hello(hello.sender, now)
        # a Hello sent when the token of a world appeared can be lost, because the world may not have subscribed yet
        is_restarted_world = hello.role == "world" and 0 < self.world_incarnation < hello.incarnation
        if is_new or is_restarted_world:
            self.announcements.peer_appeared(len(self._peer_table.peers), now)
        reason = self.session_watchdog.reason_to_reopen(hello, now) if hello.role == "agent" else ""
        if not reason:
            return warnings or ([] if is_new or is_restarted_world else NO_EFFECTS)  # a Hello may be due earlier now
        self._counters["reopened"] += 1
        return [*warnings, Reopen(reason)]

    def start(self, now: float) -> Hello:
        """The first Hello of this agent; the next one is planned."""
        self.announcements.start(now)
        return self._hello(None)

    def announce_if_due(self, now: float, *, has_observed: bool) -> list[Effect]:
        """A Hello of this agent, if one is due. `has_observed`: an observation has come."""
        is_early = not has_observed or self._peer_table.lacks_announcements()
        if not self.announcements.take_due(len(self._peer_table.peers), is_early, now):
            return []
        return [self._hello(now if has_observed else None)]

    def fence(self, incarnation: int) -> list[Effect]:
        """Stop if another process with the same name has a younger incarnation."""
        if incarnation > self._context.incarnation:
            return [Stop(EXIT_FENCED, f"a younger incarnation {incarnation} of {self._context.name} is alive")]
        return NO_EFFECTS

    def _hello(self, now: float | None) -> Hello:
        """The Hello of this agent at `now`; None, before the first observation: it lists all peers that ever sent a Hello and are alive."""
        self.session_watchdog.keep(self._peer_table.peers)
        heard, settings = self.session_watchdog.heard(now), self._peer_table.agreement.settings
        return message_builders.hello(self._context, heard, settings)
