"""The status of a swarm, as one record for terminals and the control socket."""

import msgspec


class TickRate(msgspec.Struct, kw_only=True):
    """How fast a run goes."""

    ticks_per_s: float | None = None  # None: nothing to judge by yet
    asked_per_s: float | None = None  # None: as fast as it goes
    rounds: int = 0  # played by all agents together
    skipped: int = 0  # that agents left out because they were busy
    late: int = 0  # closed at the deadline with a gossip missing
    spared: int = 0  # ticks in which agents sent no gossip, to keep a slower pace
    pace: int = 1  # the slowest that some agent keeps now: it shares the ticks that this number divides
    slowest: list[str] = []  # the agents of that pace, if it is not 1
    stalled: list[str] = []  # agents that were not served in time in the last seconds; of a whole run: ever
    advice: str = ""  # one line where the machine is too small


class AgentStatus(msgspec.Struct, kw_only=True):
    """What watchers see of one agent."""

    name: str
    alive: bool = False
    incarnation: int = 0
    left_at: float | None = None  # world time at which it was last lost, s
    pose: tuple[float, float, float] | None = None  # where its body really is: x, y, heading
    tick: int = -1
    cell: float = 0.0  # area, share of the arena
    mass: float = 0.0
    targets: int = 0
    rounds: int = 0
    skipped: int = 0
    late: int = 0
    pace: int = 1
    paused: bool = False
    round_ms: float = 0.0
    differs: list[str] = []  # settings that are not those of the run: its peers refuse it


class Status(msgspec.Struct, kw_only=True):
    """What watchers see of the swarm."""

    tick: int
    ticks: int
    time: float
    ospa: float
    gospa: float
    targets: int
    in_view: int
    has_targets: bool  # false: the scenario has none, so that there is nothing to compare estimates with
    mass: float
    hole: float
    overlap: float
    messages: int
    tick_rate: TickRate
    agents: list[AgentStatus]
    arena: tuple[float, float]  # width and height, m
    places: list[tuple[float, float]]  # of the true targets, m
    estimates: list[tuple[float, float]]  # of the targets that the living report, m
    waiting: str = ""  # what the first tick waits for
