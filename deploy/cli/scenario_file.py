"""`init` and `config`: a scenario to begin with, and what one comes to with its options."""

from pathlib import Path

import msgspec

from deploy.cli.template import template
from deploy.scenario import Scenario
from deploy.toml_text import toml_text
from protocol.settings import BadSetting


def init(file: Path) -> int:
    """Write a scenario with every section and every default; raises BadSetting when the file exists or cannot be written."""
    if file.suffix != ".toml":
        raise BadSetting(f"{file}: should be a file that ends in .toml")
    try:
        out = file.open("x", encoding="utf-8")
    except FileExistsError:
        raise BadSetting(f"{file}: exists and is left as it is; give another name") from None
    except OSError as error:
        raise BadSetting(f"{file}: {error.strerror}") from None
    try:
        with out:
            out.write(template())
    except OSError as error:
        file.unlink()  # half a scenario is none
        raise BadSetting(f"{file}: {error.strerror}") from None
    print(f"{file}: every section and every default; change it, then: covey check {file}; covey up {file}")
    return 0


def config(scenario: Scenario) -> int:
    """Print a resolved scenario as TOML."""
    print(toml_text(msgspec.to_builtins(scenario)), end="")
    return 0
