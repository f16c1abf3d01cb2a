"""One agent process: `python -m agents --name s3 --config run.toml`."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # numpy reads it when it is imported; its threads only cost here

from agents.agent import Agent
from agents.arithmetic import PLAIN, Arithmetic
from agents.config import AgentConfig
from protocol import process
from protocol.settings import BadSetting


def build(config: AgentConfig, name: str, incarnation: int, arithmetic: Arithmetic = PLAIN) -> Agent:
    """The agent of that name; raises BadSetting when the scenario has none."""
    if name not in config.members:
        raise BadSetting(f"--name {name}: the scenario has no such member; it has {', '.join(config.members)}")
    return Agent(config, name, incarnation, arithmetic)


if __name__ == "__main__":
    process.main("agents", AgentConfig, build)
