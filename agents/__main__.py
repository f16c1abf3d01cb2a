"""One agent process: `python -m agents --name s3 --sensor A --config agents.toml`.

The file holds what an agent may know (docs/explanation/knowledge.md): the public settings of the swarm, and none of the world's secrets.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # numpy reads this on import; threads only cost time here

from agents.agent import Agent
from agents.backend import PLAIN, Backend
from agents.config import AgentConfig
from protocol import process
from protocol.settings import BadSetting


def build(config: AgentConfig, name: str, incarnation: int, backend: Backend = PLAIN) -> Agent:
    """The agent of that name. Raises BadSetting when neither the roster nor `--sensor` names its sensor class."""
    if name not in config.members:
        known = f"the roster has no such member; it has {', '.join(config.members)}" if config.members else "the file has no roster"
        raise BadSetting(f"--name {name}: {known}. --sensor CLASS says which sensor it carries")
    return Agent(config, name, incarnation, backend)


if __name__ == "__main__":
    process.main("agents", AgentConfig, build)
