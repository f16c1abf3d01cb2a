"""The files that bring a swarm onto machines are valid, hardened, and name programs and options that exist; a typo in each is found."""

import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from protocol.process import arguments
from protocol.settings import NetworkSettings, convert

ROOT = Path(__file__).resolve().parents[2]
MACHINES = ROOT / "deploy" / "machines"
UNITS = ("covey-agent@.service", "covey-body@.service")
MOST_EXPOSED = 1.2  # of 10, as systemd-analyze security counts; what is left is the network, and that numba compiles
ANALYZE = shutil.which("systemd-analyze")
needs_systemd = pytest.mark.skipif(ANALYZE is None, reason="needs systemd-analyze (systemd)")


def complaints(*words: str | Path) -> str:
    """What a checker has to say, empty when it is content."""
    done = subprocess.run([*map(str, words)], capture_output=True, text=True, timeout=60, check=False)
    return (done.stdout + done.stderr).strip() if done.returncode or done.stderr else ""


def checker(name: str) -> Path:
    """A program of this environment."""
    return Path(sys.executable).with_name(name)


def of_unit(text: str, folder: Path, name: str) -> str:
    """What systemd says of a unit, where its program exists."""
    program = folder / "python"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    (folder / name).write_text(text.replace("/opt/covey/bin/python", str(program)))
    assert ANALYZE is not None
    return complaints(ANALYZE, "verify", "--man=no", folder / name)


def of_dockerfile(text: str, folder: Path, name: str) -> str:
    """What hadolint says of a Dockerfile."""
    (folder / name).write_text(text)
    return complaints(checker("hadolint"), folder / name)


def of_compose(text: str, folder: Path, name: str) -> str:
    """What the schema of compose files says."""
    (folder / name).write_text(text)
    return complaints(checker("check-jsonschema"), "--builtin-schema", "vendor.compose-spec", folder / name)


FILES: list[tuple[str, Callable[[str, Path, str], str], str, str, str]] = [
    ("covey-agent@.service", of_unit, "ProtectSystem=strict", "ProtectSytem=strict", "ProtectSytem"),
    ("covey-body@.service", of_unit, "Restart=on-failure", "Restart=on-failures", "Failed to parse service restart specifier"),
    ("Dockerfile", of_dockerfile, "ENTRYPOINT [", "ENTRYPONT [", "unexpected 'E"),
    ("compose.yaml", of_compose, "read_only: true", "readonly: true", "'readonly' was unexpected"),
]


@pytest.mark.parametrize(("name", "check", "right", "typo", "says"), FILES, ids=[row[0] for row in FILES])
def test_a_file_is_valid_and_a_planted_typo_is_found(
    name: str, check: Callable[[str, Path, str], str], right: str, typo: str, says: str, tmp_path: Path
) -> None:
    if check is of_unit and ANALYZE is None:
        pytest.skip("needs systemd-analyze (systemd)")
    text = (MACHINES / name).read_text()
    assert check(text, tmp_path, name) == ""
    assert text.count(right) >= 1
    assert says in check(text.replace(right, typo), tmp_path, name)


@needs_systemd
@pytest.mark.parametrize("name", UNITS)
def test_a_unit_is_hardened(name: str) -> None:
    assert ANALYZE is not None
    words = [ANALYZE, "security", "--offline=true", "--no-pager", str(MACHINES / name)]
    output = subprocess.run(words, capture_output=True, text=True, timeout=60, check=True).stdout
    found = re.search(r"Overall exposure level for \S+: ([\d.]+) ", output)
    assert found is not None and float(found[1]) <= MOST_EXPOSED, output


@pytest.mark.parametrize("name", UNITS)
def test_the_command_of_a_unit_is_one_that_the_process_understands(name: str) -> None:
    [line] = re.findall(r"^ExecStart=(.*)$", (MACHINES / name).read_text(), re.MULTILINE)
    words = (
        line.replace("%i", "s3").replace("%d", "/run/credentials/x").replace("%S", "/var/lib").replace("${LISTEN}", "tls/0.0.0.0:1").split()
    )
    assert words[:3] == ["/opt/covey/bin/python", "-P", "-m"]
    understood(words[3:])


def test_the_keys_that_the_page_names_are_those_that_systemd_hands_to_the_agent() -> None:
    page = (ROOT / "docs" / "how-to" / "many-machines.md").read_text()
    [block] = re.findall(r"```toml\n(\[network\]\nca = .*?)```", page, re.DOTALL)
    named = convert(tomllib.loads(block)["network"], NetworkSettings, "").files("s3")
    handed = re.findall(r"^LoadCredential=(\w+):", (MACHINES / "covey-agent@.service").read_text(), re.MULTILINE)
    folder = "/run/credentials/covey-agent@s3.service"  # the unit's credentials folder, %d
    assert named == {what: f"{folder}/{what}" for what in named} and set(named) <= set(handed)


def test_the_commands_of_the_compose_file_are_ones_that_the_processes_understand() -> None:
    import ruamel.yaml

    services = ruamel.yaml.YAML(typ="safe").load(MACHINES / "compose.yaml")["services"]
    assert {"s1", "s1.body", "s2", "s2.body", "monitor"} == services.keys()
    for service in services.values():
        assert service["read_only"] is True and service["cap_drop"] == ["ALL"] and service["user"] != "0"
        if service["command"][0] != "covey.deploy":
            understood([str(word) for word in service["command"]])


def understood(words: list[str]) -> None:
    """Whether `python -m` these words are of a module of the wheel, with options that it has."""
    module, options = words[0], words[1:]
    assert module in ("covey.agents", "covey.world")
    if module == "covey.world":
        assert options[:2][0] == "--body" and options[2] == "--keep"
        options = ["--name", options[1], *options[4:]]
    parsed = arguments(module.partition(".")[2], options)
    assert parsed.name.startswith("s") and parsed.config.suffix == ".toml" and parsed.listen[0].startswith("tls/0.0.0.0:")


def test_all_of_the_folder_is_in_the_wheel() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "machines/*" in project["tool"]["setuptools"]["package-data"]["covey.deploy"]
