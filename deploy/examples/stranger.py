"""An agent of another make, written from docs/reference/protocol.md alone: Python with zenoh and msgpack, and nothing of Covey.

    python stranger.py RUN tcp/127.0.0.1:7447 x1 [degrees m prob_detection s]

It takes a seat in a running swarm with `interest = "all"`, owns a power cell, and drives its centroid of detection (COD) to the centroid of
the particles in it. It keeps these as they come and moves them on, by the random numbers that all agents share, so that no mass is lost or
counted twice. It leaves out the rest of the filter: correction, births, estimates of targets. It trusts what it hears (*Decode limits*).
A particle is (x, y, vx, vy, weight, id). A generator is (name, x, y, power radius). A claim lists generators, its owner's first.
"""

import hashlib
import itertools
import math
import queue
import random
import struct
import sys
import time
import zlib
from bisect import bisect
from contextlib import suppress
from typing import Any

import msgpack
import zenoh

WIRE, WORD, GOLDEN = 2, (1 << 64) - 1, 0x9E3779B97F4A7C15
NOTHING = {"claim_tick": 0, "claim_names": [], "claim": b"", "diagram_hash": 0, "weight": 0.0, "states": b"", "ids": b""}
ZENOH = '{mode: "peer", connect: {endpoints: ["%s"], timeout_ms: -1, exit_on_failure: false}, listen: {endpoints: ["tcp/127.0.0.1:0"]}, '
ZENOH += 'scouting: {multicast: {enabled: false}, gossip: {autoconnect_strategy: {peer: {to_peer: "greater-zid"}}}}}'
Map = dict[str, Any]
Entry = tuple[Any, ...]  # a place, a particle or a generator


def scramble(word: int, salt: int) -> int:
    """64 random-looking bits (splitmix64)."""
    word = ((word ^ salt) + GOLDEN) & WORD
    word = ((word ^ (word >> 30)) * 0xBF58476D1CE4E5B9) & WORD
    word = ((word ^ (word >> 27)) * 0x94D049BB133111EB) & WORD
    return word ^ (word >> 31)


def random_key(seed: int, purpose: str, tick: int) -> int:
    """The salt of one kind of noise in one tick."""
    return scramble(scramble(scramble(GOLDEN, seed), zlib.crc32(purpose.encode()) | len(purpose) << 32), tick)


def normal(bits: int) -> float:
    """Nearly standard normal: the sum of four 16-bit numbers."""
    return (sum(bits >> shift & 0xFFFF for shift in (0, 16, 32, 48)) - 131070.0) * (math.sqrt(3.0) / 65536.0)


def order(name: str) -> tuple[int, str]:
    """The order of names: s2 before s10."""
    return len(name), name


def pack(form: str, rows: list[Entry]) -> bytes:
    """An array, row by row."""
    return b"".join(struct.pack(form, *row) for row in rows)


def owns(claim: list[Entry], x: float, y: float) -> bool:
    """Whether a place belongs to the owner of a claim: its power distance is the least, on a tie its name is the earliest."""
    ranks = [((x - px) * (x - px) + (y - py) * (y - py) - radius * radius, order(name)) for name, px, py, radius in claim]
    return bool(ranks) and min(ranks) is ranks[0]


def power_cell(own: Entry, others: list[Entry], corners: list[Entry]) -> tuple[list[Entry], list[Entry]]:
    """What is left of an arena when each bisector has cut off its part: the corners of the cell, and the claim that states it."""
    bisectors = []
    for other in others:
        span = math.dist(own[1:3], other[1:3])
        if span == 0.0:  # the larger disc owns all, and of equal ones that of the earlier name
            corners = corners if (-own[3], order(own[0])) < (-other[3], order(other[0])) else []
            continue
        nx, ny, limit = (other[1] - own[1]) / span, (other[2] - own[2]) / span, (span**2 + own[3] ** 2 - other[3] ** 2) / (2.0 * span)
        bisectors.append((nx, ny, limit, other))
        beyond = [(x - own[1]) * nx + (y - own[2]) * ny - limit for x, y in corners]
        clipped: list[Entry] = []
        for here, (x, y) in enumerate(corners):
            (px, py), before, after = corners[here - 1], beyond[here - 1], beyond[here]
            share = before / (before - after) if before * after < 0.0 else 0.0
            clipped += [(px + share * (x - px), py + share * (y - py))] if before * after < 0.0 else []
            clipped += [(x, y)] if after <= 0.0 else []
        corners = clipped
    touching = [g for nx, ny, t, g in bisectors if any((x - own[1]) * nx + (y - own[2]) * ny > t - 1e-6 for x, y in corners)]
    return (corners, [own, *touching]) if len(corners) > 2 else ([], [])


def move(particles: list[Entry], tick: int, settings: Map) -> list[Entry]:
    """The particles one tick later, at `tick`; those that leave the arena are dropped."""
    model, dt, sides = settings["filter"], settings["run"]["dt"], (settings["arena"]["width"], settings["arena"]["height"])
    turn, *axes = (random_key(model["seed"], purpose, tick) for purpose in ("turn", "east", "north"))
    survival, moved = math.exp(-dt / model["lifetime"]) if model["lifetime"] else 1.0, []
    for x, y, vx, vy, weight, number in particles:
        half = normal(scramble(number, turn)) * (0.5 * model["heading_noise"] * math.sqrt(dt))
        cos, sin = (1.0 - half * half) / (1.0 + half * half), 2.0 * half / (1.0 + half * half)
        scale = model["speed"] / max(math.sqrt(vx * vx + vy * vy), 1e-12)
        place, velocity = [x, y], [(cos * vx - sin * vy) * scale, (sin * vx + cos * vy) * scale]
        for axis in (0, 1):
            place[axis] = place[axis] + velocity[axis] * dt + normal(scramble(number, axes[axis])) * model["position_noise"]
            while model["border"] == "reflect" and not 0.0 <= place[axis] <= sides[axis]:
                place[axis], velocity[axis] = (0.0 if place[axis] < 0.0 else 2.0 * sides[axis]) - place[axis], -velocity[axis]
        if 0.0 <= place[0] <= sides[0] and 0.0 <= place[1] <= sides[1]:
            moved.append((*place, *velocity, weight * survival, number))
    return moved


def draw(particles: list[Entry], model: Map) -> list[Entry]:
    """Particles of one weight and the same mass, with new ids in ascending order: a systematic draw."""
    sums = list(itertools.accumulate(particle[4] for particle in particles))
    if not sums or not sums[-1]:
        return []
    count = min(max(round(model["particles_per_target"] * sums[-1]), model["least_particles"]), model["most_particles"])
    weight, offset, ids = sums[-1] / count, random.random(), sorted(random.getrandbits(64) for _ in range(count))
    rows = [particles[min(bisect(sums, (mark + offset) * weight), len(sums) - 1)] for mark in range(count)]
    return [(*row[:4], weight, number) for row, number in zip(rows, ids)]


class Stranger:
    """What the agent knows, and its rounds."""

    def __init__(self, session: zenoh.Session, run: str, name: str, numbers: list[float]) -> None:
        self.session, self.run, self.name, self.incarnation = session, run, name, time.time_ns()
        degrees, radius, prob, self.patience = numbers + [90.0, 8.0, 0.9, 0.1][len(numbers) :]
        half, self.sensor = math.radians(degrees) / 2.0, {"angle": math.radians(degrees), "radius": radius, "prob_detection": prob}
        self.ahead, self.capability = 2.0 * radius * math.sin(half) / (3.0 * half), prob * half * radius**2  # from sensor to COD; D
        self.alive, self.last = set[tuple[str, int]](), dict[str, int]()  # tokens; the tick of the newest gossip of each peer
        self.greeted, self.settings = dict[str, float](), Map()  # when the newest Hello of each came; what all Hellos say
        self.gossips: dict[int, dict[str, Map]] = {}  # by tick and name
        self.seen, self.open = Map(tick=-1), Map()  # the newest observation; my gossip while its round is open
        self.tick, self.listening, self.close_at, self.greet_at = -1, True, 0.0, 0.0
        self.diagram, self.copies, self.owned = set[str](), list[Entry](), NOTHING  # of the last round

    def say(self, kind: str, fields: Map) -> Map:
        """Publish a message."""
        said = {"type": kind, "sender": self.name, "incarnation": self.incarnation, "wire": WIRE, **fields}
        self.session.put(f"covey/{self.run}/{kind}/{self.name}", msgpack.packb(said), congestion_control=zenoh.CongestionControl.DROP)
        return said

    def serve(self) -> None:
        """Listen, declare the token, say Hello, and take part for ever."""
        events, tokens = queue.SimpleQueue[zenoh.Sample](), self.session.liveliness()
        keys = [f"covey/{self.run}/{rest}" for rest in ("hello/*", "gossip/*", f"observation/{self.name}")]
        held: list[Any] = [self.session.declare_subscriber(each, events.put) for each in keys]
        held += [tokens.declare_subscriber(f"covey/{self.run}/alive/agent/*/*", events.put, history=True)]
        held += [tokens.declare_token(f"covey/{self.run}/alive/agent/{self.name}/{self.incarnation}")]
        while True:
            now = time.monotonic()
            if now >= self.greet_at:
                self.greet_at = now + (2.0 if self.tick >= 0 else 0.25)
                self.say("hello", {"sensor": self.sensor, "heard": [name for name, at in self.greeted.items() if now - at <= 3.0]})
            if self.open and (now >= self.close_at or not self.awaited()):
                self.close()
            until = min(self.greet_at, self.close_at) if self.open else self.greet_at
            with suppress(queue.Empty):
                self.take(events.get(timeout=max(0.0, until - now)))

    def take(self, sample: zenoh.Sample) -> None:
        """A token that comes or goes, a Hello, a gossip, or what my sensor has seen."""
        (_, _, kind, *rest), now = str(sample.key_expr).split("/"), time.monotonic()
        if kind == "alive" and rest[1] != self.name:
            self.greet_at, _ = now, self.last.pop(rest[1], None)
            (self.alive.add if sample.kind == zenoh.SampleKind.PUT else self.alive.discard)((rest[1], int(rest[2])))
        elif kind == "alive" and int(rest[2]) > self.incarnation:
            raise SystemExit(3)  # a younger process has my name
        said = msgpack.unpackb(sample.payload.to_bytes()) if kind != "alive" else Map(sender=self.name)
        sender = said["sender"]
        if (sender == self.name and kind != "observation") or said.get("wire", WIRE) != WIRE:  # my body's bear my name
            return
        if kind == "hello":
            self.greet_at, self.greeted[sender] = self.greet_at if sender in self.greeted else now, now
            self.settings |= {section: {**values, **self.settings.get(section, {})} for section, values in said.get("settings", {}).items()}
        elif kind == "gossip" and (sender, said["incarnation"]) in self.alive:
            self.gossips.setdefault(said["tick"], {})[sender], self.last[sender] = {**NOTHING, **said}, said["tick"]
        elif kind == "observation":
            self.seen = said
        if self.seen["tick"] > self.tick and {"filter", "arena"} <= self.settings.keys():  # an agent and the world have said theirs
            self.speak(self.seen, now)

    def speak(self, seen: Map, now: float) -> None:
        """Open the round of an observation with my gossip; one that is still open is over."""
        if self.open:
            self.close()
        self.tick, self.close_at = seen["tick"], now + self.patience
        owned = self.owned if self.owned["claim_tick"] == self.tick - 1 else NOTHING  # who missed a round owns nothing
        (x, y, heading), detections, area = seen["pose"], seen.get("detections", b""), self.capability
        cod, radius = (x + self.ahead * math.cos(heading), y + self.ahead * math.sin(heading)), math.sqrt(area / math.pi)
        mine = {"tick": self.tick, "pose": seen["pose"], "cod": cod, "power_radius": radius, "unused": area, "detections": detections}
        self.open = self.say("gossip", {**mine, **owned, "listening": self.listening, "scanned": seen.get("scanned", True)})

    def awaited(self) -> set[str]:
        """The peers whose gossip of this round is still to come: alive, and not silent for long. A newcomer awaits the unheard as well."""
        oldest, unheard = self.tick - self.settings["timing"]["silent_rounds"], self.tick if self.listening else -math.inf
        return {name for name, _ in self.alive if self.last.get(name, unheard) >= oldest} - self.gossips.get(self.tick, {}).keys()

    def generators(self) -> list[Entry]:
        """The generators of this round in the order of names: of each who lives and has a cell the newest gossip, if it is not too old."""
        said, names = {} if self.listening else {self.name: self.open}, {name for name, _ in self.alive}
        for tick in sorted(self.gossips.keys() & range(self.tick - self.settings["timing"]["silent_rounds"], self.tick + 1)):
            said |= {name: gossip for name, gossip in self.gossips[tick].items() if name in names}
        kind = self.settings["partition"]["kind"]
        radius, centre = "power_radius" if kind == "power" else "", "pose" if kind == "voronoi" else "cod"
        rows = [(name, *gossip[centre][:2], gossip.get(radius, 0.0)) for name, gossip in said.items() if not gossip.get("listening")]
        return sorted(rows, key=lambda row: order(row[0]))

    def close(self) -> None:
        """Play the open round: move all particles, cut the cell, keep what lies in it, and drive there."""
        mine, settings, names = self.open, self.settings, {name for name, _ in self.alive}
        heard = {name: gossip for name, gossip in self.gossips.get(self.tick, {}).items() if name in names} | {self.name: mine}
        fresh, told = [gossip for gossip in heard.values() if gossip["claim_tick"] == self.tick - 1], dict[int, Entry]()
        for gossip in fresh:
            rows = zip(struct.iter_unpack("<4f", gossip["states"]), struct.iter_unpack("<Q", gossip["ids"]))
            told |= {number: (*state, gossip["weight"], number) for state, (number,) in rows}
        if not self.diagram <= heard.keys() or len({gossip["diagram_hash"] for gossip in fresh}) > 1:  # the claims leave gaps
            claims = [[(n, *row) for n, row in zip(each["claim_names"], struct.iter_unpack("<3d", each["claim"]))] for each in fresh]
            told |= {copy[5]: copy for copy in self.copies if not any(owns(claim, copy[0], copy[1]) for claim in claims)}
        self.copies = move([told[number] for number in sorted(told)], self.tick, settings)
        diagram, width, height = self.generators(), settings["arena"]["width"], settings["arena"]["height"]
        own, others = [row for row in diagram if row[0] == self.name], [row for row in diagram if row[0] != self.name]
        corners, claim = power_cell(own[0], others, [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]) if own else ([], [])
        kept = draw([particle for particle in self.copies if owns(claim, particle[0], particle[1])], settings["filter"])
        told_of = "\n".join(row[0] for row in diagram).encode() + pack("<3d", [row[1:] for row in diagram])
        hashed = {"diagram_hash": int.from_bytes(hashlib.blake2b(told_of, digest_size=7).digest(), "little") | 1}
        mass, bounds, tick, last = sum(particle[4] for particle in kept), [row[0] for row in claim], self.tick, self.last
        self.owned = {"claim_tick": self.tick, "claim_names": bounds, "claim": pack("<3d", [row[1:] for row in claim]), **hashed}
        self.owned |= {"states": pack("<4f", [row[:4] for row in kept]), "ids": pack("<Q", [row[5:] for row in kept])}
        self.owned |= {"weight": mass / max(1, len(kept)), "claim_ages": bytes(min(255, abs(tick - last.get(n, tick))) for n in bounds)}
        shown = {name: mine[name] for name in ("tick", "pose", "cod", "power_radius", "unused")}
        self.say("estimate", {**shown, "mass": mass, "cell": pack("<2d", corners), **hashed, "neighbours": bounds[1:]})
        self.drive(mine, [particle[:2] for particle in kept] or corners)
        self.diagram, self.open = {row[0] for row in diagram}, {}
        self.listening = self.listening and (self.tick == 0 or bool(self.awaited()))
        self.gossips = {tick: said for tick, said in self.gossips.items() if tick >= self.tick - settings["timing"]["silent_rounds"]}

    def drive(self, mine: Map, places: list[Entry]) -> None:
        """Send the COD to the middle of some places, and turn the sensor there, within the limits; without places stand still."""
        limits, dt, (x, y), pose = self.settings["limits"], self.settings["run"]["dt"], mine["cod"], mine["pose"]
        east, north = (sum(place[axis] for place in places) / len(places) if places else mine["cod"][axis] for axis in (0, 1))
        vx, vy, most = (east - x) / dt, (north - y) / dt, limits["turn_rate"] if places else 0.0
        slow = min(1.0, limits["speed"] / max(math.hypot(vx, vy), 1e-9))
        turn = math.remainder(math.atan2(north - pose[1], east - pose[0]) - pose[2], 2.0 * math.pi) / dt
        self.say("command", {"tick": self.tick, "velocity": [vx * slow, vy * slow], "turn_rate": max(-most, min(most, turn))})


if __name__ == "__main__":
    here = zenoh.open(zenoh.Config.from_json5(ZENOH % sys.argv[2]))
    Stranger(here, sys.argv[1], sys.argv[3], [float(word) for word in sys.argv[4:]]).serve()
