"""Commands that set up and explain: names, options and help."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from deploy.cli import completion
from deploy.cli.app import SET_UP, Options, ScenarioName, app, version_line
from deploy.cli.options import FLAG, WHOLE, RunOptions

# Cyclopts only defines the function that completes: it is called where zsh loads the file, and made known where the file is sourced.
ZSH_END = 'if [[ "${funcstack[1]}" == _covey ]]; then _cyclopts_covey "$@"; else compdef _cyclopts_covey covey; fi'


@app.command(group=SET_UP, help_epilogue="Example: covey init mine.toml")
def init(file: Path = Path("scenario.toml"), /) -> int:
    """Write a scenario with every setting and its default, explained."""
    from deploy.cli import scenario_file

    return scenario_file.init(file)


@app.command(group=SET_UP, help_epilogue="Example: covey check mine.toml --team 3")
def check(
    scenario: ScenarioName = "convergence",
    /,
    *,
    network: Annotated[bool, FLAG] = False,
    own: Annotated[str, Parameter(name="--as")] = "monitor",
    options: Options = RunOptions(),
) -> int:
    """Is the scenario right, and can this machine run it?

    --network: dial network.seeds and say who is found, or why nobody is; with the certificate --as s3. Also of an agents.toml.
    """
    from deploy.cli import scenario_file

    wrong = options.mistakes(scenario, agents_too=network)
    if wrong:
        return scenario_file.print_mistakes(wrong)
    found = options.unchecked(scenario, agents_too=network)
    return scenario_file.check_network_and_print(found, own) if network else scenario_file.check(found)


@app.command(group=SET_UP, help_epilogue="Example: covey platform lab.toml s1")
def platform(scenario: ScenarioName, agent: str, /, *, options: Options = RunOptions()) -> int:
    """Does the platform of an agent's body keep its contract? It is driven a short way: give a robot room.

    The scenario names the platform as bodies.platform = "module:Class".
    """
    from deploy.cli import scenario_file

    return scenario_file.try_platform(options.scenario(scenario), agent)


@app.command(group=SET_UP, help_epilogue="Example: covey config efficacy --team 3 --set filter.gate=4")
def config(scenario: ScenarioName = "convergence", /, *, agents: Annotated[bool, FLAG] = False, options: Options = RunOptions()) -> int:
    """All settings of a scenario with its options, as TOML.

    They are a run.toml, for worlds, bodies and watchers. --agents: an agents.toml, with what an agent may know.
    """
    from deploy.cli import scenario_file

    return scenario_file.config(options.scenario(scenario), agents)


@app.command(group=SET_UP, help_epilogue="Example: covey keys --scenario efficacy --into ~/keys")
def keys(
    *names: str,
    into: Path = Path("keys"),
    scenario: Annotated[str | None, Parameter(completer=completion.scenarios)] = None,
    host: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    days: Annotated[int, WHOLE] = 730,
    force: Annotated[bool, FLAG] = False,
    in_git: Annotated[bool, FLAG] = False,
) -> int:
    """An authority and certificates for mutual TLS.

    For these names, or for all of a scenario; up --keys DIR uses them.
    --force: make anew what exists; --in-git: even in a git work tree.
    """
    from deploy.cli import keys

    return keys.keys(list(names), scenario, into, host, days, force, in_git)


@app.command(
    name="completion",
    group=SET_UP,
    help_epilogue="Example: source <(covey completion bash)\n         covey completion fish > ~/.config/fish/completions/covey.fish",
)
def completion_script(shell: Literal["bash", "zsh", "fish"], /) -> int:
    """What completes words with TAB in a shell.

    bash: source it; fish: keep it where fish looks; zsh: source it after compinit, or keep it as _covey in a folder of $fpath.
    """
    print(app.generate_completion(prog_name="covey", shell=shell) + (ZSH_END if shell == "zsh" else ""))
    return 0


@app.command(group=SET_UP, help_epilogue="Example: covey version")
def version() -> int:
    """Versions of Covey, of its wire format and of what it stands on."""
    import json

    from deploy.installation import versions

    print(version_line())
    print(json.dumps(versions(), indent=2))
    return 0


@app.command(name="help", group=SET_UP, help_epilogue="Example: covey help kill")
def explain(command: Annotated[str, Parameter(completer=lambda context: list(app.resolved_commands()))] = "", /) -> int:
    """Explain a command, or show all of them."""
    if command and command not in app:
        app.parse_args([command], exit_on_error=False, print_error=False)  # raises: there is no such command; did you mean ...
    app.help_print([command] if command else [])
    return 0
