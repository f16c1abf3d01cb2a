"""The commands of agents: which of them count, and the newest of each agent."""

from protocol.messages import Command


class CommandBook:
    """The newest valid command of each agent by name."""

    def __init__(self, *, lockstep: bool) -> None:
        self.newest: dict[str, Command] = {}
        self._lockstep = lockstep

    def keep(self, command: Command, tick: int, incarnation: int | None) -> bool:
        """Keep a command that arrives in `tick`; False when it does not count. `incarnation`: of the live agent of that name.

        It must be newer than the command at hand, and in lockstep of this very tick. In real time a command of an earlier tick still
        counts: an agent that is always a little late must not stand still.
        """
        if incarnation != command.incarnation or command.tick > tick or (self._lockstep and command.tick < tick):
            return False
        held = self.newest.get(command.sender)
        if held is not None and command.tick <= held.tick:
            return False
        self.newest[command.sender] = command
        return True

    def drop(self, name: str) -> None:
        """Forget the command of an agent."""
        self.newest.pop(name, None)
