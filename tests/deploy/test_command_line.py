"""The command line: groups, examples, versions, completion in real shells, and several names at once."""

import os
import pty
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from cyclopts import App

from deploy.__main__ import app
from deploy.cli.app import SET_UP
from deploy.cli.control import selection
from deploy.installation import VERSION
from protocol.settings import BadSetting

ROOT = Path(__file__).parents[2]
COMMANDS: dict[str, App] = {name: command for name, command in app.resolved_commands().items() if not name.startswith("-")}


def examples(command: App) -> list[str]:
    """The lines of a command's example that begin with `covey`."""
    lines = str(command.help_epilogue).removeprefix("Example:").splitlines()
    return [line.strip() for line in lines]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_stands_in_a_group_and_shows_an_example_that_can_be_typed(name: str) -> None:
    command = COMMANDS[name]
    assert command.group and command.help
    for example in examples(command):
        words = example.partition("<(")[2].rstrip(")") or example.partition(" > ")[0]
        program, *rest = words.replace("'", "").split()
        assert program == "covey" and rest[0] == name
        app.parse_args(rest, exit_on_error=False, print_error=False)


def test_the_overview_names_the_groups_and_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    app(["help"], result_action="return_value")
    shown = capsys.readouterr().out
    for word in ("Run", "Act on a running swarm", "Look", "Keep", "Study", "Set up", *COMMANDS):
        assert f" {word} " in shown
    assert app["--version"].group == (SET_UP,)


def test_help_of_a_command_is_what_its_option_shows(capsys: pytest.CaptureFixture[str]) -> None:
    app(["help", "kill"], result_action="return_value")
    by_command = capsys.readouterr().out
    app(["kill", "--help"], result_action="return_value")
    assert by_command == capsys.readouterr().out
    assert "Example: covey kill s1 s2 s3" in by_command


def test_version_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    app(["--version"], result_action="return_value")
    assert capsys.readouterr().out == f"covey {VERSION}\n"


@pytest.mark.parametrize(
    ("names", "random", "text"),
    [
        (("s1", "s2", "s3"), None, "s1,s2,s3"),
        (("s1,s2", "s3"), None, "s1,s2,s3"),
        (("30%",), None, "30%"),
        (("4",), None, "4"),
        ((), 4, "4"),
    ],
)
def test_several_names_may_follow_each_other(names: tuple[str, ...], random: int | None, text: str) -> None:
    assert selection("kill", names, random, None) == text


@pytest.mark.parametrize(
    ("names", "random", "complaint"),
    [
        ((), None, "kill: nobody is named"),
        (("s1", "30%"), None, "s1 30%: should be names, or one"),
        (("s1",), 2, "--random 2: draws agents"),
        (("s1", " "), None, "kill: a name is empty; should be names such as s3"),
    ],
)
def test_who_is_meant_must_be_clear(names: tuple[str, ...], random: int | None, complaint: str) -> None:
    with pytest.raises(BadSetting, match=complaint):
        selection("kill", names, random, None)


def program_in(folder: Path) -> Path:
    """The command as a program of this name in a folder."""
    program = folder / "covey"
    program.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -P -m deploy "$@"\n')
    program.chmod(0o755)
    return program


def offered(words: list[str], folder: Path) -> list[str]:
    """What a real bash offers after these words, the last of them not finished, in a folder."""
    program = program_in(folder)
    quoted = " ".join(f"'{word}'" for word in [str(program), *words])
    script = (
        f'source <({program} completion bash)\nCOMP_WORDS=({quoted})\nCOMP_CWORD={len(words)}\n_covey\nprintf "%s\\n" "${{COMPREPLY[@]}}"\n'
    )
    environment = {**os.environ, "COVEY_RUNS": str(folder / "runs")}
    done = subprocess.run(["bash", "--norc", "-c", script], cwd=folder, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and not done.stderr, done.stderr
    return done.stdout.split()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_a_real_bash_completes_commands_options_scenarios_files_runs_agents_and_settings(tmp_path: Path) -> None:
    config = tmp_path / "runs" / "hunt" / "run.toml"
    config.parent.mkdir(parents=True)
    config.write_text('[members]\ns1 = "A"\ns2 = "B"\n')
    (tmp_path / "mine.toml").touch()
    assert offered(["ki"], tmp_path) == ["kill"]
    assert offered(["simulate", "--partition", "voronoi-"], tmp_path) == ["voronoi-cod"]
    assert offered(["up", "qu"], tmp_path) == ["quick"]
    assert offered(["up", "mi"], tmp_path) == ["mine.toml"]
    assert offered(["down", "--run", ""], tmp_path) == ["hunt"]
    assert offered(["rm", "h"], tmp_path) == ["hunt"]  # it has no recording
    assert offered(["kill", "s"], tmp_path) == ["s1", "s2"]
    assert offered(["up", "--set", "run.see"], tmp_path) == ["run.seed="]


@pytest.mark.skipif(shutil.which("fish") is None, reason="no fish here")
def test_a_real_fish_completes_commands_options_scenarios_and_settings(tmp_path: Path) -> None:
    program = program_in(tmp_path)
    lines = ("covey ki", "covey simulate --partition voronoi-", "covey up qu", "covey up --set run.see", "covey study rob")
    asked = "; ".join(f"complete -C '{line}'" for line in lines)
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "HOME": str(tmp_path)}
    command = ["fish", "--no-config", "-c", f"{program} completion fish | source; {asked}"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60)
    assert [line.partition("\t")[0] for line in done.stdout.splitlines()] == ["kill", "voronoi-cod", "quick", "run.seed=", "robustness"]


@pytest.mark.skipif(shutil.which("zsh") is None, reason="no zsh here")
@pytest.mark.parametrize("way", ["sourced", "kept in a folder of $fpath"])
def test_a_real_zsh_completes_commands_options_and_scenarios(way: str, tmp_path: Path) -> None:
    program = program_in(tmp_path)
    begin = "autoload -Uz compinit; compinit -u -D"
    if way == "sourced":
        begin += f"; source <({program} completion zsh)"
    else:
        (tmp_path / "_covey").write_bytes(subprocess.run([program, "completion", "zsh"], capture_output=True, check=True).stdout)
        begin = f"fpath=({tmp_path} $fpath); {begin}"
    wanted = {"covey sim": "covey simulate", "covey simulate --partition voronoi-": "voronoi-cod", "covey up qui": "covey up quick"}
    keyboard, screen = pty.openpty()
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "HOME": str(tmp_path), "TERM": "xterm", "COLUMNS": "200"}
    zsh = subprocess.Popen(
        ["zsh", "-f", "-i"], cwd=tmp_path, env=environment, stdin=screen, stdout=screen, stderr=screen, start_new_session=True
    )
    try:
        os.write(keyboard, f"{begin}; print re''ady\n".encode())
        until(keyboard, "ready")
        for typed, completed in wanted.items():
            os.write(keyboard, b"\x15" + typed.encode() + b"\t")  # after Ctrl-U: the line is empty
            until(keyboard, completed)
    finally:
        zsh.kill()
        zsh.wait()


def until(keyboard: int, text: str) -> None:
    """Read what a terminal shows until a text has come."""
    shown, end = "", time.monotonic() + 60.0
    while text not in shown:
        assert time.monotonic() < end, f"never shown: {text}; {shown}"
        if select.select([keyboard], [], [], 1.0)[0]:
            shown += os.read(keyboard, 65536).decode(errors="replace")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_there_is_a_completion_for_each_shell(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    app(["completion", shell], result_action="return_value")
    script = capsys.readouterr().out
    assert "covey" in script and all(command in script for command in COMMANDS)
