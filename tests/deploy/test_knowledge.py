"""What an agent may know of a scenario: the sections of its own file, a seed that is not the world's, and no list of the team."""

import tomllib
from pathlib import Path

import msgspec
import pytest

from agents.agent import Agent
from agents.config import AgentConfig
from deploy.live.processes import Child
from deploy.scenario import Scenario, agent_config, filter_seed, resolve, world_config
from deploy.simulation import Simulation
from deploy.storage.run_directory import RunDirectory
from protocol.settings import BadSetting, load

MAY_KNOW = {
    "arena",
    "birth",
    "capacity",
    "control",
    "detection",
    "extraction",
    "search",
    "filter",
    "limits",
    "mixture",
    "members",
    "network",
    "partition",
    "pose",
}
MAY_KNOW |= {"run", "sensors", "timing"}
SECRETS = {"targets", "bodies", "faults", "team", "study"}
SEED = 987654321


def written(folder: Path, monkeypatch: pytest.MonkeyPatch, scenario: Scenario) -> RunDirectory:
    """The files of a run."""
    monkeypatch.setenv("COVEY_RUNS", str(folder))
    directory = RunDirectory("known")
    directory.logs.mkdir(parents=True)
    directory.write_config(scenario)
    return directory


def test_an_agents_settings_have_no_place_for_what_only_the_world_knows() -> None:
    fields = set(AgentConfig.__struct_fields__)
    assert fields == MAY_KNOW and set(Scenario.__struct_fields__) > SECRETS
    assert "seed" not in AgentConfig().run.__struct_fields__


def test_the_file_of_the_agents_names_no_section_and_no_number_of_the_worlds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    directory = written(tmp_path, monkeypatch, resolve("efficacy", {"run.seed": SEED, "targets.count": 7531}))
    text = directory.agents.read_text()
    assert set(tomllib.loads(text)) <= MAY_KNOW
    assert str(SEED) not in text and "7531" not in text
    assert str(SEED) in directory.config.read_text()
    config = load(directory.agents, AgentConfig)
    assert config.filter.seed == filter_seed(SEED) != SEED


def test_an_agent_works_with_that_file_and_refuses_the_worlds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    directory = written(tmp_path, monkeypatch, resolve("quick"))
    assert Agent(load(directory.agents, AgentConfig), "s1").context.sensor_class == "A"
    with pytest.raises(BadSetting, match=r"run\.toml: run\.seed: there is no such field"):
        load(directory.config, AgentConfig)


def test_an_agent_process_is_told_of_no_other_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    directory, words = written(tmp_path, monkeypatch, resolve("quick")), list[str]()

    class Zygote:
        def fork(self, asked: list[str], log: Path) -> None:
            words.extend(asked)

    Child("s1", "agents", directory, ["--sensor", "A"], zygote=Zygote()).start()  # type: ignore[arg-type]
    assert words[words.index("--config") + 1] == str(directory.agents) and str(directory.config) not in words


def test_who_hears_the_neighbours_alone_is_given_no_roster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = {"timing.interest": "neighbours"}
    directory = written(tmp_path, monkeypatch, resolve("quick", options))
    assert tomllib.loads(directory.agents.read_text())["members"] == {}
    agents = Simulation(resolve("quick", options)).agents
    assert len(agents) == 6 and all(agent.config.members == {} for agent in agents.values())


def test_the_names_that_certificates_admit_are_told_only_where_there_are_certificates() -> None:
    scenario = resolve("quick", {"network.admit": ["s1", "s2"]})
    assert agent_config(scenario).network.admit == ()
    secure = msgspec.structs.replace(scenario.network, ca="ca.pem")
    assert agent_config(msgspec.structs.replace(scenario, network=secure)).network.admit == ("s1", "s2")
    all_members = msgspec.structs.replace(secure, admit=())
    timing = msgspec.structs.replace(scenario.timing, interest="neighbours")  # without a roster the agents know no other names
    found = agent_config(msgspec.structs.replace(scenario, network=all_members, timing=timing))
    assert (found.members, found.network.admit) == ({}, tuple(scenario.members))


def test_trials_that_pair_have_the_same_filter_seed_and_others_have_another() -> None:
    methods = [agent_config(resolve("efficacy", {"run.seed": 5, "partition.kind": kind})).filter.seed for kind in ("power", "voronoi")]
    assert methods == [filter_seed(5)] * 2
    assert len({filter_seed(seed) for seed in range(1000)}) == 1000


def test_a_swarm_without_a_world_of_ours_names_its_own_seed() -> None:
    scenario = resolve("quick", {"filter.seed": 77})
    assert agent_config(scenario).filter.seed == 77
    assert world_config(scenario).run.seed == 1


def test_the_agents_of_a_simulation_never_see_the_seed_of_the_world() -> None:
    simulation = Simulation(resolve("quick", {"run.seed": SEED}))
    for agent in simulation.agents.values():
        assert type(agent.config) is AgentConfig and str(SEED) not in str(msgspec.to_builtins(agent.config))
