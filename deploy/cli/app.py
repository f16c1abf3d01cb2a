"""What all commands share: the application, the groups in which its help shows them, and the kinds of their arguments."""

from pathlib import Path
from typing import Annotated

from cyclopts import App, Group, Parameter

from deploy.cli import completion
from deploy.cli.options import WHOLE, RunOptions, switch_or_text

RUN, ACT, LOOK, KEEP, STUDY, SET_UP = (
    Group.create_ordered(name) for name in ("Run", "Act on a running swarm", "Look", "Keep", "Study", "Set up")
)

Options = Annotated[RunOptions, Parameter(name="*")]
RunName = Annotated[str | None, Parameter(help="Name of the run; default: the newest that is running.", completer=completion.runs)]
SwarmName = Annotated[
    str | None,
    Parameter(
        help="Name of the run, or the run.toml of a swarm elsewhere; default: the newest that is running.", completer=completion.runs
    ),
]
ScenarioName = Annotated[str, Parameter(help="A shipped scenario, or a TOML file.", completer=completion.scenarios)]
RecordingName = Annotated[str, Parameter(help="Name of a run, its folder, or an .mcap file.", completer=completion.recordings)]
AgentChoice = Annotated[
    str,
    Parameter(
        help="Names, with blanks or commas between them; or a number such as 4, or a share such as 30%.", completer=completion.agents
    ),
]
RandomCount = Annotated[int | None, WHOLE, Parameter(help="So many agents, drawn at random.")]
RecordFile = Annotated[bool | Path, Parameter(help="Record everything into this .mcap file; default: the run directory.", negative="")]
TraceFile = Annotated[Path | None, Parameter(help="Write the time series into this .npz, .parquet or .csv file.")]
PageAddress = Annotated[
    bool | str, Parameter(help="Show the run on a page in the browser: a port (0: any free one), or host:port.", converter=switch_or_text)
]
OpenPage = Annotated[bool, Parameter(help="Open the page in the browser.", negative="")]

app = App(
    name="covey",
    help="A masterless swarm of mobile sensors: every sensor is a process, and any of them may be killed.",
    help_format="plaintext",
    help_epilogue="covey help COMMAND explains a command and shows an example.",
    version_flags=["--version"],
    version=lambda: version_line(),
)
app["--help"].group = app["--version"].group = SET_UP


def version_line() -> str:
    """Name and version, on one line."""
    from deploy.installation import VERSION

    return f"covey {VERSION}"
