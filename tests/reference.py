"""The pages of docs/reference that are made from the code: settings, command line, metrics, Python.

python -m tests.reference    writes them
"""

import inspect
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import covey
from deploy.__main__ import app
from deploy.cli.template import SectionRows, sections
from deploy.page.metrics import PageFigures, SwarmCollector
from deploy.page.picture import Picture
from deploy.scenario import TeamSettings, resolve, team_counts
from deploy.scoring.scores import NO_SCORE
from protocol.sensing import SENSOR_CLASSES

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "reference"
MADE = "This page is made from the code by `python -m tests.reference`."
COUNTERS = {  # of agents: families appear when they first count
    "rounds": "rounds played",
    "heard": "gossips accepted",
    "missing": "gossips that a round waited for in vain",
    "late": "rounds closed at their deadline",
    "skipped": "ticks of which no round was played, because the agent was still busy",
    "spared": "ticks in which no gossip was sent, to keep a slower pace",
    "given_up": "silent peers that stopped to be generators",
    "looked_ahead": "rounds of an earlier tick that were moved on to now (`timing.look_ahead`)",
    "stalled_ms": "ms for which the machine did not serve it in time",
    "reopened": "sessions opened anew, because others were heard no more",
    "rejected": "messages refused, with the label `reason` (see [the protocol](protocol.md#decode-limits))",
}


def settings() -> str:
    """Every section of a scenario with its settings."""
    head = f"""# Settings

{MADE} `covey init FILE` writes the same as a scenario to begin with.

A setting that you leave out has its default. On the command line `--set section.name=value` changes it.
A wrong value is one line that names file, field, value, and what would be right.
"""
    return "\n".join([head, *map(_section, sections()), _paper_classes()])


def _paper_classes() -> str:
    """The sensor classes and teams of the paper."""
    lines = ["## Sensor classes of the paper", "", "Table I. A section `[sensors.A]` changes what it states.", ""]
    lines += ["| class | angle, degrees | radius, m | p_d |", "|---|---|---|---|"]
    for name, wedge in SENSOR_CLASSES.items():
        lines.append(f"| `{name}` | {math.degrees(wedge.angle):.0f} | {wedge.radius:g} | {wedge.prob_detection:g} |")
    lines += [
        "",
        "## Teams of the paper",
        "",
        "Table II. Teams 2 to 5 consist of the three classes of `team.triple`. A composition of your own is `20E+4H` or `A2,B6`.",
        "",
    ]
    lines += ["| `team.composition` | agents |", "|---|---|"]
    for number in map(str, range(1, 9)):
        counts = team_counts(TeamSettings(composition=number))
        lines.append(f"| `{number}` | {', '.join(f'{count} {name}' for name, count in counts.items())} |")
    return "\n".join([*lines, ""])


def _section(section: SectionRows) -> str:
    purpose = f"{section.purpose[:1].upper()}{section.purpose[1:]}."
    if not section.rows:
        return f"## `{section.heading}`\n\n{purpose}\n"
    lines = [f"| `{row.name}` | `{_cell(row.default)}` | {_cell(row.note)} |" for row in section.rows]
    return "\n".join([f"## `{section.heading}`", "", purpose, "", "| setting | default | meaning |", "|---|---|---|", *lines, ""])


def command_line() -> str:
    """Every command with its options."""
    body = app.generate_docs(output_format="markdown", usage_name="covey")
    body = re.sub(r"```console\n(covey \w+)(?: -m \S+)?", r"```text\n\1", body[body.index("**Run**") :])  # it shows how this process began
    [shared] = set(re.findall(r"^\* `--seed INT`: Seed of the run.*?^\* `--json`: [^\n]*\n", body, re.MULTILINE | re.DOTALL))
    body = body.replace(shared, "* All [options of a run](#options-of-a-run).\n")
    end = f"## Options of a run\n\nAn option that is not given leaves the value of the scenario file.\n\n{shared}"
    return f"# Command line\n\n{MADE} `covey help COMMAND` says the same, with an example.\n\n{body.strip()}\n\n{end}"


def metrics() -> str:
    """Every family of `/metrics`; those of a swarm in which nothing has happened yet, and the counters of agents."""
    head = f"""# Metrics

{MADE} The server of the page answers `/metrics` for Prometheus. One endpoint serves the whole swarm, and every sample has the label `run`.
Of an agent whose token is gone `covey_agent_up`, the age and the counters remain; its other gauges have no sample.
Without true targets (`targets.count = 0`) the metrics that compare with them are not exported: OSPA, GOSPA, targets, targets in view.

```yaml
scrape_configs:
  - job_name: covey
    scrape_interval: 2s
    static_configs: [{{targets: ["127.0.0.1:8737"]}}]
```

Import `deploy/page/grafana.json` into Grafana for a dashboard.

| metric | type | meaning |
|---|---|---|"""
    families = SwarmCollector(Picture(resolve("quick")), NO_SCORE, PageFigures()).collect()
    lines = [
        f"| `{found.name}{'_total' * (found.type == 'counter')}` | {found.type} | {_cell(found.documentation)} |" for found in families
    ]
    counters = [f"| `covey_agent_{name}_total` | counter | Of each agent: {text}. |" for name, text in COUNTERS.items()]
    return "\n".join([head, *lines, *counters, ""])


def python() -> str:
    """Every public name of `import covey` with its signature and its docstring."""
    head = f"""# Python

{MADE} Every name below is one of `covey`.

```python
import covey

run = covey.simulate("quick", seed=3, seconds=20)  # what `covey simulate quick --seed 3 --seconds 20` runs
print(run)
print(run.ospa.mean(), run.poses.shape)  # numpy arrays, one row for each tick; to_pandas() and to_arrow() give tables
```

What is simulated is what the command simulates. A setting or an argument that is wrong raises `BadSetting`, a ValueError of one line.
Numbers of numpy are taken.
[The notebook](../tutorial/notebook.ipynb) shows it with figures. In a checkout `.venv/bin/python` finds `covey`.
No file beside your script may be called agents.py, deploy.py, protocol.py or world.py there.
"""
    return "\n".join([head, *(part for name in covey.__all__ if name != "__version__" for part in _public(name))])


def _public(name: str) -> Iterator[str]:
    thing = getattr(covey, name)
    text = inspect.getdoc(thing) or ""
    yield f"## `{name}`\n"
    if inspect.isfunction(thing):
        first, _, rest = text.partition("\n\n")
        yield f"{first}\n"
        yield f"```text\n{name}{_signature(thing)}\n```\n"
        yield from [f"```text\n{rest}\n```\n"] if rest else []
    elif inspect.isclass(thing):
        yield f"{text.partition(chr(10))[0]}\n"
        members = list(_members(thing))
        if members:
            yield "\n".join(["| member | meaning |", "|---|---|", *members, ""])
    else:
        yield f"The value `{_cell(str(thing))}`.\n"


def _signature(thing: Callable[..., object]) -> str:
    """One parameter a line."""
    shown = [re.sub(r"(?<![\w.])(?:\w+\.)+(?=\w)", "", str(part)) for part in inspect.signature(thing).parameters.values()]
    shown = [re.sub(r"<function .*>", "...", part) for part in shown]
    return "(\n    " + ",\n    ".join(shown) + ",\n)"


def _members(kind: type) -> Iterator[str]:
    """Public methods and properties with the first line of what they say, and fields with the comment beside them."""
    comments = dict(re.findall(r"^    (\w+): .*?  # (.*)$", inspect.getsource(kind), re.MULTILINE))
    for name in dict.fromkeys([*inspect.get_annotations(kind), *vars(kind)]):
        value = vars(kind).get(name)
        text = comments.get(name, "") or (inspect.getdoc(value) or "" if inspect.isroutine(value) or isinstance(value, property) else "")
        if not name.startswith("_") and text:
            call = str(inspect.signature(value)) if inspect.isroutine(value) and callable(value) else ""
            yield f"| `{name}{'()' * bool(call)}` | {_cell(text.partition(chr(10))[0])} |"


def _cell(text: str) -> str:
    """A text as it may stand in a cell of a table. The path of a page becomes a link to it."""
    linked = re.sub(r"\bdocs/([\w/-]*?([\w-]+)\.md\S*)", r"[\2](../\1)", text)
    return re.sub(r"\s+", " ", linked).replace("|", "\\|")


PAGES: dict[str, Callable[[], str]] = {"settings.md": settings, "command-line.md": command_line, "metrics.md": metrics, "python.md": python}


if __name__ == "__main__":
    for page, made in PAGES.items():
        (FOLDER / page).write_text(made(), encoding="utf-8")
