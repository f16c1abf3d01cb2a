"""One agent process: `python -m agents --name s3 --sensor A --config agents.toml`.

The file holds what an agent may know (docs/explanation/knowledge.md): the public settings of the swarm, and none of the world's secrets.
"""

import logging
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # numpy reads this on import; threads only cost time here

from agents.agent import Agent
from agents.backend import PLAIN, Backend
from agents.compiled.cache import is_switched_off
from agents.config import AgentConfig
from protocol import process
from protocol.fields import RESERVED
from protocol.settings import BadSetting


def build(config: AgentConfig, name: str, incarnation: int, backend: Backend) -> Agent:
    """The agent of that name. Raises BadSetting when neither the roster nor `--sensor` names its sensor class."""
    if name in RESERVED:
        raise BadSetting(f"--name {name}: is the name of another process; should be one of its own")
    if name not in config.members:
        known = f"the roster has no such member; it has {', '.join(config.members)}" if config.members else "the file has no roster"
        raise BadSetting(f"--name {name}: {known}. --sensor CLASS says which sensor it carries")
    return Agent(config, name, incarnation, backend)


def start(config: AgentConfig, name: str, incarnation: int) -> Agent:
    """The agent with compiled loops, which are loaded or compiled before anybody hears of it; with NUMBA_DISABLE_JIT=1 in plain numpy."""
    if is_switched_off():
        return build(config, name, incarnation, PLAIN)
    from agents.compiled.backend import FAST
    from agents.compiled.warmup import compiled_before, warm

    agent = build(config, name, incarnation, FAST)
    if not compiled_before():
        logging.getLogger(__name__).info("compiling the particle loops, once on this machine")
    warm()
    return agent


if __name__ == "__main__":
    process.main("agents", AgentConfig, start)
